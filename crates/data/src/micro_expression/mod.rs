//! Micro-expression datasets: who shows which expression, in which frames.
//!
//! [`Labels::read`] reads a dataset's annotations and keeps the clips that belong to a class, with a reason for every dropped
//! row; [`ClipDataset::open`] also finds the frames of the kept clips. Each dataset has its own file.

mod annotation;
mod apex_list;
mod casme;
mod casme2;
mod casme3;
mod casme3_c;
mod casme_squared;
mod cells;
mod class;
mod classes;
mod clip;
mod coded;
mod composite;
mod dfme;
mod error;
mod forms;
mod four_dme;
mod frames;
pub mod intervals;
mod mmew;
mod plain;
mod release;
mod samm;
mod sheet;
mod smic;
mod source;
mod table;
mod xls;
mod xlsx;

use std::collections::BTreeSet;
use std::path::PathBuf;

pub use annotation::{Annotation, DropReason, Dropped};
pub use apex_list::{ApexRow, write_apex_list};
pub use class::EmotionClass;
pub use classes::{CLASS_SETS, Classes};
pub use clip::{Clip, MissingFrames};
pub use composite::{check_distinct, count_classes, published_counts};
pub use error::MicroExpressionError;
pub use plain::{PLAIN_COLUMNS, PLAIN_NAME, write_plain};
pub use source::{ClipKind, ClipSource};
pub use table::CLIP_KINDS;

use frames::{Located, locate};
use srflow_core::{excerpt, excerpts, is_unprintable};

/// The annotations of a dataset.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Labels {
    /// Name of the dataset, e.g. `casme2`; for a plain one the name of its folder.
    pub dataset: String,
    /// The annotation file, or the first of several; `None` when the folder names hold the annotations.
    pub file: Option<PathBuf>,
    /// The clips that belong to a class, in file order.
    pub annotations: Vec<Annotation>,
    pub dropped: Vec<Dropped>,
    /// What was repaired, with numbers of rows.
    pub notes: Vec<String>,
}

impl Labels {
    /// Reads the annotations without looking for frames.
    ///
    /// # Errors
    /// When the annotation file is missing or another dataset's, one of its rows cannot be read, or no clip belongs to any of
    /// the classes.
    pub fn read(source: &ClipSource) -> Result<Self, MicroExpressionError> {
        let labels = (source.kind.labels)(source)?;
        let mut seen = BTreeSet::new();
        for annotation in &labels.annotations {
            check_names(annotation).map_err(|reason| MicroExpressionError::Table {
                path: labels.file.clone().unwrap_or_else(|| source.dir.clone()),
                reason,
            })?;
            if !seen.insert((&annotation.subject, &annotation.clip)) {
                return Err(MicroExpressionError::Twice {
                    path: labels.file.clone().unwrap_or_else(|| source.dir.clone()),
                    subject: annotation.subject.clone(),
                    clip: annotation.clip.clone(),
                });
            }
        }
        if labels.annotations.is_empty() && labels.dropped.iter().any(|row| row.reason == DropReason::Label) {
            let found: BTreeSet<String> = labels.dropped.iter().map(|row| row.label.to_lowercase()).collect();
            return Err(MicroExpressionError::NoClass {
                dataset: labels.dataset,
                classes: source.classes.names().join(", "),
                found: excerpts(found.iter().map(String::as_str), 12),
            });
        }
        Ok(labels)
    }
}

/// Names are used in paths, tables and reports: they must be short and printable.
fn check_names(annotation: &Annotation) -> Result<(), String> {
    const LONGEST: usize = 1000;
    let Annotation { subject, clip, label, action_units, .. } = annotation;
    let fine = |text: &str| text.len() <= LONGEST && !text.contains(is_unprintable);
    for (field, text) in
        [("subject", subject), ("clip", clip), ("label", label), ("action units", action_units)]
    {
        if !fine(text) {
            return Err(format!(
                "{field}: expected at most {LONGEST} printable characters, found `{}`",
                excerpt(text)
            ));
        }
    }
    Ok(())
}

/// A dataset whose clips were found.
#[derive(Debug, Clone, PartialEq)]
pub struct ClipDataset {
    /// Name of the dataset, e.g. `casme2`; for a plain one the name of its folder.
    pub name: String,
    /// The published form found: `raw`, `cropped`, `extended` or `short`; empty if there is only one.
    pub form: &'static str,
    pub dir: PathBuf,
    /// The annotation file; `None` when the folder names hold the annotations.
    pub file: Option<PathBuf>,
    /// The clips whose onset and apex frames exist.
    pub clips: Vec<Clip>,
    /// Rows dropped by label or for missing frames.
    pub dropped: Vec<Dropped>,
    /// What was repaired in the annotations, with numbers of rows.
    pub notes: Vec<String>,
    /// Every clip with a missing frame between onset and offset.
    pub missing: Vec<MissingFrames>,
}

impl ClipDataset {
    /// Reads the annotations and finds the frames. With `allow_missing`, clips may lack frames, and those without onset or apex
    /// are dropped; [`missing`](Self::missing) lists all of them.
    ///
    /// # Errors
    /// Those of [`Labels::read`]; when no clip's folder is found, or when frames are missing without `allow_missing`.
    pub fn open(source: &ClipSource, allow_missing: bool) -> Result<Self, MicroExpressionError> {
        let mut labels = Labels::read(source)?;
        let annotations = std::mem::take(&mut labels.annotations);
        let found = (source.kind.folders)(source, &annotations)?;
        let ClipSource { only_key_frames, frames_of_videos, .. } = source;
        let Located { clips, dropped, missing } =
            locate(&labels.dataset, annotations, &found, *only_key_frames, frames_of_videos)?;
        if !missing.is_empty() && !allow_missing {
            return Err(MicroExpressionError::missing(&labels.dataset, &found.root, &missing));
        }
        labels.dropped.extend(dropped);
        Ok(Self {
            name: labels.dataset,
            form: found.form,
            dir: source.dir.clone(),
            file: labels.file,
            clips,
            dropped: labels.dropped,
            notes: labels.notes,
            missing,
        })
    }

    /// The subjects with at least one clip.
    pub fn subjects(&self) -> BTreeSet<&str> {
        self.clips.iter().map(|clip| clip.annotation.subject.as_str()).collect()
    }
}
