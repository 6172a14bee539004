//! CAS(ME)² (Qu et al. 2018), `CAS(ME)^2code_final.xlsx`: sheets without header rows. The first lists expressions, the second the folder
//! of each row's subject, the third the code of each kind of video.

use std::collections::BTreeMap;
use std::path::Path;

use srflow_core::excerpt;

use super::{ExpressionKind, Interval, IntervalKind, Intervals, frame_number, in_order};
use crate::micro_expression::MicroExpressionError;
use crate::micro_expression::sheet::read_sheets;

pub(super) const KIND: IntervalKind =
    IntervalKind { name: "casme-squared", about: "CAS(ME)^2code_final.xlsx of CAS(ME)²", read };

const FPS: f64 = 30.0;

/// An expression and its place in the dataset.
pub(in crate::micro_expression) struct Expression {
    /// Folder of the subject, such as `s15`.
    pub subject: String,
    /// Code of the video and number of the expression in it: `0401_2`.
    pub clip: String,
    pub interval: Interval,
}

fn read(path: &Path) -> Result<Intervals, MicroExpressionError> {
    let (expressions, notes) = read_expressions(path)?;
    let intervals = expressions.into_iter().map(|expression| expression.interval).collect();
    Ok(Intervals { intervals, notes, fps: Some(FPS) })
}

/// The expressions, in file order, and what was repaired.
pub(in crate::micro_expression) fn read_expressions(
    path: &Path,
) -> Result<(Vec<Expression>, Vec<String>), MicroExpressionError> {
    let sheets = read_sheets(path)?;
    let text = |sheet: usize, row: u32, column: u32| -> &str {
        let cells = sheets.get(sheet).and_then(|rows| rows.get(&row));
        cells.and_then(|cells| cells.get(&column)).map_or("", |text| text.trim())
    };
    let rows: Vec<u32> = sheets.first().into_iter().flat_map(|rows| rows.keys().copied()).collect();
    let folder_of_subject: BTreeMap<&str, &str> =
        rows_of(&sheets, 1).map(|row| (text(1, row, 2), text(1, row, 1))).collect();
    let code_of_video: BTreeMap<&str, &str> =
        rows_of(&sheets, 2).map(|row| (text(2, row, 1), text(2, row, 0))).collect();
    let lists_types = rows.iter().any(|row| ExpressionKind::of_text("", text(0, *row, 7)).is_ok());
    if !lists_types || folder_of_subject.is_empty() || code_of_video.is_empty() {
        return Err(MicroExpressionError::Columns {
            path: path.to_owned(),
            kind: "CAS(ME)²",
            expected: "sheets of expressions, folders and videos, without header rows".to_owned(),
            found: format!(
                "it has {} sheets with rows",
                sheets.iter().filter(|rows| !rows.is_empty()).count()
            ),
        });
    }
    let (mut found, mut notes) = (Vec::new(), Vec::new());
    let (mut without_offset, mut without_apex) = (0, 0);
    for row in rows {
        let wrong = |reason: String| MicroExpressionError::Row {
            path: path.to_owned(),
            row: row as usize + 1,
            reason: excerpt(&reason),
        };
        let frame = |column: u32, name: &str| frame_number(name, text(0, row, column)).map_err(wrong);
        let (subject, clip) = (text(0, row, 0), text(0, row, 1));
        let kind = ExpressionKind::of_text("column 8", text(0, row, 7)).map_err(wrong)?;
        let folder = folder_of_subject.get(subject);
        let folder =
            folder.ok_or_else(|| wrong(format!("subject {subject} has no row in the second sheet")))?;
        // The clip is the video's name and a number: anger1_2.
        let (name, number) = clip.rsplit_once('_').unwrap_or((clip, "1"));
        let code = code_of_video.get(name);
        let code = code.ok_or_else(|| wrong(format!("video {name} has no row in the third sheet")))?;
        let (onset, apex, offset) = (frame(2, "onset")?, frame(3, "apex")?, frame(4, "offset")?);
        // Zero is unknown. The published baselines take the apex for the offset.
        let offset = match offset {
            0 => {
                without_offset += 1;
                apex
            }
            known => known,
        };
        let apex = Some(apex).filter(|apex| *apex > 0);
        without_apex += usize::from(apex.is_none());
        in_order(onset, offset).map_err(wrong)?;
        let interval = Interval {
            video: format!("{folder}_{code}"),
            kind,
            onset,
            apex,
            offset,
            label: text(0, row, 6).to_owned(),
            action_units: text(0, row, 5).to_owned(),
        };
        found.push(Expression { subject: (*folder).to_owned(), clip: format!("{code}_{number}"), interval });
    }
    if without_offset > 0 {
        notes.push(format!("{without_offset} expressions have no offset: their apex stands for it"));
    }
    if without_apex > 0 {
        notes.push(format!("{without_apex} expressions have no apex"));
    }
    Ok((found, notes))
}

fn rows_of(sheets: &[crate::micro_expression::cells::Cells], sheet: usize) -> impl Iterator<Item = u32> {
    sheets.get(sheet).into_iter().flat_map(|rows| rows.keys().copied())
}
