//! CASME II (Yan et al. 2014).
//!
//! Spreadsheet `CASME2-coding-20140508.xlsx`; frames `subSS/CLIP/imgFRAME.jpg` in the raw release and
//! `subSS/CLIP/reg_imgFRAME.jpg` in the cropped one. Sadness and fear are few and belong to no class.

use std::path::Path;

use super::frames::{ClipFolders, below};
use super::sheet::{Form, read_spreadsheet};
use super::{
    Annotation, ClipKind, ClipSource, DropReason, Dropped, EmotionClass, Labels, MicroExpressionError,
    Release,
};

pub const FORM: Form = Form {
    kind: ClipKind::Casme2(None),
    called: "CASME II's annotations (CASME2-coding-20140508.xlsx)",
    columns: &[
        "Subject",
        "Filename",
        "OnsetFrame",
        "ApexFrame",
        "OffsetFrame",
        "Action Units",
        "Estimated Emotion",
    ],
};

/// Digits of a subject's name.
const SUBJECT_DIGITS: usize = 2;

pub fn read(source: &ClipSource) -> Result<Labels, MicroExpressionError> {
    let table = read_spreadsheet(&FORM, source)?;
    let (mut annotations, mut dropped) = (Vec::new(), Vec::new());
    for row in table.rows() {
        let subject = format!("{:0>SUBJECT_DIGITS$}", row.filled("Subject")?);
        let clip = row.filled("Filename")?.to_owned();
        let label = row.filled("Estimated Emotion")?.to_owned();
        let mut drop = |reason| {
            let (subject, clip, label) = (subject.clone(), clip.clone(), label.clone());
            dropped.push(Dropped { subject, clip, label, reason });
        };
        let class = match label.to_lowercase().as_str() {
            "disgust" | "repression" => EmotionClass::Negative,
            "happiness" => EmotionClass::Positive,
            "surprise" => EmotionClass::Surprise,
            "others" | "other" | "sadness" | "fear" => {
                drop(DropReason::Label);
                continue;
            }
            _ => return Err(row.wrong(format!("Estimated Emotion: `{label}` is none of CASME II's seven"))),
        };
        let (onset, offset) = (row.frame("OnsetFrame")?, row.frame("OffsetFrame")?);
        let Ok(apex) = row.text("ApexFrame").parse::<u64>() else {
            drop(DropReason::ApexUnknown);
            continue;
        };
        if apex <= onset {
            drop(DropReason::ApexNotAfterOnset);
            continue;
        }
        let action_units = row.text("Action Units").to_owned();
        annotations.push(Annotation {
            subject,
            clip,
            class,
            label,
            action_units,
            onset,
            apex: Some(apex),
            offset: offset.max(apex),
        });
    }
    Ok(Labels { dataset: "casme2".to_owned(), file: Some(table.path), annotations, dropped })
}

/// Where each release lies below the folder that the archives are unpacked into.
const RAW: [(&str, &str); 3] = [("CASME2_RAW_selected", "raw"), ("CASME2-RAW", "raw"), ("CASME2_RAW", "raw")];
const CROPPED: [(&str, &str); 2] = [("Cropped_original", "cropped"), ("Cropped", "cropped")];

pub fn folders(
    dir: &Path,
    release: Option<Release>,
    annotations: &[Annotation],
) -> Result<ClipFolders, MicroExpressionError> {
    let folder = |root: &Path, annotation: &Annotation| {
        root.join(format!("sub{}", annotation.subject)).join(&annotation.clip)
    };
    let there = |places: &[(&str, &str)]| places.iter().any(|(name, _)| dir.join(name).is_dir());
    match release {
        Some(Release::Raw) => below("casme2", dir, &[&RAW[..], &[("", "raw")]].concat(), annotations, folder),
        Some(Release::Cropped) => {
            below("casme2", dir, &[&CROPPED[..], &[("", "cropped")]].concat(), annotations, folder)
        }
        None if there(&RAW) && there(&CROPPED) => Err(MicroExpressionError::NoFolders {
            kind: "casme2",
            looked_for: "one release".to_owned(),
            found: format!("{0} holds both: give casme2-raw:{0} or casme2-cropped:{0}", dir.display()),
        }),
        None => {
            let mut found =
                below("casme2", dir, &[&RAW[..], &CROPPED, &[("", "")]].concat(), annotations, folder)?;
            if found.form.is_empty() {
                found.form = form_of_frames(&found);
            }
            Ok(found)
        }
    }
}

/// The release, from the name of a frame.
fn form_of_frames(found: &ClipFolders) -> &'static str {
    let first = found.folders.iter().find(|folder| folder.is_dir());
    let pictures = first.and_then(|folder| crate::flow::pictures(folder).ok()).unwrap_or_default();
    match pictures.first() {
        Some(picture) if crate::flow::listing::name(picture).starts_with("reg_") => "cropped",
        _ => "raw",
    }
}
