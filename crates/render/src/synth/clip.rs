//! One clip: a head with a micro-expression and a slight drift, in front of a static camera.

use serde::{Deserialize, Serialize};
use srflow_avatar::{Avatar, PosedHead};
use srflow_core::random::Key;
use srflow_head::motion::{Sentences, Speech, add_unit, available_units};
use srflow_head::{HeadModel, HeadModelError, HeadPose, MicroExpression, Side};
use srflow_splat::Camera;

use super::portrait::{camera, drift, landmarks_in_image, move_head};
use super::settings::{ClipPlan, FRAMES_AT_REST, SynthSettings};
use crate::action_units::{action_unit_sets, coded_units, unit_name};
use crate::distractors::{Distractors, Strengths};
use crate::generate::SmoothPath;
use crate::recording::Light;

/// Maximum rotation (yaw, pitch, roll in degrees) and translation (metres) of the head within a clip, at drift 1.
const DRIFT_DEGREES: [f32; 3] = [0.12, 0.1, 0.08];
const DRIFT_METRES: f32 = 0.00015;

/// Seconds between control points of the drift.
const DRIFT_KNOT_SECONDS: f32 = 0.25;

/// A clip begins so many seconds into what its person does besides, at least and at most.
const BEFORE_SECONDS: [f32; 2] = [4.0, 12.0];

/// Something other than the expression that a clip shows.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Disturbance {
    /// `blink`, `glance`, `nod`, `shake` or `speech`.
    pub what: String,
    /// First and last frame.
    pub first: u64,
    pub last: u64,
}

/// What the person of a clip does besides.
struct Besides {
    distractors: Distractors,
    speech: Speech,
    sentences: Sentences,
    available: Vec<(u8, Side)>,
    loudness: f32,
    /// Second at which the clip begins.
    start: f32,
    frames_per_second: f32,
}

impl Besides {
    /// `None` where nothing but the expression moves the face.
    fn random(model: &HeadModel, key: Key, settings: &SynthSettings, frames: usize) -> Option<Self> {
        let [least, most] = BEFORE_SECONDS;
        let start = key.stream("eyes").uniform(least, most);
        let end = start + frames as f32 / settings.fps;
        let SynthSettings { blinks, glances, gestures, .. } = *settings;
        let strengths = Strengths { blinks, glances, gestures };
        settings.has_disturbances().then(|| Self {
            distractors: Distractors::random(key, end, strengths),
            speech: Speech::random(key, end, settings.look),
            sentences: Sentences::random(key, end),
            available: available_units(model),
            loudness: settings.speech,
            start,
            frames_per_second: settings.fps,
        })
    }

    fn pose(
        &self,
        model: &HeadModel,
        expression: &MicroExpression,
        frame: usize,
    ) -> Result<HeadPose, HeadModelError> {
        let second = self.start + frame as f32 / self.frames_per_second;
        let loudness = self.loudness * self.sentences.loudness_at(second);
        let mut units = expression.action_units_at(frame);
        if loudness > 0.0 {
            for (number, side, spoken) in self.speech.units_at(&self.available, second, loudness) {
                add_unit(&mut units, number, side, spoken);
            }
        }
        self.distractors.pose(model, units, second)
    }

    /// What of it falls into the `frames` of the clip.
    fn disturbances(&self, frames: usize) -> Vec<Disturbance> {
        let frame = |second: f32| (second - self.start) * self.frames_per_second;
        let sentences = self.sentences.spans().filter(|_| self.loudness > 0.0).map(|span| ("speech", span));
        let within = |(what, [first, last]): (&str, [f32; 2])| {
            let (first, last) = (frame(first).ceil().max(0.0), frame(last).floor().min((frames - 1) as f32));
            (first <= last).then(|| Disturbance {
                what: what.to_owned(),
                first: first as u64,
                last: last as u64,
            })
        };
        self.distractors.spans().chain(sentences).filter_map(within).collect()
    }
}

pub struct Clip {
    pub expression: MicroExpression,
    pub camera: Camera,
    pub light: Light,
    pub key: Key,
    drift: SmoothPath<6>,
    besides: Option<Besides>,
    frames: usize,
}

impl Clip {
    pub fn new(avatar: &Avatar, settings: &SynthSettings, plan: &ClipPlan) -> Result<Self, HeadModelError> {
        let key = Key::new(settings.seed).scene(plan.number);
        let mut expression = MicroExpression::random(
            avatar.model(),
            action_unit_sets(plan.class),
            key,
            FRAMES_AT_REST,
            settings.fps,
        )?;
        for (_, _, intensity) in &mut expression.action_units {
            *intensity = (*intensity * settings.intensity).clamp(0.0, 1.0);
        }
        let frames = expression.offset + FRAMES_AT_REST + 1;
        let seconds = frames as f32 / settings.fps;
        let points = (seconds / DRIFT_KNOT_SECONDS).ceil().clamp(1.0, 1000.0) as usize + 2;
        Ok(Self {
            camera: camera(avatar, settings.side, &mut key.stream("framing")),
            light: Light::random(key, settings.lighting),
            drift: drift(&mut key.stream("drift"), points, DRIFT_DEGREES, DRIFT_METRES, settings.drift),
            besides: Besides::random(avatar.model(), key, settings, frames),
            expression,
            key,
            frames,
        })
    }

    pub fn len(&self) -> usize {
        self.frames
    }

    /// The head in a frame.
    pub fn pose(&self, avatar: &Avatar, frame: usize) -> Result<HeadPose, HeadModelError> {
        let (model, expression) = (avatar.model(), &self.expression);
        let mut pose = match &self.besides {
            Some(besides) => besides.pose(model, expression, frame)?,
            None => expression.pose(model, frame)?,
        };
        move_head(&mut pose, self.drift.at(frame as f64 / (self.frames - 1).max(1) as f64));
        Ok(pose)
    }

    /// Image positions of dlib's 68 landmarks on a posed head, in pixels.
    pub fn landmarks(&self, avatar: &Avatar, head: &PosedHead) -> Vec<[f64; 2]> {
        landmarks_in_image(avatar, head, &self.camera)
    }

    /// What the clip shows besides the expression.
    pub fn disturbances(&self) -> Vec<Disturbance> {
        self.besides.as_ref().map(|besides| besides.disturbances(self.frames)).unwrap_or_default()
    }

    /// Action units at the apex, by name.
    pub fn action_units(&self) -> impl Iterator<Item = (String, f32)> {
        self.expression
            .action_units
            .iter()
            .map(move |&(number, side, intensity)| (unit_name(number, side), intensity))
    }

    /// Numbers of the action units in the notation of datasets: `1+2`.
    pub fn coded_units(&self) -> String {
        coded_units(&self.expression.action_units)
    }
}
