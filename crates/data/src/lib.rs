//! Datasets: generating and checking SRFlow, rendering micro-expression sets, and reading the published ones of both kinds.

pub mod augment;
pub mod check;
pub mod generate;
pub mod manifest;
pub mod micro_expression;
pub mod read;
pub mod record;
pub mod statistics;
pub mod synth;
