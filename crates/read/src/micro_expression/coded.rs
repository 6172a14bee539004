//! Spreadsheets with one coded clip a row: onset, apex, offset, action units and an emotion. SAMM's and CASME II's differ
//! only in the names of their columns and emotions.

use super::sheet::{Form, read_spreadsheet};
use super::{Annotation, ClipSource, DropReason, Dropped, EmotionClass, Labels, MicroExpressionError};

/// How one dataset's spreadsheet is coded.
pub struct Coding {
    pub form: &'static Form,
    /// Columns of the onset, apex and offset frame.
    pub frames: [&'static str; 3],
    /// Digits of a subject's name: spreadsheets drop the leading zeros.
    pub subject_digits: usize,
    /// Every emotion in small letters, with its class; those of no class are dropped.
    pub emotions: &'static [(&'static str, Option<EmotionClass>)],
    /// What the emotions are, for messages.
    pub emotions_called: &'static str,
    /// Whether an apex that is not a number drops its row; otherwise it is an error.
    pub apex_may_be_unknown: bool,
}

const EMOTION: &str = "Estimated Emotion";

/// Reads the spreadsheet that `source` names.
pub fn read(coding: &Coding, source: &ClipSource) -> Result<Labels, MicroExpressionError> {
    let table = read_spreadsheet(coding.form, source)?;
    let (mut annotations, mut dropped) = (Vec::new(), Vec::new());
    for row in table.rows() {
        let subject = format!("{:0>1$}", row.filled("Subject")?, coding.subject_digits);
        let clip = row.filled("Filename")?.to_owned();
        let label = row.filled(EMOTION)?.to_owned();
        let emotion = label.to_lowercase();
        let Some((_, class)) = coding.emotions.iter().find(|(known, _)| *known == emotion) else {
            return Err(row.wrong(format!("{EMOTION}: `{label}` is none of {}", coding.emotions_called)));
        };
        let Some(class) = *class else {
            dropped.push(Dropped { subject, clip, label, reason: DropReason::Label });
            continue;
        };
        let [onset, apex, offset] = coding.frames;
        let (onset, offset) = (row.frame(onset)?, row.frame(offset)?);
        let apex = match row.frame(apex) {
            Err(_) if coding.apex_may_be_unknown => {
                dropped.push(Dropped { subject, clip, label, reason: DropReason::ApexUnknown });
                continue;
            }
            apex => apex?,
        };
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
    Ok(Labels { dataset: coding.form.kind.to_owned(), file: Some(table.path), annotations, dropped })
}
