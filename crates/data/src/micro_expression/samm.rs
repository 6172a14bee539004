//! SAMM (Davison et al. 2016), with the emotions of the 2017 release.
//!
//! Spreadsheet `SAMM_Micro_FACS_Codes_v2.xlsx`, sheet MICRO_ONLY; frames `SUBJECT/CLIP/SUBJECT_FRAME.jpg`, numbered with
//! four or five digits depending on the clip.

use std::path::Path;

use super::coded::{self, Coding, Objective};
use super::forms;
use super::frames::{ClipFolders, below};
use super::{Annotation, ClipKind, ClipSource, MicroExpressionError};

pub(super) const KIND: ClipKind = ClipKind {
    name: "samm",
    releases: &[],
    about: "SAMM",
    published: Some([92, 26, 15]),
    megc2019: Some([92, 26, 15]),
    takes_apex_list: true,
    labels: |source| coded::read(&CODING, source),
    folders,
};

const CODING: Coding = Coding {
    form: &forms::SAMM,
    onset: "Onset Frame",
    apex: Some("Apex Frame"),
    offset: "Offset Frame",
    subject_digits: 3,
    emotions: &[
        "anger",
        "contempt",
        "disgust",
        "fear",
        "sadness",
        "happiness",
        "surprise",
        "other",
        "others",
    ],
    emotions_called: "SAMM's eight",
    frames_may_be_wrong: false,
    objective: Objective::Column("Objective Classes"),
    ..Coding::COMMON
};

fn folders(source: &ClipSource, annotations: &[Annotation]) -> Result<ClipFolders, MicroExpressionError> {
    let folder =
        |root: &Path, annotation: &Annotation| [root.join(&annotation.subject).join(&annotation.clip)];
    below("samm", &source.dir, &[("", ""), ("SAMM", "")], annotations, folder)
}
