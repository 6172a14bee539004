//! Readers: every dataset becomes a list of image pairs, read on demand.
//!
//! [`FlowDataset::open`] lists a dataset's pairs without decoding; [`FlowDataset::read`] decodes one of them, and may be
//! called from several threads. The differences between datasets (paths, valid ground truth) are behind the trait `Reader`, one
//! file per dataset.

mod chairs;
mod clips;
mod error;
mod facialflownet;
mod file;
mod gaps;
mod hd1k;
mod kind;
mod kitti;
pub(crate) mod listing;
mod made;
mod plain;
mod sample;
mod sequence;
mod sintel;
mod split;
mod spring;
mod srflow;
mod things;
mod triplets;
mod wds;

use std::path::{Path, PathBuf};

pub use error::DatasetError;
pub use file::EntryFile;
pub use kind::{DatasetSpec, KINDS, Kind};
pub use listing::{flow_files, pictures};
pub use made::{MadeError, MadePairs, SCENES_AT_ONCE};
pub use sample::{Sample, TruthDensity};
pub use split::Split;

use gaps::Gaps;
use sample::Truth;

/// One pair of frames of a dataset: its name and its files, not decoded.
#[derive(Debug, Clone, PartialEq)]
pub struct Entry {
    /// The sequence that the pair belongs to, e.g. `alley_1`; empty for single pairs.
    pub scene: String,
    /// Name of the pair within its scene: usually the stem of frame 1's file, e.g. `frame_0001`.
    pub frame: String,
    /// File of frame 1.
    pub frame1: EntryFile,
    /// File of frame 2.
    pub frame2: EntryFile,
    /// File of the true flow from frame 1 to frame 2, if published.
    pub flow: Option<EntryFile>,
    /// File of the mask of the head in frame 1, if there is one.
    pub mask: Option<EntryFile>,
    /// Source of the occlusions of frame 1, if there is one.
    pub occlusion: Option<Occlusion>,
    /// File of the [region map](crate::region_map) of frame 1, if there is one.
    pub regions: Option<EntryFile>,
    /// File of the depth of frame 1, if there is one: see [`Entry::read_depth`].
    pub depth: Option<EntryFile>,
}

impl Entry {
    /// `scene/frame`, or the frame alone without a scene: unique within the dataset.
    pub fn id(&self) -> String {
        if self.scene.is_empty() { self.frame.clone() } else { format!("{}/{}", self.scene, self.frame) }
    }

    /// The files of the pair.
    pub fn files(&self) -> impl Iterator<Item = &EntryFile> {
        let occlusion = self.occlusion.as_ref().map(Occlusion::file);
        let optional =
            [self.flow.as_ref(), self.mask.as_ref(), occlusion, self.regions.as_ref(), self.depth.as_ref()];
        [&self.frame1, &self.frame2].into_iter().chain(optional.into_iter().flatten())
    }
}

/// The source of the pixels of frame 1 that are occluded in frame 2.
#[derive(Debug, Clone, PartialEq)]
pub enum Occlusion {
    /// A picture, white where a pixel is occluded.
    Picture(EntryFile),
    /// A flow file with the visible pixels only: pixels known only in the entry's own flow are occluded (KITTI).
    VisibleFlow(EntryFile),
}

impl Occlusion {
    fn file(&self) -> &EntryFile {
        match self {
            Self::Picture(file) | Self::VisibleFlow(file) => file,
        }
    }
}

/// A dataset whose pairs are listed.
#[derive(Debug, Clone)]
pub struct FlowDataset {
    name: String,
    dir: PathBuf,
    split: Split,
    entries: Vec<Entry>,
    truth: Truth,
}

/// The dataset-specific part of reading.
trait Reader {
    /// Kind with the options that matter, as shown in tables, e.g. `sintel-clean`.
    fn name(&self) -> String;

    /// The default split: the one that results are reported on.
    fn default_split(&self) -> Split;

    /// Which part of the published ground truth is valid.
    fn truth(&self) -> Truth {
        Truth::default()
    }

    /// Lists the pairs of one split under `dir`. Missing and extra files go to `gaps`.
    fn pairs(&self, dir: &Path, split: Split, gaps: &mut Gaps) -> Result<Vec<Entry>, DatasetError>;
}

impl FlowDataset {
    /// Lists the pairs of one split of a dataset; `None` means the one that results are reported on.
    ///
    /// # Errors
    /// When the folder does not have the layout of its kind, contains no pair, or files lack their counterparts.
    pub fn open(spec: &DatasetSpec, split: Option<Split>) -> Result<Self, DatasetError> {
        Self::open_watched(spec, split, |_| {})
    }

    /// [`FlowDataset::open`], which calls `on_pairs` with the number of pairs that were listed so far, of datasets that may have millions.
    ///
    /// # Errors
    /// Those of [`FlowDataset::open`].
    pub fn open_watched(
        spec: &DatasetSpec,
        split: Option<Split>,
        on_pairs: impl Fn(u64),
    ) -> Result<Self, DatasetError> {
        let reader = kind::reader_of(&spec.kind)?;
        let name = reader.name();
        let split = split.unwrap_or_else(|| reader.default_split());
        let mut gaps = Gaps::new(name.clone(), &spec.dir, Box::new(on_pairs));
        let entries = reader.pairs(&spec.dir, split, &mut gaps)?;
        gaps.finish()?;
        if entries.is_empty() {
            return Err(listing::nothing_fits(
                &name,
                &spec.dir,
                "",
                &format!("The {split} split has no pair"),
            ));
        }
        Ok(Self { name, dir: spec.dir.clone(), split, entries, truth: reader.truth() })
    }

    /// A dataset of one pair, whose files may be anywhere and are not opened yet.
    pub fn of_pair(frame1: PathBuf, frame2: PathBuf, flow: PathBuf) -> Self {
        let dir = frame1.parent().unwrap_or(Path::new("")).to_owned();
        let frame = listing::stem(&frame1);
        let entry = Entry {
            scene: String::new(),
            frame,
            frame1: frame1.into(),
            frame2: frame2.into(),
            flow: Some(flow.into()),
            mask: None,
            occlusion: None,
            regions: None,
            depth: None,
        };
        Self {
            name: "pair".to_owned(),
            dir,
            split: Split::All,
            entries: vec![entry],
            truth: Truth::default(),
        }
    }

    /// The dataset with these of its pairs alone, by their numbers, in this order. Panics when there is no such pair.
    pub fn only(mut self, pairs: &[usize]) -> Self {
        self.entries = pairs.iter().map(|&pair| self.entries[pair].clone()).collect();
        self
    }

    /// Kind with the options that matter, e.g. `sintel-clean`.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// The dataset's folder; for tars on the web their address.
    pub fn dir(&self) -> &Path {
        &self.dir
    }

    /// The split that was listed.
    pub fn split(&self) -> Split {
        self.split
    }

    /// The pairs, by scene and in temporal order within each.
    pub fn entries(&self) -> &[Entry] {
        &self.entries
    }

    /// How much of the true flow is known.
    pub fn density(&self) -> TruthDensity {
        self.truth.density
    }

    /// Decodes one of the dataset's pairs. Ground truth at or above the dataset's limit (10000 px; FlyingThings3D and
    /// FacialFlowNet 1000; KITTI and HD1K 512) is returned as unknown.
    ///
    /// # Errors
    /// When a file cannot be read, is corrupt, or has another size than frame 1.
    pub fn read(&self, entry: &Entry) -> Result<Sample, DatasetError> {
        self.truth.read(entry)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A list of a million pairs is in memory at once.
    #[test]
    fn pairs_are_small() {
        assert!(size_of::<Entry>() <= 272, "{}", size_of::<Entry>());
        let mut folders = file::Folders::default();
        let [one, other] = ["d/e/1.png", "d/e/2.png"].map(|path| folders.file(path.into()));
        let (EntryFile::OnDisk { folder, .. }, EntryFile::OnDisk { folder: same, .. }) = (&one, &other)
        else {
            panic!("{one:?}")
        };
        assert!(std::sync::Arc::ptr_eq(folder, same));
        assert_eq!((one.path(), &other), (PathBuf::from("d/e/1.png"), &PathBuf::from("d/e/2.png").into()));
        assert_eq!(EntryFile::from(PathBuf::from("..")).path(), PathBuf::from(".."));
    }
}
