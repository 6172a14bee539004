//! Jobs of avatars.

pub mod capture;
pub mod mesh;
pub mod units;
