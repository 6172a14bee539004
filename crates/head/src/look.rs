//! Versions of how heads look.

use std::fmt;
use std::str::FromStr;

use serde::{Deserialize, Serialize};

/// A version of the shape and the dressing of heads. Within a version, all bytes stay as they are; datasets record theirs.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Default, Serialize, Deserialize)]
#[serde(try_from = "u8", into = "u8")]
pub enum Look {
    /// Light and shadow are painted on the head at rest.
    First = 1,
    /// Skin folds, and its light changes as it moves.
    #[default]
    Second = 2,
}

impl Look {
    /// All versions, oldest first.
    pub const ALL: [Self; 2] = [Self::First, Self::Second];

    /// The version of what records none.
    pub fn unrecorded() -> Self {
        Self::First
    }

    /// Whether this is the version of what records none.
    pub fn is_unrecorded(&self) -> bool {
        *self == Self::unrecorded()
    }
}

impl From<Look> for u8 {
    fn from(look: Look) -> Self {
        look as Self
    }
}

impl TryFrom<u8> for Look {
    type Error = String;

    fn try_from(number: u8) -> Result<Self, String> {
        let known = Self::ALL.into_iter().find(|look| *look as u8 == number);
        known.ok_or_else(|| format!("look {number}: expected 1 or 2"))
    }
}

impl fmt::Display for Look {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}", *self as u8)
    }
}

impl FromStr for Look {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let known = Self::ALL.into_iter().find(|look| look.to_string() == text);
        known.ok_or_else(|| "expected 1 or 2".to_owned())
    }
}
