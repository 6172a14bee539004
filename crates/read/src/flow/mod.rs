//! Readers: every dataset becomes a list of image pairs, each read when it is asked for.
//!
//! [`FlowDataset::open`] lists a dataset's pairs without decoding anything; [`FlowDataset::read`] decodes one of them, on
//! as many threads as one likes. What differs between datasets (where files lie, which of the truth counts) is behind the
//! trait `Reader`, one file per dataset.

mod chairs;
mod error;
mod facialflownet;
mod gaps;
mod hd1k;
mod kind;
mod kitti;
pub(crate) mod listing;
mod plain;
mod sample;
mod sequence;
mod sintel;
mod split;
mod spring;
mod srflow;
mod things;
mod triplets;

use std::path::{Path, PathBuf};

pub use error::DatasetError;
pub use kind::{DatasetSpec, KINDS, Kind};
pub use listing::pictures;
pub use sample::{Sample, TruthDensity};
pub use split::Split;

use gaps::Gaps;
use sample::Truth;

/// One pair of frames of a dataset: its place in it and its files. Nothing is decoded.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Entry {
    /// The sequence that the pair belongs to, e.g. `alley_1`; empty where pairs stand alone.
    pub scene: String,
    /// Name of the pair within its scene: mostly that of frame 1's file without its ending, e.g. `frame_0001`.
    pub frame: String,
    /// File of frame 1.
    pub frame1: PathBuf,
    /// File of frame 2.
    pub frame2: PathBuf,
    /// File of the true flow from frame 1 to frame 2, where it is published.
    pub flow: Option<PathBuf>,
    /// File of the mask of the head in frame 1, where there is one.
    pub mask: Option<PathBuf>,
    /// What tells the pixels of frame 1 that frame 2 does not show, where there is something.
    pub occlusion: Option<Occlusion>,
}

impl Entry {
    /// `scene/frame`, or the frame alone where there is no scene: names the pair within its dataset.
    pub fn id(&self) -> String {
        if self.scene.is_empty() { self.frame.clone() } else { format!("{}/{}", self.scene, self.frame) }
    }

    /// The files of the pair.
    pub fn files(&self) -> impl Iterator<Item = &Path> {
        let occlusion = self.occlusion.as_ref().map(|occlusion| match occlusion {
            Occlusion::Picture(path) | Occlusion::VisibleFlow(path) => path,
        });
        let optional = [self.flow.as_ref(), self.mask.as_ref(), occlusion];
        [&self.frame1, &self.frame2].into_iter().chain(optional.into_iter().flatten()).map(PathBuf::as_path)
    }
}

/// What tells which pixels of frame 1 are hidden in frame 2.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Occlusion {
    /// A picture that is white where the pixel is hidden.
    Picture(PathBuf),
    /// A flow file that holds the visible pixels only: hidden are those which only the entry's own flow knows (KITTI).
    VisibleFlow(PathBuf),
}

/// A dataset whose pairs are listed, ready to be read.
#[derive(Debug, Clone)]
pub struct FlowDataset {
    name: String,
    dir: PathBuf,
    split: Split,
    entries: Vec<Entry>,
    truth: Truth,
}

/// What sets one dataset apart from the others.
trait Reader {
    /// The kind with the options that matter, as tables show it, e.g. `sintel-clean`.
    fn name(&self) -> String;

    /// The split that is read when none is asked for: the one that results are reported on.
    fn default_split(&self) -> Split;

    /// Which of the published truth counts.
    fn truth(&self) -> Truth {
        Truth::default()
    }

    /// Lists the pairs of one split under `dir`. What is missing or left over goes to `gaps`.
    fn pairs(&self, dir: &Path, split: Split, gaps: &mut Gaps) -> Result<Vec<Entry>, DatasetError>;
}

impl FlowDataset {
    /// Lists the pairs of one split of a dataset; without a split, of the one that results are reported on.
    ///
    /// # Errors
    /// When the folder is not laid out as its kind needs, holds no pair, or holds files without their counterparts.
    pub fn open(spec: &DatasetSpec, split: Option<Split>) -> Result<Self, DatasetError> {
        let reader = kind::reader_of(&spec.kind)?;
        let name = reader.name();
        let split = split.unwrap_or_else(|| reader.default_split());
        let mut gaps = Gaps::new(name.clone(), &spec.dir);
        let entries = reader.pairs(&spec.dir, split, &mut gaps)?;
        gaps.finish()?;
        if entries.is_empty() {
            return Err(listing::nothing_fits(
                &name,
                &spec.dir,
                "",
                &format!("No pair of the {split} split is there"),
            ));
        }
        Ok(Self { name, dir: spec.dir.clone(), split, entries, truth: reader.truth() })
    }

    /// A dataset of one pair, whose files may lie anywhere and are not opened yet.
    pub fn of_pair(frame1: PathBuf, frame2: PathBuf, flow: PathBuf) -> Self {
        let dir = frame1.parent().unwrap_or(Path::new("")).to_owned();
        let frame = listing::stem(&frame1);
        let (scene, flow) = (String::new(), Some(flow));
        let entry = Entry { scene, frame, frame1, frame2, flow, mask: None, occlusion: None };
        Self {
            name: "pair".to_owned(),
            dir,
            split: Split::All,
            entries: vec![entry],
            truth: Truth::default(),
        }
    }

    /// The kind with the options that matter, e.g. `sintel-clean`.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// The dataset's folder.
    pub fn dir(&self) -> &Path {
        &self.dir
    }

    /// The split that was listed.
    pub fn split(&self) -> Split {
        self.split
    }

    /// The pairs, by scene and in the order of time within each.
    pub fn entries(&self) -> &[Entry] {
        &self.entries
    }

    /// How much of the true flow is known, as the dataset's reader says.
    pub fn density(&self) -> TruthDensity {
        self.truth.density
    }

    /// Decodes one of the dataset's pairs. A pixel of the truth that is too fast to count (10000 px; FlyingThings3D and
    /// FacialFlowNet 1000; KITTI and HD1K 512) comes as unknown.
    ///
    /// # Errors
    /// When a file cannot be read, is broken, or is not of frame 1's size.
    pub fn read(&self, entry: &Entry) -> Result<Sample, DatasetError> {
        self.truth.read(entry)
    }
}
