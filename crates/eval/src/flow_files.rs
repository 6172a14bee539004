//! Flows that another program estimated, as files.

use std::collections::HashMap;
use std::path::{Path, PathBuf};

use srflow_field::{FileError, FlowField, FlowFormat, read_flow_as};
use srflow_read::flow::FlowDataset;

use crate::crop::Window;
use crate::evaluate::chosen;

/// Names of missing files that an error lists.
const LISTED: usize = 12;

/// A folder of flow files, one for each pair of a dataset: `SCENE/FRAME.EXT`, or `FRAME.EXT` where pairs have no scene, as
/// [`Entry::id`](srflow_read::flow::Entry::id) names them, in any format of [`FlowFormat`].
#[derive(Debug, Clone)]
pub struct FlowFiles {
    name: String,
    /// By the pair's name.
    files: HashMap<String, (PathBuf, FlowFormat)>,
}

/// Why a folder of flows does not fit a dataset.
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
        /// How many have none.
        count: usize,
        /// Of how many.
        pairs: usize,
        /// Names of some of them.
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

/// Why the flow of a pair could not be taken from its file.
#[derive(Debug, thiserror::Error)]
pub enum FlowFileError {
    /// It cannot be read.
    #[error(transparent)]
    Read(#[from] FileError),
    /// It is of another size.
    #[error(
        "{}: expected a flow of {}x{} as the frames are{}, found {}x{} (WIDTHxHEIGHT)",
        .path.display(), .frame.0, .frame.1, crop_words(.crop), .found.0, .found.1
    )]
    Size {
        path: PathBuf,
        /// Width and height of the frames.
        frame: (usize, usize),
        /// Width and height of the crop that is scored.
        crop: Option<(usize, usize)>,
        /// Width and height of the flow.
        found: (usize, usize),
    },
}

fn crop_words(crop: &Option<(usize, usize)>) -> String {
    crop.map_or(String::new(), |(width, height)| format!(", or of {width}x{height} as they are cropped"))
}

impl FlowFiles {
    /// Finds the files of the pairs of `dataset` that an evaluation with this `limit` scores. None is opened.
    ///
    /// # Errors
    /// When a pair has no file, or more than one; pairs without are named together.
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

    /// What tables call it.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// The flow of a pair whose frames are of the size `frame`, cropped to `window`. A file may also hold the window alone.
    pub(crate) fn read(
        &self,
        pair: &str,
        frame: (usize, usize),
        window: Option<Window>,
    ) -> Result<FlowField, FlowFileError> {
        let (path, format) = &self.files[pair]; // `find` has seen every pair that is scored
        let flow = read_flow_as(path, *format)?;
        let crop = window.map(|Window { width, height, .. }| (width, height));
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
