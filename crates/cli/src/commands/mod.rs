//! One file per command: its arguments, and `run`.

pub mod avatar;
pub mod device;
pub mod mer;
pub mod models;
pub mod view;
