//! Jobs of avatars.

pub mod capture;
