//! One file per command: its arguments, and `run`.

pub mod ablation;
pub mod avatar;
pub mod demo;
pub mod device;
pub mod mer;
pub mod models;
pub mod rasterize;
pub mod train;
pub mod view;
