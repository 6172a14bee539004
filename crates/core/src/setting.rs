//! Settings: the error of one that is out of range, and types that are text in files of settings.

use std::fmt;
use std::ops::Deref;
use std::str::FromStr;

use serde::de::Error as _;
use serde::{Deserialize, Deserializer, Serialize, Serializer};

/// A setting that is out of range. Front ends say how it is given: `--noise` on a command line, `noise=` in
/// Python.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{field} {found}: expected {expected}")]
pub struct SettingError {
    /// Path of the field in its settings, e.g. `recording.noise`.
    pub field: &'static str,
    pub found: String,
    pub expected: String,
}

impl SettingError {
    /// The last part of the field's path, which is its name where settings are flat.
    pub fn name(&self) -> &'static str {
        self.field.rsplit('.').next().unwrap_or(self.field)
    }
}

/// Serializes types by `Display` and deserializes them by `FromStr`, from text or a number.
#[macro_export]
macro_rules! serialize_as_text {
    ($($type:ty),+ $(,)?) => {
        $(
            impl ::serde::Serialize for $type {
                fn serialize<S: ::serde::Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
                    serializer.collect_str(self)
                }
            }

            impl<'de> ::serde::Deserialize<'de> for $type {
                fn deserialize<D: ::serde::Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
                    $crate::parse_setting(deserializer)
                }
            }
        )+
    };
}

/// Deserializes text, or a number as it is written, by `FromStr`; for
/// [`serialize_as_text!`](crate::serialize_as_text).
#[doc(hidden)]
pub fn parse_setting<'de, T: FromStr<Err: fmt::Display>, D: Deserializer<'de>>(
    deserializer: D,
) -> Result<T, D::Error> {
    #[derive(Deserialize)]
    #[serde(untagged, expecting = "expected text or a number")]
    enum Given {
        Text(String),
        Whole(i64),
        Number(f64),
    }
    let text = match Given::deserialize(deserializer)? {
        Given::Text(text) => text,
        Given::Whole(number) => number.to_string(),
        Given::Number(number) => number.to_string(),
    };
    text.parse().map_err(D::Error::custom)
}

/// `N` numbers, written with commas between them or as a list.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Numbers<T, const N: usize>(pub [T; N]);

impl<T, const N: usize> Deref for Numbers<T, N> {
    type Target = [T; N];

    fn deref(&self) -> &[T; N] {
        &self.0
    }
}

impl<T: fmt::Display, const N: usize> fmt::Display for Numbers<T, N> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let texts: Vec<String> = self.0.iter().map(ToString::to_string).collect();
        f.write_str(&texts.join(","))
    }
}

impl<T: FromStr, const N: usize> FromStr for Numbers<T, N> {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let numbers: Option<Vec<T>> = text.split(',').map(|number| number.trim().parse().ok()).collect();
        let numbers = numbers.and_then(|numbers| numbers.try_into().ok());
        numbers.map(Self).ok_or_else(|| format!("expected {N} numbers between commas, found `{text}`"))
    }
}

impl<T: Serialize, const N: usize> Serialize for Numbers<T, N> {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_seq(&self.0)
    }
}

impl<'de, T: Deserialize<'de> + FromStr, const N: usize> Deserialize<'de> for Numbers<T, N> {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        #[derive(Deserialize)]
        #[serde(untagged)]
        enum Given<T> {
            List(Vec<T>),
            Text(String),
        }
        let wrong = |found: usize| D::Error::custom(format!("expected {N} numbers, found {found}"));
        match Given::<T>::deserialize(deserializer)? {
            Given::List(numbers) => numbers.try_into().map(Self).map_err(|list: Vec<T>| wrong(list.len())),
            Given::Text(text) => text.parse().map_err(D::Error::custom),
        }
    }
}
