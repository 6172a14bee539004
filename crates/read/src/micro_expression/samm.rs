//! SAMM (Davison et al. 2016), with the emotions of its release of 2017.
//!
//! Spreadsheet `SAMM_Micro_FACS_Codes_v2.xlsx`, sheet MICRO_ONLY; frames `SUBJECT/CLIP/SUBJECT_FRAME.jpg`, numbered with
//! four or five digits depending on the clip.

use std::path::Path;

use super::frames::{ClipFolders, below};
use super::sheet::{Form, read_spreadsheet};
use super::{
    Annotation, ClipKind, ClipSource, DropReason, Dropped, EmotionClass, Labels, MicroExpressionError,
};

pub const FORM: Form = Form {
    kind: ClipKind::Samm,
    called: "SAMM's annotations (SAMM_Micro_FACS_Codes_v2.xlsx)",
    columns: &[
        "Subject",
        "Filename",
        "Inducement Code",
        "Onset Frame",
        "Apex Frame",
        "Offset Frame",
        "Action Units",
        "Estimated Emotion",
    ],
};

/// Digits of a subject's name.
const SUBJECT_DIGITS: usize = 3;

pub fn read(source: &ClipSource) -> Result<Labels, MicroExpressionError> {
    let table = read_spreadsheet(&FORM, source)?;
    let (mut annotations, mut dropped) = (Vec::new(), Vec::new());
    for row in table.rows() {
        let subject = format!("{:0>SUBJECT_DIGITS$}", row.filled("Subject")?);
        let clip = row.filled("Filename")?.to_owned();
        let label = row.filled("Estimated Emotion")?.to_owned();
        let class = match label.to_lowercase().as_str() {
            "anger" | "contempt" | "disgust" | "fear" | "sadness" => EmotionClass::Negative,
            "happiness" => EmotionClass::Positive,
            "surprise" => EmotionClass::Surprise,
            "other" | "others" => {
                dropped.push(Dropped { subject, clip, label, reason: DropReason::Label });
                continue;
            }
            _ => return Err(row.wrong(format!("Estimated Emotion: `{label}` is none of SAMM's eight"))),
        };
        let (onset, apex, offset) =
            (row.frame("Onset Frame")?, row.frame("Apex Frame")?, row.frame("Offset Frame")?);
        if apex <= onset {
            dropped.push(Dropped { subject, clip, label, reason: DropReason::ApexNotAfterOnset });
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
    Ok(Labels { dataset: "samm".to_owned(), file: Some(table.path), annotations, dropped })
}

pub fn folders(dir: &Path, annotations: &[Annotation]) -> Result<ClipFolders, MicroExpressionError> {
    let folder = |root: &Path, annotation: &Annotation| root.join(&annotation.subject).join(&annotation.clip);
    below("samm", dir, &[("", ""), ("SAMM", "")], annotations, folder)
}
