use std::fmt;
use std::path::{Path, PathBuf};
use std::str::FromStr;

use super::Reader;
use super::chairs::FlyingChairs;
use super::error::DatasetError;
use super::facialflownet::FacialFlowNet;
use super::hd1k::Hd1k;
use super::kitti::Kitti;
use super::plain::Plain;
use super::sequence::Direction;
use super::sintel::Sintel;
use super::spring::Spring;
use super::srflow::SrFlow;
use super::things::FlyingThings3D;

/// The kinds of dataset: name with its options, the default of each choice first, and what it is.
pub const KINDS: &[(&str, &str)] = &[
    ("srflow[-forward|-backward]", "SRFlow, as `srflow render` makes it"),
    ("folder", "a plain folder of image pairs"),
    ("chairs", "FlyingChairs"),
    ("things[-clean|-final][-forward|-backward][-left|-right]", "FlyingThings3D"),
    ("sintel[-clean|-final]", "MPI Sintel"),
    ("kitti[-2015|-2012]", "KITTI flow of either year"),
    ("hd1k", "HD1K"),
    ("spring[-forward|-backward][-left|-right]", "Spring"),
    ("facialflownet[-facial|-head]", "FacialFlowNet"),
];

/// What `--dataset KIND:DIR` says: a kind of dataset and the folder it lies in.
///
/// A kind is a name followed by options, in any order, each after a hyphen: `sintel-final`, `things-clean-backward-right`.
/// An option left out takes its default, the first of its choices in [`KINDS`].
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct DatasetSpec {
    /// Kind of dataset, e.g. `sintel-clean`.
    pub kind: String,
    /// The dataset's folder.
    pub dir: PathBuf,
}

impl fmt::Display for DatasetSpec {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}:{}", self.kind, self.dir.display())
    }
}

impl FromStr for DatasetSpec {
    type Err = DatasetError;

    /// Reads `KIND:DIR`; the folder may hold further colons. The kind is checked, the folder is not opened.
    fn from_str(text: &str) -> Result<Self, DatasetError> {
        let wrong = || DatasetError::NotKindAndFolder { found: text.to_owned(), known: known_kinds() };
        let (kind, dir) = text.split_once(':').ok_or_else(wrong)?;
        if kind.is_empty() || dir.is_empty() {
            return Err(wrong());
        }
        reader_of(kind)?;
        Ok(Self { kind: kind.to_owned(), dir: Path::new(dir).to_owned() })
    }
}

/// The reader that a kind names.
pub(super) fn reader_of(kind: &str) -> Result<Box<dyn Reader>, DatasetError> {
    let mut options = Options::new(kind);
    let reader: Box<dyn Reader> = match options.name {
        "srflow" => Box::new(SrFlow { direction: options.direction() }),
        "chairs" => Box::new(FlyingChairs),
        "things" => Box::new(FlyingThings3D {
            pass: options.choose(&["clean", "final"]),
            direction: options.direction(),
            camera: options.choose(&["left", "right"]),
        }),
        "sintel" => Box::new(Sintel { pass: options.choose(&["clean", "final"]) }),
        "kitti" => Box::new(Kitti { year: options.choose(&["2015", "2012"]) }),
        "hd1k" => Box::new(Hd1k),
        "spring" => {
            Box::new(Spring { direction: options.direction(), camera: options.choose(&["left", "right"]) })
        }
        "facialflownet" => Box::new(FacialFlowNet { motion: options.choose(&["facial", "head"]) }),
        "folder" => Box::new(Plain),
        _ => {
            return Err(DatasetError::UnknownKind {
                kind: kind.to_owned(),
                reason: format!("there is none of that name. Kinds: {}", known_kinds()),
            });
        }
    };
    options.finish()?;
    Ok(reader)
}

fn known_kinds() -> String {
    let names: Vec<&str> = KINDS.iter().map(|(kind, _)| *kind).collect();
    names.join(", ")
}

/// The options of a kind, taken one after the other by the reader that knows them.
struct Options<'a> {
    kind: &'a str,
    name: &'a str,
    left: Vec<&'a str>,
    offered: Vec<String>,
}

impl<'a> Options<'a> {
    fn new(kind: &'a str) -> Self {
        let mut words = kind.split('-');
        Self { kind, name: words.next().unwrap_or_default(), left: words.collect(), offered: Vec::new() }
    }

    /// The one of `choices` that was given, or the first.
    fn choose(&mut self, choices: &[&'static str]) -> &'static str {
        self.offered.push(choices.join("|"));
        for &choice in choices {
            if let Some(at) = self.left.iter().position(|word| *word == choice) {
                self.left.remove(at);
                return choice;
            }
        }
        choices.first().copied().unwrap_or_default()
    }

    fn direction(&mut self) -> Direction {
        match self.choose(&["forward", "backward"]) {
            "backward" => Direction::Backward,
            _ => Direction::Forward,
        }
    }

    /// Refuses what no choice took.
    fn finish(self) -> Result<(), DatasetError> {
        let Some(first) = self.left.first() else { return Ok(()) };
        let offered = if self.offered.is_empty() {
            format!("{} takes none", self.name)
        } else {
            format!("{} takes one of each: {}", self.name, self.offered.join(", "))
        };
        let reason = format!("`{first}` is not an option here; {offered}");
        Err(DatasetError::UnknownKind { kind: self.kind.to_owned(), reason })
    }
}
