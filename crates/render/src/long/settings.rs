//! The settings of long videos.

use serde::{Deserialize, Serialize};
use srflow_avatar::HeadSource;
use srflow_head::Look;

use crate::RenderError;
use crate::clap::Args;
use crate::distractors::Gestures;
use crate::error::{require, require_strengths};
#[cfg(feature = "clap")]
use crate::head::heads_help;
use crate::head::is_default;

/// The settings of long videos. Strengths of the disturbances are factors: 0 is none, 1 is about that of published recordings.
#[derive(Args, Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct LongSettings {
    /// Number of videos, each of another subject
    #[arg(long, value_name = "N", default_value_t = Self::default().subjects)]
    pub subjects: u32,
    /// Length of each video
    #[arg(long, value_name = "MINUTES", default_value_t = Self::default().minutes)]
    pub minutes: f32,
    /// Width and height of the frames in pixels
    #[arg(long, value_name = "PIXELS", default_value_t = Self::default().side)]
    pub side: usize,
    /// Frames per second
    #[arg(long, value_name = "RATE", default_value_t = Self::default().fps)]
    #[serde(rename = "frames_per_second", alias = "fps")]
    pub fps: f32,
    /// Strength of the micro-expressions; 1 is 12 to 40 % of an action unit's full strength
    #[arg(long, value_name = "FACTOR", default_value_t = Self::default().intensity)]
    pub intensity: f32,
    /// Sensor noise; 1 is a standard deviation of about 1.8 of 255 in mid-grey, growing with brightness
    #[arg(long, value_name = "FACTOR", default_value_t = Self::default().noise)]
    pub noise: f32,
    /// Head motion; 1 is up to 1.5 degrees and 2 mm to either side, within seconds
    #[arg(long, value_name = "FACTOR", default_value_t = Self::default().drift)]
    pub drift: f32,
    /// Illumination changes; 1 is slow changes of up to 2 %, with a gradient over the face, and 0.3 % flicker
    /// at 100 Hz
    #[arg(long, value_name = "FACTOR", default_value_t = Self::default().lighting)]
    pub lighting: f32,
    /// How far blinks close the lids, 0 to 1; one every 1.6 to 5.5 seconds
    #[arg(long, value_name = "FACTOR", default_value_t = Self::default().blinks)]
    pub blinks: f32,
    /// Strength of glances, 0 to 2; 1 turns the eyes by up to 18 degrees
    #[arg(long, value_name = "FACTOR", default_value_t = Self::default().glances)]
    pub glances: f32,
    /// Strength of speech, 0 to 2; a short sentence now and then
    #[arg(long, value_name = "FACTOR", default_value_t = Self::default().speech)]
    pub speech: f32,
    #[command(flatten)]
    #[serde(flatten)]
    pub gestures: Gestures,
    /// Head model, or several, which the subjects show in turn
    #[arg(long, value_name = "HEAD", default_values_t = Self::default().head, help = heads_help())]
    #[serde(skip_serializing_if = "is_default")]
    pub head: Vec<HeadSource>,
    /// Version of how heads look; 1 keeps the bytes of earlier datasets
    #[arg(long, value_name = "1|2", default_value_t = Self::default().look)]
    #[serde(skip_serializing_if = "Look::is_unrecorded")]
    pub look: Look,
    /// Random seed
    #[arg(long, value_name = "N", default_value_t = Self::default().seed)]
    pub seed: u64,
}

impl Default for LongSettings {
    fn default() -> Self {
        Self {
            subjects: 4,
            minutes: 1.0,
            side: 192,
            fps: 30.0,
            intensity: 1.0,
            noise: 1.0,
            drift: 1.0,
            lighting: 1.0,
            blinks: 1.0,
            glances: 1.0,
            speech: 1.0,
            gestures: Gestures::default(),
            head: vec![HeadSource::builtin()],
            look: Look::default(),
            seed: 1,
        }
    }
}

impl LongSettings {
    pub(super) fn check(&self) -> Result<(), RenderError> {
        require("subjects", self.subjects, "1 to 1000", (1..=1000).contains(&self.subjects))?;
        let minutes = (0.1..=120.0).contains(&self.minutes);
        require("minutes", self.minutes, "0.1 to 120", minutes)?;
        require("side", self.side, "64 to 4096 pixels", (64..=4096).contains(&self.side))?;
        let fps = (10.0..=500.0).contains(&self.fps);
        require("fps", self.fps, "10 to 500 frames per second", fps)?;
        let intensity = self.intensity > 0.0 && self.intensity <= 2.5;
        require("intensity", self.intensity, "above 0 to 2.5", intensity)?;
        require_strengths(&[
            ("noise", self.noise),
            ("drift", self.drift),
            ("lighting", self.lighting),
            ("blinks", self.blinks),
            ("glances", self.glances),
            ("speech", self.speech),
            ("nods", self.gestures.nods),
            ("breathing", self.gestures.breathing),
        ])
    }

    /// Frames of each video, in whole pieces.
    pub(super) fn frames(&self, piece: u32) -> u32 {
        // At most 120 minutes at 500 frames per second.
        let frames = (self.minutes * 60.0 * self.fps) as u32;
        frames.div_ceil(piece).max(1) * piece
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn settings_out_of_range_are_named() {
        let default = LongSettings::default;
        for (settings, argument) in [
            (LongSettings { subjects: 0, ..default() }, "subjects"),
            (LongSettings { minutes: f32::NAN, ..default() }, "minutes"),
            (LongSettings { side: 20, ..default() }, "side"),
            (LongSettings { fps: 1.0, ..default() }, "fps"),
            (LongSettings { intensity: 0.0, ..default() }, "intensity"),
            (LongSettings { blinks: 1.5, ..default() }, "blinks"),
            (LongSettings { speech: -1.0, ..default() }, "speech"),
        ] {
            let error = settings.check().unwrap_err().to_string();
            assert!(error.starts_with(argument), "{error}");
        }
    }
}
