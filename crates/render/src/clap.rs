//! Clap's derives with the feature `clap`; otherwise derives that generate nothing.

#[cfg(feature = "clap")]
pub(crate) use ::clap::Args;
#[cfg(not(feature = "clap"))]
pub(crate) use srflow_no_clap::Args;
