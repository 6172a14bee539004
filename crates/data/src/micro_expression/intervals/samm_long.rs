//! SAMM Long Videos (Yap et al. 2020), `SAMM_LongVideos_V2_Release.xlsx`. In the second edition, frames may be fractions.

use std::path::Path;

use super::{ExpressionKind, Interval, IntervalKind, Intervals, in_order};
use crate::micro_expression::MicroExpressionError;
use crate::micro_expression::forms;
use crate::micro_expression::sheet::{Row, read_form};

pub(super) const KIND: IntervalKind =
    IntervalKind { name: "samm-long", about: "SAMM_LongVideos_V2_Release.xlsx of SAMM Long Videos", read };

const FPS: f64 = 200.0;

fn read(path: &Path) -> Result<Intervals, MicroExpressionError> {
    let table = read_form(&forms::SAMM_LONG, path)?;
    let mut found = Intervals { fps: Some(FPS), ..Intervals::default() };
    let mut before_the_video = 0;
    for row in table.rows() {
        let wrong = |reason| row.wrong(reason);
        let clip = row.filled("Filename")?;
        // The clip is the video's name and a number: 006_1_2.
        let video = clip.rsplit_once('_').map_or(clip, |(video, _)| video).to_owned();
        let kind = ExpressionKind::of_text("Type", row.filled("Type")?).map_err(wrong)?;
        let (onset, offset) = (rounded(row, "Onset")?, rounded(row, "Offset")?);
        // -1 is unknown.
        let apex = Some(rounded(row, "Apex")?).filter(|apex| *apex >= 0);
        before_the_video += usize::from(onset < 1);
        let onset = onset.max(1);
        in_order(onset, offset).map_err(wrong)?;
        let action_units = row.text("Action Units").to_owned();
        found.intervals.push(Interval {
            video,
            kind,
            onset,
            apex,
            offset,
            label: String::new(),
            action_units,
        });
    }
    if before_the_video > 0 {
        found
            .notes
            .push(format!("{before_the_video} expressions began before the video: their onset is frame 1"));
    }
    Ok(found)
}

/// A frame, to the nearest whole number.
fn rounded(row: Row, column: &str) -> Result<i64, MicroExpressionError> {
    let text = row.text(column);
    let number = text.parse::<f64>().ok().filter(|number| number.abs() < 1e9);
    // The cast is exact: the number is small.
    number
        .map(|number| (number + 0.5).floor() as i64)
        .ok_or_else(|| row.wrong(format!("{column}: expected a frame number, found `{text}`")))
}
