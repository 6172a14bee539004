//! Smooth random motion of a face: expressions, speech, blinks, gaze, the neck, nods and breathing.

mod curve;
mod eyes;
mod gestures;
mod speech;

use glam::{EulerRot, Quat};
use srflow_core::random::{Key, Stream};

use crate::{HeadModel, HeadPose, JointRole, Look, Side};
use curve::Curve;

pub use curve::quintic;
pub use eyes::{Blinks, Gaze, pose_of_face};
pub use gestures::{Breathing, Nods, move_by_gestures};
pub use speech::{Sentences, Speech};

/// One frame of a motion.
#[derive(Debug, Clone, PartialEq)]
pub struct Moment {
    /// Input of the head model.
    pub pose: HeadPose,
    /// Active action units and their intensities, `0..=1`.
    pub action_units: Vec<(u8, Side, f32)>,
    /// Gaze of both eyes relative to the head, radians: to the subject's left and up.
    pub gaze: [f32; 2],
}

/// Realistic combinations of action units: emotions (EMFACS prototypes) and conversational expressions. Units that the head
/// model lacks are omitted.
const EXPRESSIONS: &[&[(u8, f32)]] = &[
    &[(6, 0.8), (12, 1.0)],
    &[(6, 0.6), (12, 0.9), (25, 1.0), (26, 0.4)],
    &[(12, 0.6)],
    &[(1, 1.0), (2, 1.0), (5, 0.8), (26, 0.8)],
    &[(1, 0.8), (2, 0.8)],
    &[(1, 0.9), (4, 0.6), (15, 0.8)],
    &[(4, 1.0), (5, 0.4), (7, 0.7), (23, 0.6), (24, 0.5)],
    &[(4, 0.8), (7, 0.6)],
    &[(9, 0.9), (10, 0.5), (4, 0.4)],
    &[(10, 0.8), (15, 0.4), (17, 0.6)],
    &[(1, 0.8), (2, 0.5), (4, 0.5), (5, 0.8), (20, 0.8), (25, 0.7)],
    &[(14, 0.9)],
    &[(15, 0.8), (17, 0.7)],
    &[(17, 0.7), (24, 0.7)],
    &[(20, 0.8), (16, 0.4), (25, 0.6)],
    &[(43, 0.9), (7, 0.4)],
];

/// Duration of the fade from and to rest at the ends of a sequence, seconds.
const EASE_SECONDS: f32 = 0.6;

/// The motion of one sequence, computed frame by frame in any order. It starts and ends at rest.
#[derive(Debug, Clone)]
pub struct Motion {
    frames: usize,
    frames_per_second: f32,
    events: Vec<Event>,
    blinks: Blinks,
    gaze: Gaze,
    neck: [Curve; 3],
    speech: Speech,
    /// `None` in the first look.
    gestures: Option<(Nods, Breathing)>,
    available: Vec<(u8, Side)>,
}

/// An expression, or a sentence, with attack, hold and release.
#[derive(Debug, Clone)]
struct Event {
    start: f32,
    attack: f32,
    hold: f32,
    release: f32,
    /// `None` while the person speaks.
    units: Option<Vec<(u8, Side, f32)>>,
}

impl Motion {
    /// The motion for `key` (with its scene), of `frames` frames, for this head model. In the first look, people speak without sounds and
    /// neither nod nor breathe.
    pub fn new(model: &HeadModel, look: Look, key: Key, frames: usize, frames_per_second: f32) -> Self {
        let frames_per_second = if frames_per_second.is_finite() { frames_per_second.max(1.0) } else { 24.0 };
        let seconds = frames as f32 / frames_per_second;
        let available = available_units(model);
        let curve = |purpose: &str, knot_seconds: f32, reach: f32| {
            Curve::random(&mut key.stream(purpose), seconds, knot_seconds, reach)
        };
        Self {
            events: events(&mut key.stream("expressions"), seconds, &available),
            blinks: Blinks::random(key, seconds),
            gaze: Gaze::random(key, seconds),
            neck: [
                curve("neck yaw", 0.9, 0.26),
                curve("neck pitch", 0.8, 0.15),
                curve("neck roll", 1.1, 0.11),
            ],
            speech: Speech::random(key, seconds, look),
            gestures: (look >= Look::Second)
                .then(|| (Nods::random(key, seconds), Breathing::random(key, seconds))),
            available,
            frames,
            frames_per_second,
        }
    }

    /// Number of frames.
    pub fn len(&self) -> usize {
        self.frames
    }

    pub fn is_empty(&self) -> bool {
        self.frames == 0
    }

    /// Frame number `frame`, from 0. Outside the sequence the head is at rest.
    pub fn at(&self, model: &HeadModel, frame: usize) -> Moment {
        let time = frame as f32 / self.frames_per_second;
        let ease = self.ease(frame);
        let gaze = self.gaze.at(time).map(|angle| angle * ease);
        let mut units: Vec<(u8, Side, f32)> = Vec::new();
        for event in &self.events {
            let strength = event.strength(time) * ease;
            if strength <= 0.0 {
                continue;
            }
            let shown = match &event.units {
                None => self.speech.units_at(&self.available, time, strength),
                Some(units) => units.iter().map(|&(n, side, most)| (n, side, most * strength)).collect(),
            };
            for (number, side, intensity) in shown {
                add_unit(&mut units, number, side, intensity);
            }
        }
        let closed = self.blinks.closed_at(time) * ease;
        // Only units of the model are ever added, so this cannot fail.
        let mut pose = pose_of_face(model, &mut units, closed, gaze).unwrap_or_default();
        let [yaw, pitch, roll] = [0, 1, 2].map(|axis| self.neck[axis].at(time) * ease);
        if let Some(neck) = model.joint(JointRole::Neck) {
            *pose.joint_mut(neck) *= Quat::from_euler(EulerRot::YXZ, yaw, -pitch, roll);
        }
        if let Some((nods, breathing)) = &self.gestures {
            let nod = nods.at(time).map(|angle| angle * ease);
            move_by_gestures(&mut pose, model, nod, breathing.at(time) * ease);
        }
        Moment { pose, action_units: units, gaze }
    }

    /// 0 at the first and the last frame, 1 between.
    fn ease(&self, frame: usize) -> f32 {
        let Some(last) = self.frames.checked_sub(1) else { return 0.0 };
        let seconds = last as f32 / self.frames_per_second;
        let ease = EASE_SECONDS.min(seconds * 0.45).max(1e-6);
        let from_start = frame as f32 / self.frames_per_second;
        let to_end = last.saturating_sub(frame) as f32 / self.frames_per_second;
        quintic(from_start / ease) * quintic(to_end / ease)
    }
}

/// All frames of [`Motion`].
pub fn sequence(
    model: &HeadModel,
    look: Look,
    key: Key,
    frames: usize,
    frames_per_second: f32,
) -> Vec<Moment> {
    let motion = Motion::new(model, look, key, frames, frames_per_second);
    (0..frames).map(|frame| motion.at(model, frame)).collect()
}

/// Units, split into halves where they have them, in the model's order.
pub fn available_units(model: &HeadModel) -> Vec<(u8, Side)> {
    model.action_units.iter().map(|unit| (unit.number, unit.side)).collect()
}

/// Adds to the intensity of a unit, up to 1.
pub fn add_unit(units: &mut Vec<(u8, Side, f32)>, number: u8, side: Side, intensity: f32) {
    match units.iter_mut().find(|u| u.0 == number && u.1 == side) {
        Some(unit) => unit.2 = (unit.2 + intensity).min(1.0),
        None => units.push((number, side, intensity.clamp(0.0, 1.0))),
    }
}

fn events(stream: &mut Stream, seconds: f32, available: &[(u8, Side)]) -> Vec<Event> {
    let mut events = Vec::new();
    let mut start = 0.0;
    while start < seconds {
        let speech = stream.unit() < 0.3;
        let event = Event {
            start,
            attack: stream.uniform(0.25, 0.7),
            hold: if speech { stream.uniform(0.8, 2.0) } else { stream.uniform(0.1, 0.9) },
            release: stream.uniform(0.3, 0.8),
            units: (!speech).then(|| expression_units(stream, available)),
        };
        // The next expression may start while this one still fades.
        start += event.attack + event.hold + event.release * stream.uniform(0.2, 1.3);
        events.push(event);
    }
    events
}

fn expression_units(stream: &mut Stream, available: &[(u8, Side)]) -> Vec<(u8, Side, f32)> {
    let set = EXPRESSIONS[stream.below(EXPRESSIONS.len() as u32) as usize];
    let strength = stream.uniform(0.35, 1.0);
    let skew = stream.normal().clamp(-2.0, 2.0) * 0.09;
    let mut units = Vec::new();
    for &(number, weight) in set {
        let weight = weight * strength * stream.uniform(0.8, 1.1);
        for &(n, side) in available.iter().filter(|(n, _)| *n == number) {
            let lean = match side {
                Side::Both => 1.0,
                Side::Left => 1.0 + skew,
                Side::Right => 1.0 - skew,
            };
            units.push((n, side, (weight * lean).clamp(0.0, 1.0)));
        }
    }
    units
}

impl Event {
    fn strength(&self, time: f32) -> f32 {
        let end = self.start + self.attack + self.hold + self.release;
        quintic((time - self.start) / self.attack) * quintic((end - time) / self.release)
    }
}
