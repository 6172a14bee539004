//! Jobs of avatars.

pub mod capture;
pub mod eval;
pub mod export;
pub mod fit;
pub mod from_video;
pub mod import;
pub mod landmarks;
pub mod mesh;
mod mesh_picture;
mod paths;
mod scores;
pub mod train;
pub mod units;
