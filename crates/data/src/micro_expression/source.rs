use std::fmt;
use std::path::{Path, PathBuf};
use std::str::FromStr;

use super::frames::ClipFolders;
use super::sheet::Form;
use super::{Annotation, Classes, Labels, MicroExpressionError, casme2, plain, samm, smic};

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
    /// Its annotation spreadsheet, if it has one.
    pub(super) form: Option<&'static Form>,
    /// Reads its annotations.
    pub(super) labels: fn(&ClipSource) -> Result<Labels, MicroExpressionError>,
    /// Finds the folders of the annotated clips.
    pub(super) folders: fn(&ClipSource, &[Annotation]) -> Result<ClipFolders, MicroExpressionError>,
}

/// The kinds of micro-expression dataset.
pub static CLIP_KINDS: [ClipKind; 4] = [samm::KIND, casme2::KIND, smic::KIND, plain::KIND];

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
    /// The list of apex frames for SMIC, if elsewhere.
    pub apex_list: Option<PathBuf>,
    pub classes: Classes,
    /// Require only the onset and apex frames of a clip. Without an annotated apex, it is the single frame between onset and
    /// offset.
    pub only_key_frames: bool,
}

impl FromStr for ClipSource {
    type Err = MicroExpressionError;

    /// Parses `KIND:DIR`; the folder may contain colons. Nothing is opened.
    fn from_str(text: &str) -> Result<Self, MicroExpressionError> {
        let wrong = || {
            let known: Vec<String> = CLIP_KINDS.iter().map(ClipKind::to_string).collect();
            MicroExpressionError::NotKindAndFolder { found: text.to_owned(), known: known.join(", ") }
        };
        let (word, dir) = text.split_once(':').filter(|(_, dir)| !dir.is_empty()).ok_or_else(wrong)?;
        let (name, release) =
            word.split_once('-').map_or((word, None), |(name, release)| (name, Some(release)));
        let kind = CLIP_KINDS.iter().find(|kind| kind.name == name).ok_or_else(wrong)?;
        let known =
            |word: &str| kind.releases.iter().find(|known| **known == word).copied().ok_or_else(wrong);
        let release = release.map(known).transpose()?;
        Ok(Self { kind, release, ..Self::plain(Path::new(dir)) })
    }
}

srflow_core::serialize_as_text!(ClipSource);

impl ClipSource {
    /// Plain clips in a folder.
    pub(crate) fn plain(dir: &Path) -> Self {
        Self {
            kind: &plain::KIND,
            release: None,
            dir: dir.to_owned(),
            annotations: None,
            apex_list: None,
            classes: Classes::default(),
            only_key_frames: false,
        }
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn kinds_and_folders_are_read_back() {
        for text in ["samm:/data/SAMM", "casme2:x", "casme2-cropped:c:\\CASME2", "smic:a:b", "clips:mine"] {
            assert_eq!(text.parse::<ClipSource>().unwrap().to_string(), text);
        }
    }

    #[test]
    fn errors_list_the_kinds() {
        for text in ["", "samm", "samm:", "casme:/data", "casme2-RAW:x", "/data/SAMM"] {
            let error = text.parse::<ClipSource>().unwrap_err().to_string();
            assert!(error.contains("casme2[-raw|-cropped]") && error.contains("KIND:DIR"), "{error}");
        }
    }
}
