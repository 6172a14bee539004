//! The Gaussian and Flow Rasterizer.
//!
//! One pass over depth-sorted 3D Gaussians gives colour, optical flow, alpha and depth, with the constants of the
//! 3D Gaussian Splatting reference (Kerbl et al. 2023) and the flow of the SRFlow paper (section III-B).
//!
//! [`mod@reference`] is the definition, one pixel at a time in `f64`; [`Rasterizer`] is the fast implementation. Both have a
//! backward: the gradients of a loss with respect to the Gaussians and the cameras.

mod backward;
mod blending;
mod camera;
mod device;
mod error;
mod files;
mod frame;
mod gaussians;
pub mod gltf;
#[cfg(feature = "cube")]
mod gpu;
mod gradients;
mod options;
mod ordering;
mod pixel_order;
mod projection;
mod rasterizer;
pub mod reference;
mod replay;
mod sh;
mod strip;

pub use camera::{
    Camera, MAX_PIXELS, MAX_SIDE, NEAR, NamedCamera, PixelConvention, Surroundings, read_cameras,
};
pub use device::{Device, DeviceRasterizer};
pub use error::{CameraError, RasterizeError};
pub use files::{
    SPLAT_FORMATS, SplatFormat, Up, parse_ply, read_bound_ply, read_gaussians, read_ply, write_bound_ply,
    write_gaussians, write_ply,
};
pub use frame::{Frame, Outputs, Statistics};
pub use gaussians::{Gaussians, HalfTurn};
pub use gradients::{CameraGradient, FrameGradients, GaussianGradients};
pub use options::{Next, Options, Sorting};
pub use rasterizer::{Rasterizer, Rendering};
pub use sh::{SH_0, scale_colour};

#[cfg(test)]
mod tests;
