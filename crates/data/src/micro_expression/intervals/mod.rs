//! Expressions in long videos: in which frames a face shows what. The truth of spotting, and what programs spot.

mod casme3;
mod casme_squared;
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
    fn of_text(text: &str) -> Option<Self> {
        let text = text.trim().to_ascii_lowercase();
        match text.as_str() {
            "me" => Some(Self::Micro),
            "mae" => Some(Self::Macro),
            _ if text.starts_with("micro") => Some(Self::Micro),
            _ if text.starts_with("macro") => Some(Self::Macro),
            _ => None,
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

/// A frame number, perhaps as programs write it whose columns hold fractions, such as `19.0`.
fn frame_number(text: &str) -> Option<i64> {
    let (sign, digits) = text.trim().strip_prefix('-').map_or((1, text), |digits| (-1, digits));
    let number = i64::try_from(whole_number(digits)?).ok()?;
    (number <= LAST_FRAME).then_some(sign * number)
}
