mod invariance;
mod motion;
mod scenes;
mod twin;
