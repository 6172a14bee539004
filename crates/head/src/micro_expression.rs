//! Micro-expressions: brief, weak, involuntary.

use srflow_core::random::Key;

use crate::motion::{available_units, quintic};
use crate::{HeadModel, HeadModelError, HeadPose, Side};

/// One micro-expression: it rises from onset to apex and is gone at the offset.
#[derive(Debug, Clone, PartialEq)]
pub struct MicroExpression {
    /// Action units and their intensity at the apex, `0..=1`.
    pub action_units: Vec<(u8, Side, f32)>,
    /// Last frame at rest.
    pub onset: usize,
    /// Frame of the strongest expression.
    pub apex: usize,
    /// First frame at rest again.
    pub offset: usize,
}

impl MicroExpression {
    /// The micro-expression for `key`, starting at frame `onset` of a recording with `frames_per_second`. It shows one of the `sets`
    /// of action units that the model has completely.
    ///
    /// It takes 0.17 to 0.48 s, but at least two frames, so that onset, apex and offset differ.
    ///
    /// # Errors
    /// [`HeadModelError::NoActionUnit`] when the model has none of the sets completely.
    pub fn random(
        model: &HeadModel,
        sets: &[&[u8]],
        key: Key,
        onset: usize,
        frames_per_second: f32,
    ) -> Result<Self, HeadModelError> {
        let available = available_units(model);
        let has = |set: &&&[u8]| set.iter().all(|number| available.iter().any(|(n, _)| n == number));
        let shown: Vec<&[u8]> = sets.iter().filter(has).copied().collect();
        let mut stream = key.stream("micro-expression");
        let Some(set) = shown.get(stream.below(shown.len() as u32) as usize) else {
            let mut numbers: Vec<u8> = available.iter().map(|(n, _)| *n).collect();
            numbers.dedup();
            return Err(HeadModelError::NoActionUnit {
                model: model.name.clone(),
                number: sets.first().and_then(|set| set.first()).copied().unwrap_or_default(),
                side: Side::Both,
                available: numbers,
            });
        };
        let intensity = stream.uniform(0.12, 0.40);
        // Many micro-expressions are stronger on one side.
        let skew = stream.normal().clamp(-2.0, 2.0) * 0.2;
        let mut action_units = Vec::new();
        for &(number, side) in available.iter().filter(|(n, _)| set.contains(n)) {
            let lean = match side {
                Side::Both => 1.0,
                Side::Left => 1.0 + skew,
                Side::Right => 1.0 - skew,
            };
            action_units.push((number, side, intensity * lean));
        }
        let seconds = stream.uniform(0.17, 0.48);
        let length = ((seconds * frames_per_second.clamp(1.0, 1e5)) as usize).max(2);
        let rise = (length as f32 * stream.uniform(0.3, 0.5)) as usize;
        let apex = onset + rise.clamp(1, length - 1);
        Ok(Self { action_units, onset, apex, offset: onset + length })
    }

    /// Intensity at `frame`: 0 up to the onset and from the offset on, 1 at the apex.
    pub fn strength(&self, frame: usize) -> f32 {
        if frame <= self.onset || frame >= self.offset {
            0.0
        } else if frame <= self.apex {
            quintic((frame - self.onset) as f32 / (self.apex - self.onset).max(1) as f32)
        } else {
            quintic((self.offset - frame) as f32 / (self.offset - self.apex).max(1) as f32)
        }
    }

    /// Action units at `frame`; empty at rest.
    pub fn action_units_at(&self, frame: usize) -> Vec<(u8, Side, f32)> {
        let strength = self.strength(frame);
        let shown = self.action_units.iter().filter(|_| strength > 0.0);
        shown.map(|&(number, side, intensity)| (number, side, intensity * strength)).collect()
    }

    /// The head's pose at `frame`.
    ///
    /// # Errors
    /// [`HeadModelError::NoActionUnit`] when `model` lacks one of the units.
    pub fn pose(&self, model: &HeadModel, frame: usize) -> Result<HeadPose, HeadModelError> {
        model.pose_of_action_units(&self.action_units_at(frame))
    }
}
