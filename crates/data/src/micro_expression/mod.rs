//! Micro-expression datasets: who shows which expression, in which frames.

pub use srflow_avatar::EmotionClass;
