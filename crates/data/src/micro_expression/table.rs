//! The table of kinds.

use std::path::Path;
use std::str::FromStr;

use super::source::{ClipKind, ClipSource};
use super::{MicroExpressionError, casme2, plain, samm, smic};

pub static CLIP_KINDS: [ClipKind; 4] = [samm::KIND, casme2::KIND, smic::KIND, plain::KIND];

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
        Ok(Self { release, ..Self::new(kind, Path::new(dir)) })
    }
}

srflow_core::serialize_as_text!(ClipSource);

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
