use std::path::{Path, PathBuf};

use super::entry::Entry;
use super::error::DatasetError;
use super::gaps::Gaps;
use super::kind::Request;
use super::layout;
use super::sample::{Sample, Truth, TruthDensity};
use super::split::Split;
use super::table::{DatasetSpec, kind_of};

/// A dataset whose pairs are listed.
#[derive(Debug, Clone)]
pub struct FlowDataset {
    name: String,
    dir: PathBuf,
    split: Split,
    entries: Vec<Entry>,
    truth: Truth,
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
        let (kind, options) = kind_of(&spec.kind)?;
        let split = split.unwrap_or(kind.default_split);
        let request = Request { title: kind.title(&options), options, dir: &spec.dir, split };
        let mut gaps = Gaps::new(request.title.clone(), &spec.dir, Box::new(on_pairs));
        let entries = (kind.pairs)(&request, &mut gaps)?;
        gaps.finish()?;
        if entries.is_empty() {
            return Err(layout::nothing_fits(
                &request.title,
                &spec.dir,
                "",
                &format!("The {split} split has no pair"),
            ));
        }
        Ok(Self { name: request.title, dir: spec.dir.clone(), split, entries, truth: kind.truth })
    }

    /// A dataset of one pair, whose files may be anywhere and are not opened yet.
    pub fn of_pair(frame1: PathBuf, frame2: PathBuf, flow: PathBuf) -> Self {
        let dir = frame1.parent().unwrap_or(Path::new("")).to_owned();
        let entry = Entry { flow: Some(flow.into()), ..Entry::bare(String::new(), frame1, frame2) };
        Self { name: "pair".to_owned(), dir, split: Split::All, entries: vec![entry], truth: Truth::USUAL }
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
