//! Several datasets as one, and the counts that are published of each.

use std::collections::BTreeSet;
use std::fmt;
use std::ops::{Add, Index};

use super::{CLIP_KINDS, EmotionClass, MicroExpressionError};

/// Clips of each class.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct ClassCounts([usize; 3]);

impl ClassCounts {
    /// Of positive, negative and surprise, as the literature lists them.
    pub const fn new(positive: usize, negative: usize, surprise: usize) -> Self {
        Self([negative, positive, surprise])
    }

    /// All clips.
    pub fn total(self) -> usize {
        self.0.iter().sum()
    }
}

impl Index<EmotionClass> for ClassCounts {
    type Output = usize;

    fn index(&self, class: EmotionClass) -> &usize {
        &self.0[class as usize]
    }
}

impl FromIterator<EmotionClass> for ClassCounts {
    fn from_iter<I: IntoIterator<Item = EmotionClass>>(classes: I) -> Self {
        let mut counts = Self::default();
        for class in classes {
            counts.0[class as usize] += 1;
        }
        counts
    }
}

impl Add for ClassCounts {
    type Output = Self;

    fn add(self, other: Self) -> Self {
        Self([0, 1, 2].map(|class| self.0[class] + other.0[class]))
    }
}

impl fmt::Display for ClassCounts {
    /// `26/92/15`: positive, negative, surprise.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let [negative, positive, surprise] = self.0;
        f.pad(&format!("{positive}/{negative}/{surprise}"))
    }
}

/// Clips of each class that the paper counts in a dataset, where it does.
pub fn published_counts(dataset: &str) -> Option<ClassCounts> {
    CLIP_KINDS.iter().find(|kind| kind.name == dataset)?.published
}

/// Checks that datasets can be one: subjects are told apart by their dataset's name.
///
/// # Errors
/// When two have the same name.
pub fn check_distinct<'a>(names: impl IntoIterator<Item = &'a str>) -> Result<(), MicroExpressionError> {
    let mut seen = BTreeSet::new();
    match names.into_iter().find(|name| !seen.insert(*name)) {
        Some(name) => Err(MicroExpressionError::SameName(name.to_owned())),
        None => Ok(()),
    }
}
