//! One clip: a head with a micro-expression and a slight drift, in front of a static camera.

use srflow_avatar::{Avatar, PosedHead};
use srflow_core::random::Key;
use srflow_head::{HeadModelError, HeadPose, MicroExpression};
use srflow_splat::Camera;

use super::portrait::{camera, drift, landmarks_in_image, move_head};
use super::settings::{ClipPlan, FRAMES_AT_REST, SynthSettings};
use crate::action_units::{action_unit_sets, coded_units, unit_name};
use crate::generate::SmoothPath;
use crate::recording::Light;

/// Maximum rotation (yaw, pitch, roll in degrees) and translation (metres) of the head within a clip, at drift 1.
const DRIFT_DEGREES: [f32; 3] = [0.12, 0.1, 0.08];
const DRIFT_METRES: f32 = 0.00015;

/// Seconds between control points of the drift.
const DRIFT_KNOT_SECONDS: f32 = 0.25;

pub struct Clip {
    pub expression: MicroExpression,
    pub camera: Camera,
    pub light: Light,
    pub key: Key,
    drift: SmoothPath<6>,
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
        let mut pose = self.expression.pose(avatar.model(), frame)?;
        move_head(&mut pose, self.drift.at(frame as f64 / (self.frames - 1).max(1) as f64));
        Ok(pose)
    }

    /// Image positions of dlib's 68 landmarks on a posed head, in pixels.
    pub fn landmarks(&self, avatar: &Avatar, head: &PosedHead) -> Vec<[f64; 2]> {
        landmarks_in_image(avatar, head, &self.camera)
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
