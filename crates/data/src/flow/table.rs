use std::fmt;
use std::path::{Path, PathBuf};
use std::str::FromStr;

use super::error::DatasetError;
use super::kind::Kind;
use super::{chairs, clips, facialflownet, hd1k, kitti, plain, sintel, spring, srflow, things, wds};

pub static KINDS: [Kind; 11] = [
    srflow::KIND,
    plain::KIND,
    chairs::KIND,
    things::KIND,
    sintel::KIND,
    kitti::KIND,
    hd1k::KIND,
    spring::KIND,
    facialflownet::KIND,
    clips::KIND,
    wds::KIND,
];

/// The value of `--dataset KIND:DIR`: a kind of dataset and its folder.
///
/// A kind is a name followed by options in any order, each after a hyphen: `sintel-final`, `things-clean-backward-right`.
/// An omitted option takes its default; [`KINDS`] lists them.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct DatasetSpec {
    /// Kind of dataset, e.g. `sintel-clean`.
    pub kind: String,
    pub dir: PathBuf,
}

impl fmt::Display for DatasetSpec {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}:{}", self.kind, self.dir.display())
    }
}

srflow_core::serialize_as_text!(DatasetSpec);

impl FromStr for DatasetSpec {
    type Err = DatasetError;

    /// Parses `KIND:DIR`; the folder may contain colons. The kind is checked, the folder is not opened.
    fn from_str(text: &str) -> Result<Self, DatasetError> {
        let wrong = || DatasetError::NotKindAndFolder { found: text.to_owned(), known: known_kinds() };
        let (kind, dir) = text.split_once(':').ok_or_else(wrong)?;
        if kind.is_empty() || dir.is_empty() {
            return Err(wrong());
        }
        kind_of(kind)?;
        Ok(Self { kind: kind.to_owned(), dir: Path::new(dir).to_owned() })
    }
}

/// A kind by its name with options, and one option from every list.
pub(super) fn kind_of(text: &str) -> Result<(&'static Kind, Vec<&'static str>), DatasetError> {
    let unknown = |reason| DatasetError::UnknownKind { kind: text.to_owned(), reason };
    let mut words = text.split('-');
    let name = words.next().unwrap_or_default();
    let Some(kind) = KINDS.iter().find(|kind| kind.name == name) else {
        return Err(unknown(format!("unknown kind. Kinds: {}", known_kinds())));
    };
    let mut left: Vec<&str> = words.collect();
    let mut choose = |choices: &&[&'static str]| {
        let given =
            choices.iter().find_map(|choice| Some((left.iter().position(|word| word == choice)?, *choice)));
        given.map_or(choices[0], |(at, choice)| {
            left.remove(at);
            choice
        })
    };
    let chosen: Vec<&'static str> = kind.options.iter().map(&mut choose).collect();
    match left.first() {
        None => Ok((kind, chosen)),
        Some(word) if kind.options.is_empty() => {
            Err(unknown(format!("`{word}` is not an option here; {name} takes none")))
        }
        Some(word) => {
            let offered: Vec<String> = kind.options.iter().map(|choices| choices.join("|")).collect();
            let offered = offered.join(", ");
            Err(unknown(format!("`{word}` is not an option here; {name} takes one of each: {offered}")))
        }
    }
}

fn known_kinds() -> String {
    let names: Vec<String> = KINDS.iter().map(Kind::to_string).collect();
    names.join(", ")
}
