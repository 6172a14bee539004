//! Nods, shakes of the head, and breathing.

use std::f32::consts::{PI, TAU};

use glam::{EulerRot, Quat, Vec3};
use srflow_core::random::{Key, Stream};

use super::quintic;
use crate::{HeadModel, HeadPose, JointRole};

/// How far a deep breath lifts head and shoulders, metres, and tips the head back, radians.
const BREATH_METRES: f32 = 0.0012;
const BREATH_RADIANS: f32 = 0.004;
/// Share of a breath that goes in.
const INHALED: f32 = 0.42;

/// The nods and shakes of the head in a sequence.
#[derive(Debug, Clone, Default)]
pub struct Nods {
    nods: Vec<Nod>,
}

#[derive(Debug, Clone, Copy)]
struct Nod {
    start: f32,
    cycles: f32,
    hertz: f32,
    radians: f32,
    sideways: bool,
}

impl Nods {
    /// One every 4 to 12 seconds, of one to three cycles and up to 5 degrees; every fourth is a shake. 1.8 to 3.7 cycles a second are those
    /// of ordinary movements in conversation (Hadar, Steiner, Grant and Rose, Human Movement Science 2, 1983).
    pub fn random(key: Key, seconds: f32) -> Self {
        let mut stream = key.stream("nods");
        let mut nods = Vec::new();
        let mut start = stream.uniform(0.5, 6.0);
        while start < seconds {
            let nod = Nod {
                start,
                cycles: 1.0 + stream.below(3) as f32,
                hertz: stream.uniform(1.8, 3.7),
                radians: stream.uniform(1.5, 5.0).to_radians(),
                sideways: stream.below(4) == 0,
            };
            start = nod.end() + stream.uniform(4.0, 12.0);
            nods.push(nod);
        }
        Self { nods }
    }

    /// First and last second of every nod and shake, and its name.
    pub fn spans(&self) -> impl Iterator<Item = (&'static str, [f32; 2])> {
        let name = |nod: &Nod| if nod.sideways { "shake" } else { "nod" };
        self.nods.iter().map(move |nod| (name(nod), [nod.start, nod.end()]))
    }

    /// Yaw and pitch in radians: to the subject's left and up.
    pub fn at(&self, time: f32) -> [f32; 2] {
        let shown = self.nods.iter().find(|nod| (nod.start..nod.end()).contains(&time));
        shown.map_or([0.0; 2], |nod| nod.at(time))
    }
}

impl Nod {
    fn end(&self) -> f32 {
        self.start + self.cycles / self.hertz
    }

    fn at(&self, time: f32) -> [f32; 2] {
        let phase = TAU * self.hertz * (time - self.start);
        let done = (time - self.start) / (self.end() - self.start);
        if self.sideways {
            let envelope = libm::sinf(PI * done);
            [self.radians * envelope * libm::sinf(phase), 0.0]
        } else {
            // Each of several nods is smaller than the one before.
            let down = (1.0 - libm::cosf(phase)) / 2.0;
            [0.0, -self.radians * down * (1.0 - 0.5 * done)]
        }
    }
}

/// The breaths of a sequence.
#[derive(Debug, Clone, Default)]
pub struct Breathing {
    breaths: Vec<Breath>,
}

#[derive(Debug, Clone, Copy)]
struct Breath {
    start: f32,
    seconds: f32,
    depth: f32,
}

impl Breathing {
    /// 12 to 20 breaths a minute, as of adults at rest.
    pub fn random(key: Key, seconds: f32) -> Self {
        let mut stream = key.stream("breathing");
        let breath = |stream: &mut Stream, start| Breath {
            start,
            seconds: stream.uniform(3.0, 5.0),
            depth: stream.uniform(0.5, 1.0),
        };
        let mut breaths = Vec::new();
        // The first one has already begun.
        let mut start = -stream.uniform(0.0, 3.0);
        while start < seconds {
            let next = breath(&mut stream, start);
            start += next.seconds;
            breaths.push(next);
        }
        Self { breaths }
    }

    /// How full the chest is, `0..=1`.
    pub fn at(&self, time: f32) -> f32 {
        let next = self.breaths.partition_point(|breath| breath.start <= time);
        let Some(breath) = next.checked_sub(1).map(|last| self.breaths[last]) else { return 0.0 };
        let share = (time - breath.start) / breath.seconds;
        breath.depth * quintic(share / INHALED) * quintic((1.0 - share) / (1.0 - INHALED))
    }
}

/// Turns the head on its neck by yaw and pitch, and lifts it by a breath, `0..=1`.
pub fn move_by_gestures(pose: &mut HeadPose, model: &HeadModel, [yaw, pitch]: [f32; 2], breath: f32) {
    let turn = Quat::from_euler(EulerRot::YXZ, yaw, -(pitch + breath * BREATH_RADIANS), 0.0);
    // Without a neck, all of the head turns.
    *pose.joint_mut(model.joint(JointRole::Neck).unwrap_or(0)) *= turn;
    pose.translation += Vec3::Y * (breath * BREATH_METRES);
}
