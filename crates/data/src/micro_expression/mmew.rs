//! MMEW (Ben et al. 2021).
//!
//! Spreadsheet `MMEW_Micro_Exp.xlsx`; cropped faces `EMOTION/CLIP/FRAME.jpg`, where the clips of `others` lie in a folder `repression`.
//! Sixteen rows lack the offset.

use std::path::Path;

use super::coded::{self, Coding};
use super::forms;
use super::frames::{ClipFolders, below};
use super::{Annotation, ClipKind, ClipSource, MicroExpressionError};

pub(super) const KIND: ClipKind =
    ClipKind::new("mmew", "MMEW, micro-expressions", |source| coded::read(&CODING, source), folders);

const CODING: Coding = Coding {
    form: &forms::MMEW,
    emotions: &["happiness", "surprise", "anger", "disgust", "fear", "sadness", "others", "other"],
    emotions_called: "MMEW's seven",
    ..Coding::COMMON
};

fn folders(source: &ClipSource, annotations: &[Annotation]) -> Result<ClipFolders, MicroExpressionError> {
    let folders = |root: &Path, annotation: &Annotation| {
        let label = annotation.label.to_lowercase();
        let emotion = if label == "others" { "repression" } else { &label };
        [emotion, &annotation.label].map(|emotion| root.join(emotion).join(&annotation.clip))
    };
    let found = below("mmew", &source.dir, &[("", ""), ("Micro_Expression", "")], annotations, folders)?;
    Ok(ClipFolders { alone: true, ..found })
}
