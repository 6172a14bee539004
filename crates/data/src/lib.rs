//! Optical-flow datasets: generating SRFlow, checking it, and reading the published ones.

pub mod manifest;
pub mod read;
