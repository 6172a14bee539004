//! Reads optical-flow and micro-expression datasets, and applies the random changes of training to samples.

pub mod augment;
pub mod flow;
pub mod manifest;
pub mod micro_expression;
pub mod packed;
pub mod region_map;
