//! Generic pairs for training: textured layers with smooth motions, as in FlyingChairs (Dosovitskiy et al. 2015) and AutoFlow (Sun et al.
//! 2021), made by code alone or with photographs as textures. Flow and occlusion are exact.
//!
//! ```text
//! shapes.json                      the arguments of the dataset
//! data/00001_img1.png              frame 1 of the first pair: 8-bit sRGB
//! data/00001_img2.png              frame 2
//! data/00001_flow.npz16            flow from frame 1 to frame 2; written last
//! data/00001_occlusion.png         255 where a pixel of frame 1 is not visible in frame 2
//! FlyingChairs_train_val.txt       a line for each pair: 1 for training, 2 for validation; written once all pairs are
//! ```
//!
//! [`crate::job`] makes it pair by pair. Every file's bytes depend on the settings alone.

mod motion;
mod outline;
mod pair;
mod settings;
mod texture;
mod work;

use std::path::Path;

use serde::Serialize;
use srflow_files::write_file;

pub use settings::ShapesSettings;
use settings::validates;
pub(crate) use texture::Texture;
pub(crate) use work::Arguments as ShapesLayout;
pub use work::ShapePairs;

use crate::RenderError;
use crate::job::{self, Request};
use pair::ShapePair;

/// The result of [`shapes`].
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ShapesReport {
    /// Pairs of this shard.
    pub pairs: u64,
    /// Pairs made by this run.
    pub made: u64,
    /// Bytes written by this run.
    pub bytes: u64,
    pub seconds: f64,
    /// Whether it was stopped on request before all pairs were made.
    pub stopped: bool,
    /// Whether the dataset is complete, with all other shards.
    pub is_whole: bool,
}

/// Makes a dataset of generic pairs, or one shard of it, with the threads of the current rayon pool. Existing files with the
/// same settings are kept.
///
/// # Errors
/// Before any work when a setting is out of range, a folder cannot be read, or the output has another dataset; later when a file
/// cannot be read or written. Complete files stay, and the next call with the same settings continues.
pub fn shapes(settings: &ShapesSettings, request: Request) -> Result<ShapesReport, RenderError> {
    let plan = ShapePairs::new(settings.clone())?;
    let (made, finished) = job::make(&plan, request, |dir| write_split(dir, settings.pairs))?;
    let is_whole = finished.is_some();
    let job::Made { units, made, bytes, seconds, stopped, .. } = made;
    Ok(ShapesReport { pairs: units, made, bytes, seconds, stopped, is_whole })
}

/// Writes the list of the splits of a complete dataset.
pub(crate) fn write_split(dir: &Path, pairs: u32) -> Result<(), RenderError> {
    let lines: String = (0..pairs).map(|pair| if validates(pair) { "2\n" } else { "1\n" }).collect();
    Ok(write_file(&dir.join(work::SPLIT_NAME), lines)?)
}
