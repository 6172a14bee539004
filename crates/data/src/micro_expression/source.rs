use std::collections::BTreeMap;
use std::fmt;
use std::path::{Path, PathBuf};

use super::frames::ClipFolders;
use super::{Annotation, Classes, Labels, MicroExpressionError};

/// A kind of micro-expression dataset: its names and readers.
#[derive(Debug)]
pub struct ClipKind {
    /// The name in `KIND:DIR`, e.g. `casme2`.
    pub name: &'static str,
    /// Releases that may follow after a hyphen; without one, the release that is found is read.
    pub releases: &'static [&'static str],
    /// Title in the help.
    pub about: &'static str,
    /// The paper's counts of negative, positive and surprise clips (its table of the micro-expression datasets).
    pub published: Option<[usize; 3]>,
    /// The counts of MEGC 2019's list.
    pub megc2019: Option<[usize; 3]>,
    /// Whether a list of apex frames may be given.
    pub takes_apex_list: bool,
    pub(super) labels: fn(&ClipSource) -> Result<Labels, MicroExpressionError>,
    pub(super) folders: fn(&ClipSource, &[Annotation]) -> Result<ClipFolders, MicroExpressionError>,
}

impl ClipKind {
    /// A kind with one release, which is on none of the published lists.
    pub(super) const fn new(
        name: &'static str,
        about: &'static str,
        labels: fn(&ClipSource) -> Result<Labels, MicroExpressionError>,
        folders: fn(&ClipSource, &[Annotation]) -> Result<ClipFolders, MicroExpressionError>,
    ) -> Self {
        Self {
            name,
            releases: &[],
            about,
            published: None,
            megc2019: None,
            takes_apex_list: true,
            labels,
            folders,
        }
    }
}

impl fmt::Display for ClipKind {
    /// `casme2[-raw|-cropped]`.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name)?;
        if self.releases.is_empty() { Ok(()) } else { write!(f, "[-{}]", self.releases.join("|-")) }
    }
}

impl PartialEq for ClipKind {
    fn eq(&self, other: &Self) -> bool {
        self.name == other.name
    }
}

impl Eq for ClipKind {}

/// A micro-expression dataset on disk, as in `KIND:DIR`.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ClipSource {
    pub kind: &'static ClipKind,
    /// The requested release.
    pub release: Option<&'static str>,
    /// Its folder, which contains annotations and frames; for plain clips it may be the CSV file.
    pub dir: PathBuf,
    /// The annotation file, if elsewhere.
    pub annotations: Option<PathBuf>,
    /// A list of apex frames, for clips whose annotated apex cannot be used. SMIC's own is found in its folder.
    pub apex_list: Option<PathBuf>,
    /// Whether apexes are spotted later: keep clips whose annotated apex cannot be used, unless the published list of `classes` leaves
    /// them out.
    pub spots_apexes: bool,
    pub classes: Classes,
    /// Require only the onset and apex frames of a clip. Without an annotated apex, it is the single frame between onset and
    /// offset.
    pub only_key_frames: bool,
    /// Folders with the frames of clips that are videos, by the video's path: its first frame is number 1.
    pub frames_of_videos: BTreeMap<PathBuf, PathBuf>,
}

impl ClipSource {
    /// The dataset of this kind in a folder.
    pub(crate) fn new(kind: &'static ClipKind, dir: &Path) -> Self {
        Self {
            kind,
            release: None,
            dir: dir.to_owned(),
            annotations: None,
            apex_list: None,
            spots_apexes: false,
            classes: Classes::default(),
            only_key_frames: false,
            frames_of_videos: BTreeMap::new(),
        }
    }

    /// Whether the classes come with a published list of this dataset's clips.
    pub fn published_list(&self) -> bool {
        let listed = self.classes.are_default() || self.classes.are_of_megc2019();
        listed && self.kind.published.is_some()
    }
}

impl fmt::Display for ClipSource {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.kind.name)?;
        if let Some(release) = self.release {
            write!(f, "-{release}")?;
        }
        write!(f, ":{}", self.dir.display())
    }
}
