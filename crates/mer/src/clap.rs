//! Clap's derives with the feature `clap`; otherwise derives that generate nothing.

#[cfg(feature = "clap")]
pub(crate) use ::clap::{Args, ValueEnum};
#[cfg(not(feature = "clap"))]
pub(crate) use srflow_no_clap::{Args, ValueEnum};
