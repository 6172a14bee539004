//! Optical-flow datasets: generating SRFlow, checking it, and reading the published ones.

pub mod augment;
pub mod check;
pub mod generate;
pub mod manifest;
pub mod micro_expression;
pub mod read;
pub mod record;
pub mod statistics;
pub mod synth;
