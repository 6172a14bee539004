//! Blinks and gaze.

use glam::{EulerRot, Quat};
use srflow_core::random::Key;

use super::{add_unit, available_units, quintic};
use crate::{HeadModel, HeadModelError, HeadPose, JointRole, Side};

/// Duration of closing and of opening the lids, seconds.
const BLINK_SECONDS: [f32; 2] = [0.11, 0.19];
/// Duration of an eye movement between fixations, seconds: long for a saccade, short for a pursuit.
const GAZE_SHIFT_SECONDS: f32 = 0.14;

/// The blinks of a sequence.
#[derive(Debug, Clone, Default)]
pub struct Blinks {
    /// Seconds at which the lids begin to close.
    starts: Vec<f32>,
}

impl Blinks {
    /// Every 1.6 to 5.5 seconds.
    pub fn random(key: Key, seconds: f32) -> Self {
        let mut stream = key.stream("blinks");
        let mut starts = Vec::new();
        let mut start = stream.uniform(0.5, 3.0);
        while start < seconds {
            starts.push(start);
            start += stream.uniform(1.6, 5.5);
        }
        Self { starts }
    }

    /// First and last second of every blink.
    pub fn spans(&self) -> impl Iterator<Item = [f32; 2]> {
        let [close, open] = BLINK_SECONDS;
        self.starts.iter().map(move |&start| [start, start + close + open])
    }

    /// How far the lids are closed, `0..=1`.
    pub fn closed_at(&self, time: f32) -> f32 {
        let [close, open] = BLINK_SECONDS;
        let closed =
            |start: f32| quintic((time - start) / close) * quintic((start + close + open - time) / open);
        self.starts.iter().map(|&start| closed(start)).fold(0.0, f32::max)
    }
}

/// The gaze of a sequence: fixations, and short movements between them.
#[derive(Debug, Clone, Default)]
pub struct Gaze {
    fixations: Vec<Fixation>,
}

#[derive(Debug, Clone, Copy)]
struct Fixation {
    start: f32,
    gaze: [f32; 2],
}

impl Gaze {
    /// Fixations of 0.5 to 1.8 seconds, a third of them straight ahead.
    pub fn random(key: Key, seconds: f32) -> Self {
        let mut stream = key.stream("gaze");
        let mut fixations = Vec::new();
        let mut start = stream.uniform(0.3, 1.2);
        while start < seconds {
            // Every third fixation returns to the camera.
            let away = if stream.unit() < 0.35 { 0.0 } else { 1.0 };
            let gaze = [stream.uniform(-0.32, 0.32) * away, stream.uniform(-0.20, 0.16) * away];
            fixations.push(Fixation { start, gaze });
            start += stream.uniform(0.5, 1.8);
        }
        Self { fixations }
    }

    /// First and last second of every movement of the eyes.
    pub fn shifts(&self) -> impl Iterator<Item = [f32; 2]> {
        let before = std::iter::once([0.0; 2]).chain(self.fixations.iter().map(|fixation| fixation.gaze));
        let moves = self.fixations.iter().zip(before).filter(|(fixation, before)| fixation.gaze != *before);
        moves.map(|(fixation, _)| [fixation.start, fixation.start + GAZE_SHIFT_SECONDS])
    }

    /// Of both eyes relative to the head, radians: to the subject's left and up.
    pub fn at(&self, time: f32) -> [f32; 2] {
        let mut gaze = [0.0; 2];
        for fixation in &self.fixations {
            let arrived = quintic((time - fixation.start) / GAZE_SHIFT_SECONDS);
            gaze = [0, 1].map(|axis| gaze[axis] + (fixation.gaze[axis] - gaze[axis]) * arrived);
        }
        gaze
    }
}

/// The pose of a face that shows `units`, with the lids closed by `closed`, 0 to 1, and the eyes turned by `gaze`. Adds what the lids do
/// to the units.
///
/// # Errors
/// [`HeadModelError::NoActionUnit`] when `model` lacks one of the units.
pub fn pose_of_face(
    model: &HeadModel,
    units: &mut Vec<(u8, Side, f32)>,
    closed: f32,
    gaze: [f32; 2],
) -> Result<HeadPose, HeadModelError> {
    add_lids(units, &available_units(model), closed, gaze);
    units.retain(|unit| unit.2 > 0.0);
    let mut pose = model.pose_of_action_units(units)?;
    turn_eyes(&mut pose, model, gaze);
    Ok(pose)
}

/// Closes the lids by `closed`, or as far as the gaze is down, and raises them for a gaze up.
fn add_lids(units: &mut Vec<(u8, Side, f32)>, available: &[(u8, Side)], closed: f32, [_, gaze_up]: [f32; 2]) {
    let closed = closed.max(-gaze_up * 0.9).min(1.0);
    let number = if available.iter().any(|(n, _)| *n == 45) { 45 } else { 43 };
    for &(n, side) in available.iter().filter(|(n, _)| *n == number) {
        add_unit(units, n, side, closed);
    }
    if closed <= 0.0 {
        for &(n, side) in available.iter().filter(|(n, _)| *n == 5) {
            add_unit(units, n, side, (gaze_up * 1.2).clamp(0.0, 0.5));
        }
    }
}

/// Turns both eyes of a pose by a gaze.
fn turn_eyes(pose: &mut HeadPose, model: &HeadModel, [left, up]: [f32; 2]) {
    let turn = Quat::from_euler(EulerRot::YXZ, left, -up, 0.0);
    for eye in [JointRole::LeftEye, JointRole::RightEye].into_iter().filter_map(|role| model.joint(role)) {
        *pose.joint_mut(eye) *= turn;
    }
}
