//! Shows numbers, pictures and flows: [tables](Table), the one-file [HTML page](html), and [figures for papers](figure).

mod color_scale;
pub mod figure;
mod heat;
pub mod html;
mod shrink;
mod table;

pub use color_scale::{color_scale, color_wheel, flow_picture, flow_scale, middle_scale};
pub use heat::{ColorMap, error_map, heat};
pub use shrink::{shrink_flow, shrink_image, shrink_mask, shrink_plane};
pub use table::{
    Better, Column, Mark, Row, Table, TextStyle, csv_cell, csv_text, csv_value, joined, latex_escape,
    latex_file, markdown_escape, markdown_file,
};
