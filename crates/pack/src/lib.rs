//! Datasets packed as WebDataset tars, to publish and to stream.
//!
//! ```text
//! README.md                dataset card: front matter of Hugging Face, pictures, statistics
//! croissant.json           the same for programs (Croissant 1.1)
//! pack.json                arguments of the packing, and dataset.json of the dataset
//! index.jsonl              a line for each pair: where its members are, their SHA-256, statistics of the flow
//! tars.jsonl               a line for each tar: its size, SHA-256 and number of pairs; written last
//! SHA256SUMS               SHA-256 of every other file, as `sha256sum -c` checks them
//! images/scene-0003_00000.png
//! train-000000.tar ...     pairs of each split; val-000000.tar ..., test-000000.tar ...
//! ```
//!
//! Members of a pair are named `KEY.FIELD.ENDING`, such as `scene-0003_00000.flow.npy`; see `names.rs`. They are adjacent, sorted by name,
//! and the same for every pair.

mod card;
mod croissant;
mod error;
mod folder;
mod index;
mod names;
mod packed;
mod pattern;
mod place;
mod plan;
mod settings;
mod source;
mod split;
mod tar;
mod tar_size;
mod ustar;
mod writer;

pub use error::{PackError, ReadError};
pub use index::{INDEX_NAME, Listing, read_index};
pub use pattern::expand;
pub use place::Place;
pub use settings::{PackSettings, PackedFlow};
pub use source::{PairSource, Scene, Source};
pub use split::SceneSplit;
pub use tar::{Contents, Member, SampleMembers, scan};
pub use tar_size::TarSize;
pub use writer::{PackEvent, PackReport, PackRequest, pack};

/// Clap's derives with the feature `clap`; otherwise derives that generate nothing.
pub(crate) mod clap {
    #[cfg(feature = "clap")]
    pub use ::clap::Args;
    #[cfg(not(feature = "clap"))]
    pub use srflow_no_clap::Args;
}
