//! What was spotted in a video.

use std::path::PathBuf;

use serde::{Deserialize, Serialize};
use srflow_data::micro_expression::intervals::{ExpressionKind, Interval};
use srflow_mer::spotting::{Signals, SpottedEvent, candidate_units};

/// What was spotted in a video.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct SpottedVideo {
    pub video: String,
    /// Its file or folder.
    pub path: PathBuf,
    pub seconds: f64,
    /// Part of the frames in which a face is seen and does not move fast.
    pub usable: f64,
    pub events: Vec<Event>,
}

/// A spotted expression. Frames are numbered as in the names of the files, or from 1 in a video, and inclusive.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Event {
    #[serde(rename = "type")]
    pub kind: ExpressionKind,
    pub onset: i64,
    pub apex: i64,
    pub offset: i64,
    pub onset_seconds: f64,
    pub apex_seconds: f64,
    pub offset_seconds: f64,
    /// The region that stands out most.
    pub region: String,
    /// How far it moves, in pixels of the video.
    pub height_px: f64,
    /// How far it stands out from noise, and from its surroundings if the expression is short.
    pub score: f64,
    /// Whether the lids move more: perhaps a blink.
    pub with_lids: bool,
    /// The action units that the motion from onset to apex looks like.
    pub action_units: Vec<u8>,
}

impl Event {
    /// An event among frames with these numbers and times; `pixel` is how many pixels of the video a pixel of the crop has.
    pub(super) fn new(
        event: &SpottedEvent,
        signals: &Signals,
        frame: impl Fn(usize) -> i64,
        seconds: impl Fn(usize) -> f64,
        pixel: f64,
    ) -> Self {
        Self {
            kind: event.kind,
            onset: frame(event.onset),
            apex: frame(event.apex),
            offset: frame(event.offset),
            onset_seconds: seconds(event.onset),
            apex_seconds: seconds(event.apex),
            offset_seconds: seconds(event.offset),
            region: event.region.to_owned(),
            height_px: event.height_px * pixel,
            score: event.score,
            with_lids: event.with_lids,
            action_units: candidate_units(&signals.moved(event.onset, event.apex)),
        }
    }

    pub(super) fn interval(&self, video: &str) -> Interval {
        Interval {
            video: video.to_owned(),
            kind: self.kind,
            onset: self.onset,
            apex: Some(self.apex),
            offset: self.offset,
            label: self.region.clone(),
            action_units: self.units(),
        }
    }

    /// As datasets write them, e.g. `1+2`.
    pub(super) fn units(&self) -> String {
        self.action_units.iter().map(u8::to_string).collect::<Vec<_>>().join("+")
    }
}
