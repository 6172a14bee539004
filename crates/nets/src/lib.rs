//! Optical flow networks: one file per network, and the refinement loop that they share.
//!
//! Parameters have the names of the reference implementation, so published weights load without a table of names.

mod blocks;
mod ccmr;
mod claim;
mod dpflow;
mod estimate;
mod estimator;
mod facts;
mod features;
mod fit;
mod flownet;
mod flownet3;
mod flownetcss;
mod frames;
mod gma;
mod included;
mod iterations;
mod memflow;
mod memory_need;
mod network;
mod onnx;
mod published;
mod raft;
mod raft_small;
mod recurrent;
mod rpknet;
mod save;
mod sea_raft;
mod settings;
mod shots;
mod skflow;
mod srflow;
mod ssa;
mod table;
mod tiles;
mod unimatch;
mod wrapped;

pub use claim::{Claim, claim};
pub use estimate::{Encoded, Estimate, LaplaceMixture, Memory, Request};
pub use estimator::NetworkEstimator;
pub use facts::{Facts, IterationPresets, Padding, PublishedWeights, Start};
pub use features::Features;
pub use fit::{Fit, fits, fits_of_file, load_network, load_to_train};
pub use frames::Frames;
pub use included::{included_sha256, load_included};
pub use iterations::{Iterations, IterationsError};
pub use memory_need::MemoryNeed;
pub use onnx::{OnnxError, OnnxOptions, save_network_onnx};
pub use published::{PublishedError, find_weights, published, published_names, weights_folder};
pub use save::{about, save_network, save_network_pytorch};
pub use settings::{Allowed, Setting, SettingError};
pub use table::{Architecture, Network};
pub use tiles::{NothingFits, SMALLEST_TILE_SIDE, TileSize, Tiles, Tiling};
pub use wrapped::{Wrapped, scaled_size};
