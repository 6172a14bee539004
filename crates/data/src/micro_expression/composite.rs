//! Several datasets combined, and the published counts of each.

use std::collections::BTreeSet;

use super::{Annotation, CLIP_KINDS, Classes, MicroExpressionError};

/// Number of clips per class, by class number.
pub fn count_classes<'a>(
    classes: &Classes,
    annotations: impl IntoIterator<Item = &'a Annotation>,
) -> Vec<usize> {
    let mut counts = vec![0; classes.names().len()];
    for annotation in annotations {
        counts[annotation.class] += 1;
    }
    counts
}

/// The paper's counts of negative, positive and surprise clips in a dataset, or those of MEGC 2019's list; `None` for other datasets and
/// classes.
pub fn published_counts(classes: &Classes, dataset: &str) -> Option<[usize; 3]> {
    let kind = CLIP_KINDS.iter().find(|kind| kind.name == dataset)?;
    if classes.are_of_megc2019() {
        return kind.megc2019;
    }
    kind.published.filter(|_| classes.are_default())
}

/// Checks that datasets can be combined: subjects are identified by dataset and name.
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
