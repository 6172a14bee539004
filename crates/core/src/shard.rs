//! Parts of a job that several processes share.

use std::fmt;
use std::ops::Range;
use std::str::FromStr;

use serde::Serialize;

use crate::excerpt;

/// One of several parts of a work, which may be done on different machines.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
pub struct Shard {
    /// Number of the part, from 1.
    pub number: u32,
    pub of: u32,
}

impl Shard {
    pub const WHOLE: Self = Self { number: 1, of: 1 };

    /// The units of this part: all of them in order, cut into parts whose sizes differ by at most one.
    pub fn range(self, units: u64) -> Range<u64> {
        let cut = |part: u32| (u128::from(part) * u128::from(units) / u128::from(self.of)) as u64;
        cut(self.number - 1)..cut(self.number)
    }
}

impl Default for Shard {
    fn default() -> Self {
        Self::WHOLE
    }
}

impl fmt::Display for Shard {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}/{}", self.number, self.of)
    }
}

impl FromStr for Shard {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let parsed = text.split_once('/').and_then(|(number, of)| {
            let (number, of) = (number.parse().ok()?, of.parse().ok()?);
            (1 <= number && number <= of).then_some(Self { number, of })
        });
        parsed.ok_or_else(|| format!("`{}`: expected I/N with I from 1 to N, e.g. 2/3", excerpt(text)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn parts_are_equal_and_cover_everything() {
        for units in [0, 1, 37, u64::MAX] {
            for of in [1, 2, 3, 8, 37, 50] {
                let parts = (1..=of).map(|number| Shard { number, of }.range(units));
                let parts: Vec<Range<u64>> = parts.collect();
                assert!(parts.windows(2).all(|pair| pair[0].end == pair[1].start));
                assert_eq!((parts[0].start, parts[of as usize - 1].end), (0, units));
                let sizes = || parts.iter().map(|part| part.end - part.start);
                assert!(sizes().max().unwrap() - sizes().min().unwrap() <= 1);
            }
        }
    }

    #[test]
    fn text_forms_round_trip() {
        assert_eq!("2/3".parse(), Ok(Shard { number: 2, of: 3 }));
        for text in ["3/2", "0/2", "1/0", "2", "a/b", "-1/2", "1/2/3"] {
            assert!(text.parse::<Shard>().unwrap_err().contains(text));
        }
    }
}
