//! The table of kinds.

use std::path::Path;
use std::str::FromStr;

use super::source::{ClipKind, ClipSource};
use super::{
    MicroExpressionError, casme, casme_squared, casme2, casme3, casme3_c, dfme, four_dme, mmew, plain, samm,
    smic,
};

pub static CLIP_KINDS: [ClipKind; 13] = [
    samm::KIND,
    casme2::KIND,
    smic::KIND,
    smic::VIS_KIND,
    smic::NIR_KIND,
    casme::KIND,
    casme_squared::KIND,
    casme3::KIND,
    casme3_c::KIND,
    mmew::KIND,
    four_dme::KIND,
    dfme::KIND,
    plain::KIND,
];

impl FromStr for ClipSource {
    type Err = MicroExpressionError;

    /// Parses `KIND:DIR`; the folder may contain colons. Nothing is opened.
    fn from_str(text: &str) -> Result<Self, MicroExpressionError> {
        let wrong = || {
            let known: Vec<String> = CLIP_KINDS.iter().map(ClipKind::to_string).collect();
            MicroExpressionError::NotKindAndFolder { found: text.to_owned(), known: known.join(", ") }
        };
        let (word, dir) = text.split_once(':').filter(|(_, dir)| !dir.is_empty()).ok_or_else(wrong)?;
        // Names of kinds have hyphens too.
        let named = |kind: &'static ClipKind| match word.strip_prefix(kind.name)? {
            "" => Some((kind, None)),
            rest => {
                let release = rest.strip_prefix('-')?;
                let known = kind.releases.iter().find(|known| **known == release)?;
                Some((kind, Some(*known)))
            }
        };
        let (kind, release) = CLIP_KINDS.iter().find_map(named).ok_or_else(wrong)?;
        Ok(Self { release, ..Self::new(kind, Path::new(dir)) })
    }
}

srflow_core::serialize_as_text!(ClipSource);

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn kinds_and_folders_are_read_back() {
        for text in [
            "samm:/data/SAMM",
            "casme2:x",
            "casme2-cropped:c:\\CASME2",
            "smic:a:b",
            "smic-vis:a",
            "casme-squared:x",
            "casme-squared-raw:x",
            "clips:mine",
        ] {
            assert_eq!(text.parse::<ClipSource>().unwrap().to_string(), text);
        }
    }

    #[test]
    fn errors_list_the_kinds() {
        for text in ["", "samm", "samm:", "casme4:/data", "casme2-RAW:x", "smic-uv:x", "/data/SAMM"] {
            let error = text.parse::<ClipSource>().unwrap_err().to_string();
            assert!(error.contains("casme2[-raw|-cropped]") && error.contains("KIND:DIR"), "{error}");
        }
    }
}
