//! Expressions in long videos: in which frames a face shows what. The truth of spotting, and what programs spot.

mod casme3;
pub(super) mod casme_squared;
mod csv_file;
mod kind;
mod samm_long;
mod table;

use serde::Serialize;
use srflow_core::{named, serialize_as_text};
use srflow_files::whole_number;

pub use csv_file::{EVENT_COLUMNS, write_intervals};
pub use kind::IntervalKind;
pub use table::{INTERVAL_KINDS, IntervalSource};

/// Micro-expressions are involuntary and short.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum ExpressionKind {
    Micro,
    Macro,
}

named!(ExpressionKind, "a type of expression", { Micro => "micro", Macro => "macro" });
serialize_as_text!(ExpressionKind);

impl ExpressionKind {
    /// What datasets and challenges call it, in any case: `me`, `Micro - 1/2`, `macro-expression`.
    fn of_text(column: &str, text: &str) -> Result<Self, String> {
        let name = text.trim().to_ascii_lowercase();
        match name.as_str() {
            "me" => Ok(Self::Micro),
            "mae" => Ok(Self::Macro),
            _ if name.starts_with("micro") => Ok(Self::Micro),
            _ if name.starts_with("macro") => Ok(Self::Macro),
            _ => Err(format!("{column}: expected micro or macro (or me, mae), found `{text}`")),
        }
    }
}

/// An expression in a video. Frames are inclusive; programs that pad what they spot also write negative ones.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct Interval {
    /// Name of the video.
    pub video: String,
    #[serde(rename = "type")]
    pub kind: ExpressionKind,
    pub onset: i64,
    pub apex: Option<i64>,
    pub offset: i64,
    /// Emotion or class; empty where it is not known.
    pub label: String,
    /// As coded; empty where it is not known.
    pub action_units: String,
}

impl Interval {
    /// Number of frames.
    pub fn frames(&self) -> i64 {
        self.offset - self.onset + 1
    }
}

/// The intervals of a file.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Intervals {
    /// In file order.
    pub intervals: Vec<Interval>,
    /// What was repaired or left out, with numbers of rows.
    pub notes: Vec<String>,
    /// Frames per second of the recordings, where the dataset has one rate.
    pub fps: Option<f64>,
}

/// Frame numbers that are read are this large at most.
const LAST_FRAME: i64 = 1 << 40;

/// A frame number in a column, perhaps as programs write it whose columns hold fractions, such as `19.0`.
fn frame_number(column: &str, text: &str) -> Result<i64, String> {
    let (sign, digits) = text.trim().strip_prefix('-').map_or((1, text), |digits| (-1, digits));
    let number = whole_number(digits).and_then(|number| i64::try_from(number).ok());
    let number = number.filter(|number| *number <= LAST_FRAME);
    number
        .map(|number| sign * number)
        .ok_or_else(|| format!("{column}: expected a frame number, found `{text}`"))
}

fn in_order(onset: i64, offset: i64) -> Result<(), String> {
    match onset <= offset {
        true => Ok(()),
        false => Err(format!("expected onset <= offset, found onset {onset}, offset {offset}")),
    }
}
