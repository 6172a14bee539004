//! Flow files of other programs.

use std::collections::HashMap;
use std::path::{Path, PathBuf};

use srflow_core::{FlowField, Size};
use srflow_data::flow::FlowDataset;
use srflow_files::{FileError, FlowFormat, read_flow_as};

use crate::crop::Window;
use crate::evaluate::chosen;

/// Names of missing files that an error lists.
const LISTED: usize = 12;

/// A folder of flow files, one for each pair of a dataset: `SCENE/FRAME.EXT`, or `FRAME.EXT` where pairs have no scene, as
/// [`Entry::id`](srflow_data::flow::Entry::id) names them, in any format of [`FlowFormat`].
#[derive(Debug, Clone)]
pub struct FlowFiles {
    name: String,
    /// Path and format by the pair's name.
    files: HashMap<String, (PathBuf, FlowFormat)>,
}

/// The flow files do not match the dataset.
#[derive(Debug, thiserror::Error)]
pub enum FlowFilesError {
    #[error(
        "{}: {count} of {pairs} pairs have no flow file: {listed}; expected each under the name of its pair, such as {}.flo \
         (or .{})",
        .dir.display(), .dir.join(.first).display(), FlowFormat::ALL.map(FlowFormat::extension).join(", .")
    )]
    Missing {
        /// The folder.
        dir: PathBuf,
        /// Number of pairs without a file.
        count: usize,
        /// Number of pairs in total.
        pairs: usize,
        /// Names of some of these pairs.
        listed: String,
        first: String,
    },
    /// A pair has several files.
    #[error("{} and {} are both flows of the pair {pair}: keep one", .files[0].display(), .files[1].display())]
    Several {
        /// Two of them.
        files: [PathBuf; 2],
        pair: String,
    },
}

/// Why a pair's flow could not be taken from its file.
#[derive(Debug, thiserror::Error)]
pub enum FlowFileError {
    /// It cannot be read.
    #[error(transparent)]
    Read(#[from] FileError),
    /// It has the wrong size.
    #[error(
        "{}: expected a flow of {frame} as the frames are{}, found {found} (WIDTHxHEIGHT)",
        .path.display(), crop_words(.crop)
    )]
    Size {
        path: PathBuf,
        /// Of the frames.
        frame: Size,
        /// Of the scored crop.
        crop: Option<Size>,
        /// Of the flow.
        found: Size,
    },
}

fn crop_words(crop: &Option<Size>) -> String {
    crop.map_or(String::new(), |crop| format!(", or of {crop} as the crop is"))
}

impl FlowFiles {
    /// Finds the files of the pairs of `dataset` that an evaluation with this `limit` scores, without opening them.
    ///
    /// # Errors
    /// When a pair has no file, or several; all pairs without a file are listed together.
    pub fn find(
        name: String,
        dir: &Path,
        dataset: &FlowDataset,
        limit: Option<usize>,
    ) -> Result<Self, FlowFilesError> {
        let mut files = HashMap::new();
        let mut missing = Vec::new();
        let mut pairs = 0;
        for entry in chosen(dataset, limit) {
            pairs += 1;
            let pair = entry.id();
            let with = |format: FlowFormat| (dir.join(format!("{pair}.{format}")), format);
            let mut found = FlowFormat::ALL.into_iter().map(with).filter(|(file, _)| file.is_file());
            match (found.next(), found.next()) {
                (Some(file), None) => _ = files.insert(pair, file),
                (Some((a, _)), Some((b, _))) => {
                    return Err(FlowFilesError::Several { files: [a, b], pair });
                }
                (None, _) => missing.push(pair),
            }
        }
        let Some(first) = missing.first() else { return Ok(Self { name, files }) };
        let more = missing.len().saturating_sub(LISTED);
        let mut listed = missing[..missing.len() - more].join(", ");
        if more > 0 {
            listed += &format!(" and {more} more");
        }
        let (count, first) = (missing.len(), first.clone());
        Err(FlowFilesError::Missing { dir: dir.to_owned(), count, pairs, listed, first })
    }

    /// Name in tables.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// The flow of a pair whose frames have the size `frame`. Panics when the pair is not one of those of [`FlowFiles::find`].
    ///
    /// # Errors
    /// When the file cannot be read or has another size.
    pub fn flow(&self, pair: &str, frame: Size) -> Result<FlowField, FlowFileError> {
        self.read(pair, frame, None)
    }

    /// The flow of a pair whose frames have the size `frame`, cropped to `window`. The file may hold the window alone.
    pub(crate) fn read(
        &self,
        pair: &str,
        frame: Size,
        window: Option<Window>,
    ) -> Result<FlowField, FlowFileError> {
        let (path, format) = &self.files[pair]; // `find` found a file for every scored pair
        let flow = read_flow_as(path, *format)?;
        let crop = window.map(|Window { width, height, .. }| Size { width, height });
        match window {
            _ if Some(flow.size()) == crop => Ok(flow),
            None if flow.size() == frame => Ok(flow),
            Some(Window { left, top, width, height }) if flow.size() == frame => {
                Ok(flow.crop(left, top, width, height))
            }
            _ => Err(FlowFileError::Size { path: path.clone(), frame, crop, found: flow.size() }),
        }
    }
}
