//! The report: one self-contained HTML file. It loads nothing from elsewhere; pictures are embedded as data URIs, charts are
//! SVG.
//!
//! A [`Page`] holds [`Section`]s, a section holds [`Figure`]s. Figures can only be created by the functions here, which
//! escape all text.

mod action_cards;
mod bars;
mod charts;
mod compare;
mod confusion;
mod curves;
mod embedded;
mod facts;
mod film;
mod heat;
mod histogram;
mod legend;
mod page;
mod pair_figures;
mod panels;
mod picture;
mod score_table;
mod scores;
mod shrink;
mod standalone;

pub use action_cards::{ActionCard, action_cards};
pub use bars::{Bar, bars};
pub use charts::{Axis, Chart};
pub use compare::compare;
pub use confusion::confusion_matrix;
pub use curves::{Curve, curves};
pub use embedded::embedded;
pub use facts::{facts, settings_facts, tiles};
pub use film::{Film, films};
pub use heat::{ColorMap, error_map, heat};
pub use histogram::{Bin, histogram};
pub use legend::{color_wheel, heat_legend, ramp_legend, wheel_legend};
pub use page::{Figure, Page, Section};
pub use pair_figures::{color_scale, flow_picture, flow_scale, middle_scale, pair_figures, sample_panels};
pub use panels::{Panel, Strip, columns, panels, side_by_side, strips};
pub use picture::{Picture, PictureError};
pub use score_table::score_table;
pub use scores::{score_figures, score_report};
pub use shrink::{shrink_flow, shrink_image, shrink_mask, shrink_plane};
