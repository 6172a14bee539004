//! Configuration values that are written as strings.

use std::fmt;
use std::str::FromStr;

use srflow_data::flow::{DatasetError, DatasetSpec, Split};

/// A dataset in a mix: `KIND:DIR`, then `@SPLIT` for a split other than the default, then `*TIMES` to repeat each pair that often
/// in an epoch, e.g. `sintel-clean:/data/Sintel@all*100`. Data that is made while training has no splits.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Source {
    pub spec: DataSpec,
    /// `None` for the default split.
    pub split: Option<Split>,
    /// Occurrences of each pair in an epoch, at least 1.
    pub times: usize,
}

/// A dataset in files, or one that is made while training.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum DataSpec {
    Files(DatasetSpec),
    Made(MadeSpec),
}

/// Data that is made while training: `shapes:TEXTURES_DIR` or `rendered:HEAD`.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct MadeSpec {
    pub kind: MadeKind,
    /// The folder or the head, not looked at; may be empty.
    pub of: String,
}

/// The kinds of data that is made while training.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum MadeKind {
    Shapes,
    Rendered,
}

srflow_core::named!(MadeKind, "a kind of made data", { Shapes => "shapes", Rendered => "rendered" });

impl Source {
    /// The dataset, if it is in files.
    pub fn files(&self) -> Option<&DatasetSpec> {
        match &self.spec {
            DataSpec::Files(spec) => Some(spec),
            DataSpec::Made(_) => None,
        }
    }

    /// The data, if it is made while training.
    pub fn made(&self) -> Option<&MadeSpec> {
        match &self.spec {
            DataSpec::Files(_) => None,
            DataSpec::Made(spec) => Some(spec),
        }
    }
}

impl fmt::Display for MadeSpec {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}:{}", self.kind, self.of)
    }
}

impl fmt::Display for Source {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match &self.spec {
            DataSpec::Files(spec) => spec.fmt(f)?,
            DataSpec::Made(spec) => spec.fmt(f)?,
        }
        if let Some(split) = self.split {
            write!(f, "@{split}")?;
        }
        if self.times == 1 { Ok(()) } else { write!(f, "*{}", self.times) }
    }
}

impl FromStr for Source {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let (rest, times) = match text.rsplit_once('*').map(|(rest, times)| (rest, times.parse::<usize>())) {
            Some((rest, Ok(times))) if (1..=1_000_000).contains(&times) => (rest, times),
            Some((_, Ok(times))) => {
                return Err(format!("`{text}`: {times} times is not between 1 and 1000000"));
            }
            _ => (text, 1),
        };
        let (rest, split) = match rest.rsplit_once('@').map(|(rest, split)| (rest, split.parse())) {
            Some((rest, Ok(split))) => (rest, Some(split)),
            _ => (rest, None),
        };
        let made = rest.split_once(':').and_then(|(kind, of)| Some((kind.parse().ok()?, of.to_owned())));
        let spec = match (made, split) {
            (Some((kind, of)), None) => DataSpec::Made(MadeSpec { kind, of }),
            (Some(_), Some(_)) => {
                return Err(format!("`{text}`: data that is made while training has no splits"));
            }
            (None, _) => DataSpec::Files(rest.parse().map_err(|error: DatasetError| {
                let [shapes, rendered] = MadeKind::ALL;
                format!("{error}. To make pairs while training: {shapes}: or {rendered}:")
            })?),
        };
        Ok(Self { spec, split, times })
    }
}

srflow_core::serialize_as_text!(Source);

/// Serde through `Display` and `FromStr`.
pub(super) mod by_text {
    use std::fmt::Display;
    use std::str::FromStr;

    use serde::{Deserialize, Deserializer, Serializer, de::Error};

    pub fn serialize<S: Serializer>(value: &impl Display, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_str(value)
    }

    pub fn deserialize<'de, D, T>(deserializer: D) -> Result<T, D::Error>
    where
        D: Deserializer<'de>,
        T: FromStr<Err = String>,
    {
        String::deserialize(deserializer)?.parse().map_err(Error::custom)
    }
}

/// Serde for lists through `Display` and `FromStr`; a single element needs no brackets.
pub(super) mod by_texts {
    use std::fmt::Display;
    use std::str::FromStr;

    use serde::{Deserialize, Deserializer, Serialize, Serializer, de::Error};

    #[derive(Deserialize)]
    #[serde(untagged, expecting = "expected a text or a list of texts")]
    enum OneOrMore {
        One(String),
        More(Vec<String>),
    }

    pub fn serialize<S: Serializer>(values: &[impl Display], serializer: S) -> Result<S::Ok, S::Error> {
        values.iter().map(ToString::to_string).collect::<Vec<_>>().serialize(serializer)
    }

    pub fn deserialize<'de, D, T>(deserializer: D) -> Result<Vec<T>, D::Error>
    where
        D: Deserializer<'de>,
        T: FromStr<Err = String>,
    {
        let texts = match OneOrMore::deserialize(deserializer)? {
            OneOrMore::One(text) => vec![text],
            OneOrMore::More(texts) => texts,
        };
        texts.iter().map(|text| text.parse().map_err(Error::custom)).collect()
    }
}

/// Serde for an optional size; an empty string is `None`.
pub(super) mod optional_size {
    use serde::{Deserialize, Deserializer, Serializer, de::Error};
    use srflow_core::Size;

    pub fn serialize<S: Serializer>(value: &Option<Size>, serializer: S) -> Result<S::Ok, S::Error> {
        match value {
            Some(size) => serializer.collect_str(size),
            None => serializer.serialize_str(""),
        }
    }

    pub fn deserialize<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Option<Size>, D::Error> {
        let text = String::deserialize(deserializer)?;
        if text.is_empty() { Ok(None) } else { text.parse().map(Some).map_err(Error::custom) }
    }
}

/// Serde for networks by name.
pub(super) mod architecture {
    use serde::{Deserialize, Deserializer, Serializer, de::Error};
    use srflow_nets::Architecture;

    pub fn serialize<S: Serializer>(value: &Architecture, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.serialize_str(value.name())
    }

    pub fn deserialize<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Architecture, D::Error> {
        let name = String::deserialize(deserializer)?;
        Architecture::from_name(&name).ok_or_else(|| {
            let names = Architecture::ALL.map(Architecture::name).join(", ");
            Error::custom(format!("`{name}` is not a network; expected one of {names}"))
        })
    }
}

/// Serde for precisions by name.
pub(super) mod precision {
    use serde::{Deserialize, Deserializer, Serializer, de::Error};
    use srflow_ops::Precision;

    pub fn serialize<S: Serializer>(value: &Precision, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.serialize_str(value.name())
    }

    pub fn deserialize<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Precision, D::Error> {
        let name = String::deserialize(deserializer)?;
        let known = Precision::ALL.into_iter().find(|precision| precision.name() == name);
        known.ok_or_else(|| {
            Error::custom(format!("`{name}` is not a precision; expected `f32`, `f16` or `bf16`"))
        })
    }
}
