//! CASME II (Yan et al. 2014).
//!
//! Spreadsheet `CASME2-coding-20140508.xlsx`; frames `subSS/CLIP/imgFRAME.jpg` in the raw release and
//! `subSS/CLIP/reg_imgFRAME.jpg` in the cropped one. Objective classes are in a separate spreadsheet.

use std::path::{Path, PathBuf};

use super::coded::{self, Coding, Objective};
use super::forms;
use super::frames::ClipFolders;
use super::release::below_release;
use super::{Annotation, ClipKind, ClipSource, MicroExpressionError};

pub(super) const KIND: ClipKind = ClipKind {
    name: "casme2",
    releases: &["raw", "cropped"],
    about: "CASME II, the raw or the cropped release (default: the one that is found)",
    published: Some([88, 32, 25]),
    megc2019: Some([88, 32, 25]),
    takes_apex_list: true,
    labels: |source| coded::read(&CODING, source),
    folders,
};

const CODING: Coding = Coding {
    form: &forms::CASME2,
    subject_digits: 2,
    emotions: &["disgust", "repression", "happiness", "surprise", "others", "other", "sadness", "fear"],
    emotions_called: "CASME II's seven",
    objective: Objective::Spreadsheet(&forms::CASME2_OBJECTIVE),
    ..Coding::COMMON
};

/// Subfolders of each release in the unpacked archives.
const PLACES: [(&str, &str); 5] = [
    ("CASME2_RAW_selected", "raw"),
    ("CASME2-RAW", "raw"),
    ("CASME2_RAW", "raw"),
    ("Cropped_original", "cropped"),
    ("Cropped", "cropped"),
];

fn folders(source: &ClipSource, annotations: &[Annotation]) -> Result<ClipFolders, MicroExpressionError> {
    below_release(source, &PLACES, "reg_", annotations, folder)
}

/// The folder of a clip, as in CASME and CASME II.
pub(super) fn folder(root: &Path, annotation: &Annotation) -> [PathBuf; 1] {
    [root.join(format!("sub{}", annotation.subject)).join(&annotation.clip)]
}
