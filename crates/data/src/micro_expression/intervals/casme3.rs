//! CAS(ME)³, part A (Li et al. 2022), `CAS(ME)3_part_A_v2.xls`.

use std::path::Path;

use super::{ExpressionKind, Interval, IntervalKind, Intervals, frame_number, in_order};
use crate::micro_expression::MicroExpressionError;
use crate::micro_expression::forms;
use crate::micro_expression::sheet::read_form;

pub(super) const KIND: IntervalKind =
    IntervalKind { name: "casme3", about: "CAS(ME)3_part_A_v2.xls of CAS(ME)³", read };

const FPS: f64 = 30.0;

fn read(path: &Path) -> Result<Intervals, MicroExpressionError> {
    let table = read_form(&forms::CASME3, path)?;
    let mut found = Intervals { fps: Some(FPS), ..Intervals::default() };
    for row in table.rows() {
        let wrong = |reason| row.wrong(reason);
        let kind =
            ExpressionKind::of_text("Expression type", row.filled("Expression type")?).map_err(wrong)?;
        // Five rows write the letter of the video large.
        let video = format!("{}_{}", row.filled("Subject")?, row.filled("Filename")?.to_lowercase());
        let frame = |column: &str| frame_number(column, row.text(column)).map_err(wrong);
        let (onset, apex, offset) = (frame("Onset")?, frame("Apex")?, frame("Offset")?);
        in_order(onset, offset).map_err(wrong)?;
        let (label, action_units) = (row.text("Objective class").to_owned(), row.text("AU").to_owned());
        found.intervals.push(Interval { video, kind, onset, apex: Some(apex), offset, label, action_units });
    }
    Ok(found)
}
