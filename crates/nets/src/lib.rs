//! Optical flow networks: one file per network, and the loop that they share.
//!
//! A network's parameters carry the names that the reference implementation gives them, so that published weights load
//! without a table of names.

mod architecture;
mod blocks;
mod encoded;
mod estimator;
mod features;
mod fit;
mod frames;
mod gma;
mod memory;
mod network;
mod published;
mod raft;
mod raft_small;
mod recurrent;
mod scale;
mod skflow;
mod tiles;
mod whose;

pub use architecture::{Architecture, Facts, IterationPresets, PublishedWeights};
pub use encoded::Encoded;
pub use estimator::{NetworkEstimator, SMALLEST_SIDE};
pub use features::Features;
pub use fit::{Fit, fits, load_network};
pub use frames::Frames;
pub use gma::Gma;
pub use network::Network;
pub use published::{PublishedError, find_weights, published, published_names, weights_folder};
pub use raft::Raft;
pub use raft_small::RaftSmall;
pub use recurrent::{Estimate, Request};
pub use scale::{Scaled, scaled_size};
pub use skflow::SkFlow;
pub use tiles::{MemoryNeed, NothingFits, TileSize, Tiled, Tiles};
pub use whose::{Claim, claim};
