//! Micro-expressions of CAS(ME)³, part C (Li et al. 2022): mock crimes.
//!
//! Spreadsheet `CAS(ME)3_part_C_ME.xlsx`; frames `SS/CLIP/color/*`, one folder for each clip. There is no annotated apex.

use std::path::Path;

use super::coded::{self, Coding};
use super::forms;
use super::frames::{ClipFolders, below};
use super::{Annotation, ClipKind, ClipSource, MicroExpressionError};

pub(super) const KIND: ClipKind = ClipKind::new(
    "casme3-c",
    "CAS(ME)³, micro-expressions of part C",
    |source| coded::read(&CODING, source),
    folders,
);

const CODING: Coding = Coding {
    form: &forms::CASME3_C,
    subject: "sub",
    clip: "count",
    onset: "onset",
    apex: None,
    offset: "offset",
    action_units: "au",
    emotion: "emotion",
    subject_digits: 2,
    emotions: &["negative", "positive", "surprise", "others"],
    emotions_called: "CAS(ME)³'s four of part C",
    ..Coding::COMMON
};

fn folders(source: &ClipSource, annotations: &[Annotation]) -> Result<ClipFolders, MicroExpressionError> {
    let folders = |root: &Path, annotation: &Annotation| {
        [root.join(&annotation.subject).join(&annotation.clip).join("color")]
    };
    let found =
        below("casme3-c", &source.dir, &[("", ""), ("ME_C", ""), ("part_C", "")], annotations, folders)?;
    Ok(ClipFolders { alone: true, ..found })
}
