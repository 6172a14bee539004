//! The settings of a micro-expression dataset, and the plan derived from them.

use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};
use srflow_avatar::HeadSource;
use srflow_data::micro_expression::EmotionClass;
use srflow_files::FlowFormat;
use srflow_head::Look;

use crate::RenderError;
use crate::clap::Args;
use crate::distractors::Gestures;
use crate::error::{is_none, require, require_strengths};
#[cfg(feature = "clap")]
use crate::head::heads_help;
use crate::head::is_default;

/// Number of frames at rest before the onset and after the offset.
pub(super) const FRAMES_AT_REST: usize = 3;

/// The settings of a micro-expression dataset. Strengths of the disturbances are factors: 0 is none, 1 is about that of published
/// recordings.
#[derive(Args, Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct SynthSettings {
    /// Number of subjects
    #[arg(long, value_name = "N", default_value_t = Self::default().subjects)]
    pub subjects: u32,
    /// Clips per subject; negative, positive and surprise alternate
    #[arg(long, value_name = "N", default_value_t = Self::default().clips)]
    #[serde(rename = "clips_per_subject", alias = "clips")]
    pub clips: u32,
    /// Width and height of the frames in pixels
    #[arg(long, value_name = "PIXELS", default_value_t = Self::default().side)]
    pub side: usize,
    /// Frames per second
    #[arg(long, value_name = "RATE", default_value_t = Self::default().fps)]
    #[serde(rename = "frames_per_second", alias = "fps")]
    pub fps: f32,
    /// Strength of the expressions; 1 is 12 to 40 % of an action unit's full strength
    #[arg(long, value_name = "FACTOR", default_value_t = Self::default().intensity)]
    pub intensity: f32,
    /// Sensor noise; 1 is a standard deviation of about 1.8 of 255 in mid-grey, growing with brightness
    #[arg(long, value_name = "FACTOR", default_value_t = Self::default().noise)]
    pub noise: f32,
    /// Head drift within a clip; 1 is up to 0.1 degrees and 0.15 mm to either side
    #[arg(long, value_name = "FACTOR", default_value_t = Self::default().drift)]
    pub drift: f32,
    /// Illumination changes; 1 is slow changes of up to 2 %, with a gradient over the face, and 0.3 % flicker
    /// at 100 Hz
    #[arg(long, value_name = "FACTOR", default_value_t = Self::default().lighting)]
    pub lighting: f32,
    /// How far blinks close the lids, 0 to 1; one every 1.6 to 5.5 seconds
    #[arg(long, value_name = "FACTOR", default_value_t = Self::default().blinks)]
    #[serde(skip_serializing_if = "is_none")]
    pub blinks: f32,
    /// Strength of glances, 0 to 2; 1 turns the eyes by up to 18 degrees
    #[arg(long, value_name = "FACTOR", default_value_t = Self::default().glances)]
    #[serde(skip_serializing_if = "is_none")]
    pub glances: f32,
    /// Strength of speech, 0 to 2; sentences of 1 to 3 seconds with pauses of 1 to 4
    #[arg(long, value_name = "FACTOR", default_value_t = Self::default().speech)]
    #[serde(skip_serializing_if = "is_none")]
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
    /// File format of the true flow
    #[arg(long, value_name = "FORMAT", default_value_t = Self::default().flow_format)]
    pub flow_format: FlowFormat,
    /// Write the onset and apex frames alone: all that features need
    #[arg(long)]
    #[serde(skip_serializing_if = "std::ops::Not::not")]
    pub only_key_frames: bool,
}

impl Default for SynthSettings {
    fn default() -> Self {
        Self {
            subjects: 12,
            clips: 6,
            side: 256,
            fps: 200.0,
            intensity: 1.0,
            noise: 1.0,
            drift: 1.0,
            lighting: 1.0,
            blinks: 0.0,
            glances: 0.0,
            speech: 0.0,
            gestures: Gestures::default(),
            head: vec![HeadSource::builtin()],
            look: Look::default(),
            seed: 1,
            flow_format: FlowFormat::Flo,
            only_key_frames: false,
        }
    }
}

#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct ClipPlan {
    /// Index among all clips; random choices are keyed by it.
    pub number: u32,
    /// Its subject's number.
    pub subject: u32,
    pub class: EmotionClass,
    /// Its subject's name, e.g. `s03`.
    pub subject_name: String,
    /// Its folder and name, e.g. `s03/c05`.
    pub name: String,
}

/// What moves from onset to apex.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Motion {
    Whole,
    /// The head, with the face as at the onset.
    Head,
    /// What the face adds to it.
    Expression,
}

impl Motion {
    pub const ALL: [Self; 3] = [Self::Whole, Self::Head, Self::Expression];

    fn suffix(self) -> &'static str {
        match self {
            Self::Whole => "_flow",
            Self::Head => "_head_flow",
            Self::Expression => "_expression_flow",
        }
    }
}

impl ClipPlan {
    pub fn folder(&self, dir: &Path) -> PathBuf {
        dir.join(&self.name)
    }

    /// The file of a true flow from onset to apex, next to the clip's folder.
    pub fn flow(&self, dir: &Path, motion: Motion, format: FlowFormat) -> PathBuf {
        dir.join(format!("{}{}.{}", self.name, motion.suffix(), format.extension()))
    }

    /// The files of the true flow, whole and in parts.
    pub fn flows(&self, dir: &Path, format: FlowFormat) -> [PathBuf; 3] {
        Motion::ALL.map(|motion| self.flow(dir, motion, format))
    }

    /// The mask of the head at the onset.
    pub fn mask(&self, dir: &Path) -> PathBuf {
        dir.join(format!("{}_mask.png", self.name))
    }

    /// The record of the clip; written last.
    pub fn record(&self, dir: &Path) -> PathBuf {
        dir.join(format!("{}.json", self.name))
    }
}

impl SynthSettings {
    /// Whether the clips show anything but expressions and drift.
    pub(super) fn has_disturbances(&self) -> bool {
        let Self { blinks, glances, speech, gestures: Gestures { nods, breathing }, .. } = *self;
        [blinks, glances, speech, nods, breathing].iter().any(|strength| *strength > 0.0)
    }

    /// Checks the settings and lists the clips, by subject.
    pub(super) fn plan(&self) -> Result<Vec<ClipPlan>, RenderError> {
        require("subjects", self.subjects, "1 to 1000", (1..=1000).contains(&self.subjects))?;
        require("clips", self.clips, "1 to 1000", (1..=1000).contains(&self.clips))?;
        require("side", self.side, "64 to 4096 pixels", (64..=4096).contains(&self.side))?;
        let fps = (10.0..=2000.0).contains(&self.fps);
        require("fps", self.fps, "10 to 2000 frames per second", fps)?;
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
        ])?;
        let clip = |number: u32| {
            let (subject, within) = (number / self.clips, number % self.clips);
            // Each subject starts with another class, which balances odd numbers of clips over the subjects.
            let class = EmotionClass::ALL[((within + subject) % 3) as usize];
            let subject_name = format!("s{:02}", subject + 1);
            let name = format!("{subject_name}/c{:02}", within + 1);
            ClipPlan { number, subject, class, subject_name, name }
        };
        Ok((0..self.subjects * self.clips).map(clip).collect())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn classes_are_even_and_names_are_unique() {
        for clips_per_subject in [1, 2, 3, 4, 7] {
            let settings =
                SynthSettings { subjects: 6, clips: clips_per_subject, ..SynthSettings::default() };
            let plan = settings.plan().unwrap();
            let count = |class| plan.iter().filter(|clip| clip.class == class).count() as u32;
            for class in EmotionClass::ALL {
                assert_eq!(count(class), 2 * clips_per_subject, "{clips_per_subject}");
            }
            let names: std::collections::BTreeSet<&str> =
                plan.iter().map(|clip| clip.name.as_str()).collect();
            assert_eq!(names.len(), plan.len());
        }
    }

    #[test]
    fn settings_are_read_as_they_are_written() {
        let settings = SynthSettings { flow_format: FlowFormat::Npz16, ..SynthSettings::default() };
        let text = serde_json::to_string(&settings).unwrap();
        assert!(text.contains(r#""flow_format":"npz16""#), "{text}");
        assert_eq!(serde_json::from_str::<SynthSettings>(&text).unwrap(), settings);
    }

    #[test]
    fn settings_out_of_range_are_named() {
        let default = SynthSettings::default;
        for (settings, argument) in [
            (SynthSettings { subjects: 0, ..default() }, "subjects"),
            (SynthSettings { clips: 1001, ..default() }, "clips"),
            (SynthSettings { side: 20, ..default() }, "side"),
            (SynthSettings { fps: f32::NAN, ..default() }, "fps"),
            (SynthSettings { intensity: 0.0, ..default() }, "intensity"),
            (SynthSettings { noise: -1.0, ..default() }, "noise"),
            (SynthSettings { drift: f32::INFINITY, ..default() }, "drift"),
            (SynthSettings { lighting: f32::NAN, ..default() }, "lighting"),
            (SynthSettings { blinks: 1.5, ..default() }, "blinks"),
            (SynthSettings { glances: -1.0, ..default() }, "glances"),
            (SynthSettings { gestures: Gestures { nods: 3.0, breathing: 0.0 }, ..default() }, "nods"),
            (
                SynthSettings { gestures: Gestures { nods: 0.0, breathing: f32::NAN }, ..default() },
                "breathing",
            ),
        ] {
            let error = settings.plan().unwrap_err().to_string();
            assert!(error.starts_with(argument), "{error}");
        }
    }
}
