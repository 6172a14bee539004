use std::fmt;
use std::path::PathBuf;
use std::str::FromStr;

use super::MicroExpressionError;

/// The kinds of micro-expression dataset and what they are.
pub const CLIP_KINDS: &[(&str, &str)] = &[
    ("samm", "SAMM"),
    ("casme2[-raw|-cropped]", "CASME II, the raw or the cropped release (default: the one that is there)"),
    ("smic", "SMIC-HS, extended or short"),
    ("clips", "anybody's clips, listed in a clips.csv"),
];

/// A kind of micro-expression dataset.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ClipKind {
    /// SAMM.
    Samm,
    /// CASME II; without a release, the one that is there.
    Casme2(Option<Release>),
    /// SMIC-HS.
    Smic,
    /// Clips listed in a CSV file.
    Clips,
}

/// A release of CASME II.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Release {
    /// Whole frames: `CASME2_RAW_selected`.
    Raw,
    /// Aligned faces: `Cropped_original`.
    Cropped,
}

impl ClipKind {
    /// The name before the options, e.g. `casme2`.
    pub fn name(self) -> &'static str {
        match self {
            Self::Samm => "samm",
            Self::Casme2(_) => "casme2",
            Self::Smic => "smic",
            Self::Clips => "clips",
        }
    }
}

/// A micro-expression dataset on disk, as `KIND:DIR` names it.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ClipSource {
    /// Kind of dataset.
    pub kind: ClipKind,
    /// Its folder, in which annotations and frames are looked for; of plain clips it may be the CSV file.
    pub dir: PathBuf,
    /// The annotation file, when it lies elsewhere.
    pub annotations: Option<PathBuf>,
    /// The list of apex frames for SMIC, when it lies elsewhere.
    pub apex_list: Option<PathBuf>,
}

impl FromStr for ClipSource {
    type Err = MicroExpressionError;

    /// Reads `KIND:DIR`; the folder may hold further colons. Nothing is opened.
    fn from_str(text: &str) -> Result<Self, MicroExpressionError> {
        let wrong = || {
            let known: Vec<&str> = CLIP_KINDS.iter().map(|(kind, _)| *kind).collect();
            MicroExpressionError::NotKindAndFolder { found: text.to_owned(), known: known.join(", ") }
        };
        let (kind, dir) = text.split_once(':').filter(|(_, dir)| !dir.is_empty()).ok_or_else(wrong)?;
        let kind = match kind {
            "samm" => ClipKind::Samm,
            "casme2" => ClipKind::Casme2(None),
            "casme2-raw" => ClipKind::Casme2(Some(Release::Raw)),
            "casme2-cropped" => ClipKind::Casme2(Some(Release::Cropped)),
            "smic" => ClipKind::Smic,
            "clips" => ClipKind::Clips,
            _ => return Err(wrong()),
        };
        Ok(Self { kind, dir: dir.into(), annotations: None, apex_list: None })
    }
}

impl fmt::Display for ClipSource {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let release = match self.kind {
            ClipKind::Casme2(Some(Release::Raw)) => "-raw",
            ClipKind::Casme2(Some(Release::Cropped)) => "-cropped",
            _ => "",
        };
        write!(f, "{}{release}:{}", self.kind.name(), self.dir.display())
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
    fn other_texts_are_told_the_kinds() {
        for text in ["", "samm", "samm:", "casme:/data", "casme2-RAW:x", "/data/SAMM"] {
            let error = text.parse::<ClipSource>().unwrap_err().to_string();
            assert!(error.contains("casme2[-raw|-cropped]") && error.contains("KIND:DIR"), "{error}");
        }
    }
}
