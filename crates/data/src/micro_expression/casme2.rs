//! CASME II (Yan et al. 2014).
//!
//! Spreadsheet `CASME2-coding-20140508.xlsx`; frames `subSS/CLIP/imgFRAME.jpg` in the raw release and
//! `subSS/CLIP/reg_imgFRAME.jpg` in the cropped one. Objective classes are in a separate spreadsheet.

use std::path::Path;

use super::coded::{self, Coding, Objective};
use super::forms;
use super::frames::{ClipFolders, below};
use super::{Annotation, ClipKind, ClipSource, MicroExpressionError};

pub(super) const KIND: ClipKind = ClipKind {
    name: "casme2",
    releases: &["raw", "cropped"],
    about: "CASME II, the raw or the cropped release (default: the one that is found)",
    published: Some([88, 32, 25]),
    megc2019: Some([88, 32, 25]),
    labels: |source| coded::read(&CODING, source),
    folders,
};

const CODING: Coding = Coding {
    form: &forms::CASME2,
    frames: ["OnsetFrame", "ApexFrame", "OffsetFrame"],
    subject_digits: 2,
    emotions: &["disgust", "repression", "happiness", "surprise", "others", "other", "sadness", "fear"],
    emotions_called: "CASME II's seven",
    apex_may_be_unknown: true,
    objective: Objective::Spreadsheet(&forms::CASME2_OBJECTIVE),
};

/// Subfolders of each release in the unpacked archives; last, the folder itself.
const PLACES: [(&str, &str); 7] = [
    ("CASME2_RAW_selected", "raw"),
    ("CASME2-RAW", "raw"),
    ("CASME2_RAW", "raw"),
    ("", "raw"),
    ("Cropped_original", "cropped"),
    ("Cropped", "cropped"),
    ("", "cropped"),
];

fn folders(source: &ClipSource, annotations: &[Annotation]) -> Result<ClipFolders, MicroExpressionError> {
    let dir = &source.dir;
    let folder = |root: &Path, annotation: &Annotation| {
        root.join(format!("sub{}", annotation.subject)).join(&annotation.clip)
    };
    let found = |places: &[(&str, &'static str)]| below("casme2", dir, places, annotations, folder);
    if let Some(release) = source.release {
        let places: Vec<_> = PLACES.into_iter().filter(|(_, of)| *of == release).collect();
        return found(&places);
    }
    let named = PLACES.into_iter().filter(|(name, _)| !name.is_empty());
    let there = |release| named.clone().any(|(name, of)| of == release && dir.join(name).is_dir());
    if there("raw") && there("cropped") {
        return Err(MicroExpressionError::NoFolders {
            kind: "casme2",
            looked_for: "one release".to_owned(),
            found: format!("{0} holds both: give casme2-raw:{0} or casme2-cropped:{0}", dir.display()),
        });
    }
    let places: Vec<_> = named.chain([("", "")]).collect();
    let mut found = found(&places)?;
    if found.form.is_empty() {
        found.form = form_of_frames(&found);
    }
    Ok(found)
}

/// The release, judged by the name of a frame.
fn form_of_frames(found: &ClipFolders) -> &'static str {
    let first = found.folders.iter().find(|folder| folder.is_dir());
    let pictures = first.and_then(|folder| crate::listing::pictures(folder).ok()).unwrap_or_default();
    match pictures.first() {
        Some(picture) if crate::listing::name(picture).starts_with("reg_") => "cropped",
        _ => "raw",
    }
}
