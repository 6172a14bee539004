//! What a face does besides its expressions: blinks, glances, nods and breathing.

use srflow_core::random::Key;
use srflow_head::motion::{Blinks, Breathing, Gaze, Nods, move_by_gestures, pose_of_face};
use srflow_head::{HeadModel, HeadModelError, HeadPose, Side};

/// How strong each is: 0 is none.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Strengths {
    pub blinks: f32,
    pub glances: f32,
    pub nods: f32,
    pub breathing: f32,
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
        let Strengths { blinks, glances, nods, breathing } = self.strengths;
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
        let Strengths { blinks, glances, nods, .. } = self.strengths;
        let blinks = self.blinks.spans().filter(move |_| blinks > 0.0).map(|span| ("blink", span));
        let glances = self.gaze.shifts().filter(move |_| glances > 0.0).map(|span| ("glance", span));
        blinks.chain(glances).chain(self.nods.spans().filter(move |_| nods > 0.0))
    }
}
