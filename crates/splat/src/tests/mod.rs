mod antialiasing;
mod gradients;
mod invariance;
mod motion;
mod popping;
pub(crate) mod scenes;
mod twin;
