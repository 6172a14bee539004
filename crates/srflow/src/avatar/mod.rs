//! Jobs of avatars.

pub mod capture;
pub mod export;
pub mod fit;
pub mod import;
pub mod mesh;
mod paths;
#[doc(hidden)]
pub mod scores;
pub mod train;
pub mod units;
