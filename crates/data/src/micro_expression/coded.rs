//! Spreadsheets with one coded clip per row: onset, apex, offset, action units and emotion. Those of SAMM and CASME II differ
//! only in the names of their columns and emotions.

use std::collections::BTreeMap;
use std::path::Path;

use super::classes::Coded;
use super::forms::Form;
use super::sheet::{Row, read_spreadsheet, spreadsheet_in};
use super::{Annotation, ClipSource, DropReason, Dropped, Labels, MicroExpressionError};

/// The format of one dataset's spreadsheet.
pub struct Coding {
    pub form: &'static Form,
    /// Columns of the onset, apex and offset frames.
    pub frames: [&'static str; 3],
    /// Number of digits in a subject's name: spreadsheets drop leading zeros.
    pub subject_digits: usize,
    pub emotions: &'static [&'static str],
    /// Name of the emotions in messages.
    pub emotions_called: &'static str,
    /// Whether an apex that is not a number drops its row instead of being an error.
    pub apex_may_be_unknown: bool,
    pub objective: Objective,
}

/// Where the objective classes of clips (Davison, Merghani and Yap 2018) are stored.
pub enum Objective {
    /// In a column of the spreadsheet, which older releases lack.
    Column(&'static str),
    /// In a separate spreadsheet.
    Spreadsheet(&'static Form),
}

const EMOTION: &str = "Estimated Emotion";

/// Reads the spreadsheet of `source`.
pub fn read(coding: &Coding, source: &ClipSource) -> Result<Labels, MicroExpressionError> {
    let table = read_spreadsheet(coding.form, source)?;
    let objective = match coding.objective {
        Objective::Spreadsheet(form) if source.classes.need_objective() => {
            objective_classes(form, coding, source)?
        }
        _ => BTreeMap::new(),
    };
    let (mut annotations, mut dropped) = (Vec::new(), Vec::new());
    for row in table.rows() {
        let subject = format!("{:0>1$}", row.filled("Subject")?, coding.subject_digits);
        let clip = row.filled("Filename")?.to_owned();
        let label = row.filled(EMOTION)?.to_owned();
        if !coding.emotions.contains(&label.to_lowercase().as_str()) {
            return Err(row.wrong(format!("{EMOTION}: `{label}` is none of {}", coding.emotions_called)));
        }
        let action_units = row.text("Action Units").to_owned();
        let objective = match coding.objective {
            Objective::Column(column) => row.text(column),
            Objective::Spreadsheet(_) => {
                objective.get(&(subject.clone(), clip.clone())).map_or("", String::as_str)
            }
        };
        let coded = Coded { kind: coding.form.kind, emotion: &label, action_units: &action_units, objective };
        let Some(class) = source.classes.of(&coded) else {
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

/// The objective class of each clip, by subject and clip, from the spreadsheet in the dataset's folder or next to the
/// annotations.
fn objective_classes(
    form: &Form,
    coding: &Coding,
    source: &ClipSource,
) -> Result<BTreeMap<(String, String), String>, MicroExpressionError> {
    let beside = source.annotations.as_deref().and_then(Path::parent);
    for dir in [Some(source.dir.as_path()), beside].into_iter().flatten().filter(|dir| dir.is_dir()) {
        let Some(table) = spreadsheet_in(form, dir)? else { continue };
        let class = |row: Row| {
            let subject = format!("{:0>1$}", row.filled("Subject")?, coding.subject_digits);
            Ok(((subject, row.filled("Filename")?.to_owned()), row.filled("Objective Class")?.to_owned()))
        };
        return table.rows().map(class).collect();
    }
    Err(MicroExpressionError::NoAnnotations {
        kind: form.kind,
        dir: source.dir.clone(),
        expected: form.called,
        found: "it is missing. Put it there, or next to the file of `annotations`".to_owned(),
    })
}
