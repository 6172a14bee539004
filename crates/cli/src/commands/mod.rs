//! One file per command: its arguments, and `run`.

pub mod avatar;
pub mod check;
pub mod convert;
pub mod device;
pub mod eval;
pub mod figure;
pub mod flow;
pub mod mer;
pub mod metrics;
pub mod models;
pub mod pack;
pub mod rasterize;
pub mod view;
