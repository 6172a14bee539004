//! Datasets without files, whose pairs are made when they are asked for.

use std::error::Error;
use std::ops::Range;

use super::Sample;

/// Why a pair could not be made.
pub type MadeError = Box<dyn Error + Send + Sync>;

/// Scenes whose pairs are asked for in turn. More of them at a time are allowed, but may cost their set-up more than once.
pub const SCENES_AT_ONCE: u32 = 8;

/// A dataset that makes its pairs: scenes without end, each of the same number of consecutive pairs.
///
/// A pair depends on the number of its scene and its own alone: not on what was made before, nor on the thread. Made pairs are those
/// that would be read from files: frames have 8 bits.
pub trait MadePairs: Send + Sync {
    /// Pairs of every scene, at least 1. Frame 2 of each but the last is frame 1 of the next.
    fn pairs_per_scene(&self) -> u32;

    /// What messages call a pair, unique within the dataset.
    fn name(&self, scene: u32, pair: u32) -> String;

    /// The pairs `run` of a scene, in order, with their flow. Pairs of one run share the work for their frames. Uses the threads of the
    /// current rayon pool.
    ///
    /// # Errors
    /// When a file that the pairs are made from cannot be read.
    fn make(&self, scene: u32, run: Range<u32>) -> Result<Vec<Sample>, MadeError>;
}
