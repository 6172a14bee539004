//! CASME (Yan et al. 2013), the first of the name.
//!
//! Spreadsheet `casme.xlsx`, with the apex in the column ApexF1; frames `subSS/CLIP/CLIP-FRAME.jpg`, cropped ones
//! `subSS/CLIP/reg_CLIP-FRAME.jpg`.

use super::ClipKind;
use super::casme2::folder;
use super::coded::{self, Coding};
use super::forms;
use super::release::below_release;

pub(super) const KIND: ClipKind = ClipKind {
    releases: &["raw", "cropped"],
    ..ClipKind::new(
        "casme",
        "CASME, the raw or the cropped release (default: the one that is found)",
        |source| coded::read(&CODING, source),
        |source, annotations| below_release(source, &PLACES, "reg_", annotations, folder),
    )
};

const CODING: Coding = Coding {
    form: &forms::CASME,
    onset: "OnsetF",
    apex: Some("ApexF1"),
    offset: "OffsetF",
    action_units: "AU",
    emotion: "Emotion",
    subject_digits: 2,
    ..Coding::COMMON
};

/// Subfolders of each release in the unpacked archives.
const PLACES: [(&str, &str); 2] = [("CASME_raw_selected", "raw"), ("Cropped", "cropped")];
