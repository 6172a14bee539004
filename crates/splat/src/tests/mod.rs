mod antialiasing;
mod gradients;
mod invariance;
mod motion;
pub(crate) mod scenes;
mod twin;
