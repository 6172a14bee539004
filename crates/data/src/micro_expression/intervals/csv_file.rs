//! CSV files: those of `srflow mer spot`, those of challenges (`vid,pred_onset,pred_offset,type`), and users' own.

use std::path::Path;

use srflow_core::excerpt;
use srflow_files::{CsvTable, FileKind, write_atomically};

use super::{ExpressionKind, Interval, IntervalKind, Intervals, frame_number, in_order};
use crate::micro_expression::MicroExpressionError;

pub(super) const KIND: IntervalKind =
    IntervalKind { name: "csv", about: "columns video, onset, offset, type (micro or macro)", read };

/// The columns that [`write_intervals`] writes.
pub const EVENT_COLUMNS: [&str; 7] = ["video", "type", "onset", "apex", "offset", "label", "action_units"];

/// Names of the columns; the first is ours.
const VIDEO: [&str; 2] = ["video", "vid"];
const ONSET: [&str; 2] = ["onset", "pred_onset"];
const OFFSET: [&str; 2] = ["offset", "pred_offset"];
const TYPE: [&str; 1] = ["type"];
const APEX: [&str; 2] = ["apex", "pred_apex"];
const LABEL: [&str; 3] = ["label", "emotion", "class"];
const ACTION_UNITS: [&str; 1] = ["action_units"];

fn read(path: &Path) -> Result<Intervals, MicroExpressionError> {
    let mut table = CsvTable::open(path, FileKind::Table)?;
    let place = |names: &[&str]| -> Result<Option<usize>, MicroExpressionError> {
        for name in names {
            if let Some(place) = table.column(name)? {
                return Ok(Some(place));
            }
        }
        Ok(None)
    };
    let needed = |names: &[&str]| {
        place(names)?.ok_or_else(|| MicroExpressionError::Columns {
            path: path.to_owned(),
            kind: "a list of intervals",
            expected: "video, onset, offset, type".to_owned(),
            found: format!("{} is not among {}", names[0], table.shown_columns()),
        })
    };
    let [video, onset, offset, kind] = [needed(&VIDEO)?, needed(&ONSET)?, needed(&OFFSET)?, needed(&TYPE)?];
    let [apex, label, units] = [place(&APEX)?, place(&LABEL)?, place(&ACTION_UNITS)?];
    let mut intervals = Vec::new();
    while let Some(row) = table.next_row()? {
        let wrong = |reason: String| MicroExpressionError::Row {
            path: path.to_owned(),
            row: row.line,
            reason: excerpt(&reason),
        };
        let frame = |column: &str, text: &str| frame_number(column, text).map_err(wrong);
        let (first, last) = (frame("onset", row.text(onset))?, frame("offset", row.text(offset))?);
        in_order(first, last).map_err(wrong)?;
        let kind = ExpressionKind::of_text("type", row.text(kind)).map_err(wrong)?;
        let text = |place: Option<usize>| place.map_or("", |place| row.text(place));
        let video = row.text(video).to_owned();
        if video.is_empty() {
            return Err(wrong("video: expected a name, found an empty cell".to_owned()));
        }
        let apex = match text(apex) {
            "" => None,
            text => Some(frame("apex", text)?),
        };
        intervals.push(Interval {
            video,
            kind,
            onset: first,
            apex,
            offset: last,
            label: text(label).to_owned(),
            action_units: text(units).to_owned(),
        });
    }
    Ok(Intervals { intervals, ..Intervals::default() })
}

/// Writes a CSV file of intervals, whole or not at all.
///
/// # Errors
/// When it cannot be written.
pub fn write_intervals(path: &Path, intervals: &[Interval]) -> Result<(), MicroExpressionError> {
    write_atomically(path, |writer| {
        let mut table = csv::Writer::from_writer(writer);
        table.write_record(EVENT_COLUMNS)?;
        for interval in intervals {
            table.write_record([
                interval.video.as_str(),
                interval.kind.name(),
                &interval.onset.to_string(),
                &interval.apex.map(|apex| apex.to_string()).unwrap_or_default(),
                &interval.offset.to_string(),
                &interval.label,
                &interval.action_units,
            ])?;
        }
        table.flush()
    })?;
    Ok(())
}
