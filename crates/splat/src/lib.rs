//! The Gaussian and Flow Rasterizer.
//!
//! One pass over depth-sorted 3D Gaussians gives colour, optical flow, alpha and depth, with the constants of the
//! 3D Gaussian Splatting reference (Kerbl et al. 2023) and the flow of the SRFlow paper (section III-B).

mod camera;
mod gaussians;

pub use camera::{Camera, PixelConvention};
pub use gaussians::Gaussians;
