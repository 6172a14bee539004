//! Reading datasets: optical flow, micro-expressions, and the random changes that training makes to a sample.

pub mod augment;
pub mod flow;
pub mod manifest;
pub mod micro_expression;
