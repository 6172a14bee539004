//! Jobs of micro-expressions.

pub mod synth;
