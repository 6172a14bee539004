//! Readers of optical-flow and micro-expression datasets.

pub mod flow;
mod frame_names;
mod listing;
pub mod manifest;
pub mod micro_expression;
mod pack_source;
pub mod region_map;

pub use frame_names::FrameNames;
pub use listing::unread_files;
pub use pack_source::pack_source;

/// Clap's derives with the feature `clap`; otherwise derives that generate nothing.
pub(crate) mod clap {
    #[cfg(feature = "clap")]
    pub use ::clap::Args;
    #[cfg(not(feature = "clap"))]
    pub use srflow_no_clap::Args;
}
