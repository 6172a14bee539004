//! Resizing; each kind matches the program that results are compared with. In all, pixel centres are integers and borders are
//! aligned: `x` of the result is at `(x + 0.5) * input / output - 0.5`.
//!
//! - linear, as OpenCV's `INTER_LINEAR`: classical flow, augmentation;
//! - area, as OpenCV's `INTER_AREA`: coarse flow, the features of micro-expressions, pictures of reports;
//! - cubic, as OpenCV's `INTER_CUBIC`: faces of micro-expressions;
//! - antialiased: frames, flow and planes of networks that run at another size.

mod antialiased;
mod area;
mod cubic;
mod linear;

pub use antialiased::{resize_flow_antialiased, resize_image_antialiased, resize_plane_antialiased};
pub use area::{area_means, resize_flow_area, shrink_area};
pub use cubic::resize_cubic;
pub use linear::{
    LinearTap, resize_linear, resize_linear_by, resize_linear_of_two, sample_flow, sample_image, sample_mask,
};
