//! Readers: every dataset becomes a list of image pairs, read on demand.
//!
//! [`FlowDataset::open`] lists a dataset's pairs without decoding; [`FlowDataset::read`] decodes one of them, and may be
//! called from several threads. The differences between datasets (paths, valid ground truth) are behind the trait `Reader`, one
//! file per dataset.

mod chairs;
mod clips;
mod dataset;
mod entry;
mod error;
mod facialflownet;
mod file;
mod gaps;
mod hd1k;
mod kind;
mod kitti;
mod layout;
mod made;
mod plain;
mod sample;
mod sequence;
mod sintel;
mod split;
mod spring;
mod srflow;
mod table;
mod things;
mod triplets;
mod wds;

pub use dataset::FlowDataset;
pub use entry::{Entry, Occlusion};
pub use error::DatasetError;
pub use file::EntryFile;
pub use kind::Kind;
pub use made::{MadeError, MadePairs, SCENES_AT_ONCE};
pub use sample::{Sample, TruthDensity};
pub use split::Split;
pub use table::{DatasetSpec, KINDS};

use kind::Request;
use sample::Truth;

pub use crate::listing::{flow_files, pictures};
