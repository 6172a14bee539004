//! What a face does besides its expressions: blinks, glances, nods and breathing.

use serde::{Deserialize, Serialize};
use srflow_core::random::Key;
use srflow_head::motion::{Blinks, Breathing, Gaze, Nods, move_by_gestures, pose_of_face};
use srflow_head::{HeadModel, HeadModelError, HeadPose, Side};

use crate::clap::Args;
use crate::error::is_none;

/// Gestures of the head. Strengths are factors: 0 is none.
#[derive(Args, Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct Gestures {
    /// Strength of nods and shakes of the head, 0 to 2; 1 is up to 5 degrees, every 4 to 12 seconds
    #[arg(long, value_name = "FACTOR", default_value_t = Self::default().nods)]
    #[serde(skip_serializing_if = "is_none")]
    pub nods: f32,
    /// Strength of breathing, 0 to 2; 1 lifts the head by up to 1.2 mm, 12 to 20 times a minute
    #[arg(long, value_name = "FACTOR", default_value_t = Self::default().breathing)]
    #[serde(skip_serializing_if = "is_none")]
    pub breathing: f32,
}

/// How strong each is: 0 is none.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Strengths {
    pub blinks: f32,
    pub glances: f32,
    pub gestures: Gestures,
}

/// The distractors of one video.
pub(crate) struct Distractors {
    blinks: Blinks,
    gaze: Gaze,
    nods: Nods,
    breathing: Breathing,
    strengths: Strengths,
}

impl Distractors {
    pub fn random(key: Key, seconds: f32, strengths: Strengths) -> Self {
        Self {
            blinks: Blinks::random(key, seconds),
            gaze: Gaze::random(key, seconds),
            nods: Nods::random(key, seconds),
            breathing: Breathing::random(key, seconds),
            strengths,
        }
    }

    /// The pose at a second of a face that shows `units` meanwhile.
    pub fn pose(
        &self,
        model: &HeadModel,
        mut units: Vec<(u8, Side, f32)>,
        second: f32,
    ) -> Result<HeadPose, HeadModelError> {
        let Strengths { blinks, glances, gestures: Gestures { nods, breathing } } = self.strengths;
        let gaze = self.gaze.at(second).map(|angle| angle * glances);
        let mut pose = pose_of_face(model, &mut units, self.blinks.closed_at(second) * blinks, gaze)?;
        if nods > 0.0 || breathing > 0.0 {
            let nod = self.nods.at(second).map(|angle| angle * nods);
            move_by_gestures(&mut pose, model, nod, self.breathing.at(second) * breathing);
        }
        Ok(pose)
    }

    /// Name, first and last second of every blink, glance, nod and shake.
    pub fn spans(&self) -> impl Iterator<Item = (&'static str, [f32; 2])> {
        let Strengths { blinks, glances, gestures: Gestures { nods, .. } } = self.strengths;
        let blinks = self.blinks.spans().filter(move |_| blinks > 0.0).map(|span| ("blink", span));
        let glances = self.gaze.shifts().filter(move |_| glances > 0.0).map(|span| ("glance", span));
        blinks.chain(glances).chain(self.nods.spans().filter(move |_| nods > 0.0))
    }
}
