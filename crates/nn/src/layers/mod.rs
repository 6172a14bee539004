//! Layers whose parameters have PyTorch's names, shapes and initial distributions.

mod batch_norm;
mod conv;
mod conv_transpose;
mod dropout;
mod group_norm;
mod layer_norm;
mod linear;

use burn::module::Module;

pub use batch_norm::{BatchNorm, with_batch_statistics};
pub use conv::{Conv2d, Conv2dConfig};
pub use conv_transpose::{ConvTranspose2d, ConvTranspose2dConfig};
pub use dropout::dropout;
pub use group_norm::GroupNorm;
pub use layer_norm::LayerNorm;
pub use linear::{Linear, LinearConfig};

/// Placeholder for a layer without parameters, such as an activation, so that later layers of a sequence keep the numbers that the
/// reference has in their names.
#[derive(Module, Debug)]
pub struct NoParameters;
