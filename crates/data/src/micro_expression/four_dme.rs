//! 4DME (Li et al. 2022), grey videos.
//!
//! Spreadsheet `4DME_Labelling_Micro_release v1.xlsx`; frames `SUBJECT/CLIP/*`. A clip may have several emotions: it counts if all belong
//! to one class.

use std::path::Path;

use super::coded::{self, Coding};
use super::forms;
use super::frames::{ClipFolders, below};
use super::{Annotation, ClipKind, ClipSource, MicroExpressionError};

pub(super) const KIND: ClipKind = ClipKind::new(
    "4dme",
    "4DME, micro-expressions in grey videos",
    |source| coded::read(&CODING, source),
    folders,
);

const CODING: Coding = Coding {
    form: &forms::FOUR_DME,
    subject: "sub_ID",
    clip: "fold_name",
    onset: "Onset",
    apex: Some("Apex"),
    offset: "Offset",
    action_units: "AUs",
    emotion: "Emotion",
    several_emotions: true,
    ..Coding::COMMON
};

fn folders(source: &ClipSource, annotations: &[Annotation]) -> Result<ClipFolders, MicroExpressionError> {
    let folders =
        |root: &Path, annotation: &Annotation| [root.join(&annotation.subject).join(&annotation.clip)];
    let found = below("4dme", &source.dir, &[("", ""), ("gray_micro", "")], annotations, folders)?;
    Ok(ClipFolders { alone: true, ..found })
}
