//! CAS(ME)³, part A (Li et al. 2022), `CAS(ME)3_part_A_v2.xls`, saved as .xlsx.

use std::path::Path;

use super::{ExpressionKind, Interval, IntervalKind, Intervals, frame_number};
use crate::micro_expression::MicroExpressionError;
use crate::micro_expression::forms;
use crate::micro_expression::sheet::{Row, read_form};

pub(super) const KIND: IntervalKind =
    IntervalKind { name: "casme3", about: "CAS(ME)3_part_A_v2.xls of CAS(ME)³, saved as .xlsx", read };

const FPS: f64 = 30.0;

fn read(path: &Path) -> Result<Intervals, MicroExpressionError> {
    let table = read_form(&forms::CASME3, path)?;
    let mut found = Intervals { fps: Some(FPS), ..Intervals::default() };
    for row in table.rows() {
        let kind = row.filled("Expression type")?;
        let kind = ExpressionKind::of_text(kind).ok_or_else(|| {
            row.wrong(format!("Expression type: expected Micro- or Macro-expression, found `{kind}`"))
        })?;
        // Five rows write the letter of the video large.
        let video = format!("{}_{}", row.filled("Subject")?, row.filled("Filename")?.to_lowercase());
        let (onset, apex, offset) = (frame(row, "Onset")?, frame(row, "Apex")?, frame(row, "Offset")?);
        if onset > offset {
            return Err(row.wrong(format!("expected Onset <= Offset, found Onset {onset}, Offset {offset}")));
        }
        let (label, action_units) = (row.text("Objective class").to_owned(), row.text("AU").to_owned());
        found.intervals.push(Interval { video, kind, onset, apex: Some(apex), offset, label, action_units });
    }
    Ok(found)
}

fn frame(row: Row, column: &str) -> Result<i64, MicroExpressionError> {
    let text = row.text(column);
    frame_number(text).ok_or_else(|| row.wrong(format!("{column}: expected a frame number, found `{text}`")))
}
