//! Commands with subcommands: one file each.

pub mod avatar;
pub mod device;
pub mod mer;
pub mod models;
