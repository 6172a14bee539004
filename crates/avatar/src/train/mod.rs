//! Training the Gaussians of an avatar on pictures.

mod adam;
pub mod image_loss;

pub use adam::{GaussianAdam, LearningRates, ParameterGradients};
pub use image_loss::ImageLoss;
