//! Arguments for a head avatar in a pose, in place of a file of Gaussians.

use std::fmt;
use std::str::FromStr;
use std::sync::Arc;

use crate::clap::Args;
use serde::{Deserialize, Serialize};
use srflow_avatar::{Avatar, HeadSource};
use srflow_core::random::Key;
use srflow_head::{HeadModel, HeadParameters, HeadPose, Look, Motion, PoseParameters, Side};
use srflow_render::generate::MotionSource;

use crate::error::wrong_settings;

/// The help of `--head`.
fn head_help() -> String {
    format!("Head, instead of a file of Gaussians: {}", HeadSource::help())
}

/// Length and rate of the random motion.
const FRAMES: usize = 240;
pub const FRAMES_PER_SECOND: f32 = 24.0;

/// A head avatar and its pose.
#[derive(Args, Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct HeadArgs {
    /// Head, instead of a file of Gaussians
    #[arg(long, value_name = "HEAD", help = head_help())]
    pub head: Option<HeadSource>,
    /// Motion of the head: `own` (the avatar's training motion), the flame_param.npz, capture or clip
    /// (FILE.glb@CLIP) of another subject with the same kind of head, or `curves` (10 s of random motion
    /// at 24 frames per second)
    /// [default: own if it has one, else curves]
    #[arg(long, value_name = "MOTION", requires = "head")]
    pub motion: Option<MotionSource>,
    /// Timestep of the motion in this frame, from 0
    #[arg(long, value_name = "N", requires = "head")]
    pub timestep: Option<usize>,
    /// Action units in place of a motion, 0 to 1 each, such as 6=0.5,12_L=1
    #[arg(long, value_name = "UNITS", requires = "head", conflicts_with_all = ["motion", "timestep"])]
    pub action_units: Option<ActionUnits>,
    /// Seed of the person and of the random motion, for built-in heads
    #[arg(long, value_name = "N", requires = "head", default_value_t = Self::default().seed)]
    pub seed: u64,
}

impl Default for HeadArgs {
    fn default() -> Self {
        Self { head: None, motion: None, timestep: None, action_units: None, seed: 1 }
    }
}

/// Numbers, sides and intensities.
#[derive(Debug, Clone, PartialEq)]
pub struct ActionUnits(Vec<(u8, Side, f32)>);

impl fmt::Display for ActionUnits {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        for (place, (number, side, intensity)) in self.0.iter().enumerate() {
            let comma = if place == 0 { "" } else { "," };
            let side = match side {
                Side::Both => "",
                Side::Left => "_L",
                Side::Right => "_R",
            };
            write!(f, "{comma}{number}{side}={intensity}")?;
        }
        Ok(())
    }
}

srflow_core::serialize_as_text!(ActionUnits);

impl FromStr for ActionUnits {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let unit = |text: &str| {
            let (name, intensity) = text.trim().split_once('=')?;
            let name = name.strip_prefix("AU").unwrap_or(name);
            let (number, side) = match name.split_once('_') {
                None => (name, Side::Both),
                Some((number, "L")) => (number, Side::Left),
                Some((number, "R")) => (number, Side::Right),
                Some(_) => return None,
            };
            let intensity = intensity.parse().ok().filter(|intensity| (0.0..=1.0).contains(intensity))?;
            Some((number.parse().ok()?, side, intensity))
        };
        let units: Option<Vec<_>> = text.split(',').map(unit).collect();
        units.map(Self).ok_or_else(|| {
            format!("`{text}`: expected action units and their intensities from 0 to 1, such as 6=0.5,12_L=1")
        })
    }
}

impl ActionUnits {
    /// The pose of a head that is in no motion.
    ///
    /// # Errors
    /// When the model lacks one.
    pub fn pose(&self, model: &HeadModel) -> anyhow::Result<HeadPose> {
        Ok(model.pose_of_action_units(&self.0)?)
    }
}

/// An avatar that was read or made, and what moves it.
pub struct MovingHead {
    pub avatar: Arc<Avatar>,
    /// `None` for random motion.
    recorded: Option<Vec<PoseParameters>>,
    seed: u64,
}

impl HeadArgs {
    /// Reads or makes the head; `None` without `--head`.
    ///
    /// # Errors
    /// When the head or the motion cannot be read, or do not fit.
    pub fn open(&self) -> anyhow::Result<Option<MovingHead>> {
        let Some(head) = &self.head else { return Ok(None) };
        MovingHead::open(head, self.motion.as_ref(), self.seed).map(Some)
    }

    /// The pose of this frame.
    ///
    /// # Errors
    /// When the motion has no such timestep, or the head no such action unit.
    pub fn pose(&self, head: &MovingHead) -> anyhow::Result<HeadPose> {
        match &self.action_units {
            Some(units) => units.pose(head.avatar.model()),
            None => head.pose("timestep", self.first_timestep()),
        }
    }

    /// The pose of this frame before one of action units: at rest unless it has some itself.
    ///
    /// # Errors
    /// When the head has no such action unit.
    pub fn pose_or_rest(&self, head: &MovingHead) -> anyhow::Result<HeadPose> {
        let units = self.action_units.as_ref().map_or(&[][..], |units| &units.0);
        Ok(head.avatar.model().pose_of_action_units(units)?)
    }

    /// The timestep of this frame.
    pub fn first_timestep(&self) -> usize {
        self.timestep.unwrap_or(0)
    }
}

impl MovingHead {
    /// Reads or makes a head, and what moves it: its own motion if it has one and no other is given, else a random one.
    ///
    /// # Errors
    /// When the head or the motion cannot be read, or do not fit.
    pub fn open(head: &HeadSource, motion: Option<&MotionSource>, seed: u64) -> anyhow::Result<Self> {
        // Before the head, which takes longer to make.
        let recorded = motion.map_or(Ok(None), MotionSource::read)?;
        Self::of(Arc::new(head.avatar(seed)?), motion, recorded, seed)
    }

    /// A head that was made before, with its own motion or a random one.
    ///
    /// # Errors
    /// When its own motion does not fit.
    pub fn made(avatar: Arc<Avatar>, seed: u64) -> anyhow::Result<Self> {
        Self::of(avatar, None, None, seed)
    }

    /// `recorded` is what was read of `motion`.
    fn of(
        avatar: Arc<Avatar>,
        motion: Option<&MotionSource>,
        recorded: Option<HeadParameters>,
        seed: u64,
    ) -> anyhow::Result<Self> {
        let default = if avatar.own_motion().is_empty() { MotionSource::Curves } else { MotionSource::Own };
        let source = motion.unwrap_or(&default);
        if *source == MotionSource::Mixed {
            wrong_settings!(
                "`motion` mixed: expected own, curves or a file; mixed is a motion of `srflow render`"
            );
        }
        let recorded = source.poses_of(recorded, &avatar)?;
        Ok(Self { avatar, recorded, seed })
    }

    /// The poses at all timesteps.
    pub fn poses(&self) -> Vec<HeadPose> {
        let model = self.avatar.model();
        match &self.recorded {
            Some(recorded) => recorded.iter().map(|pose| pose.pose(model)).collect(),
            None => {
                let motion = self.random_motion();
                (0..FRAMES).map(|timestep| motion.at(model, timestep).pose).collect()
            }
        }
    }

    /// The pose at a timestep, which the setting `field` gave.
    ///
    /// # Errors
    /// When the motion has no such timestep.
    pub fn pose(&self, field: &str, timestep: usize) -> anyhow::Result<HeadPose> {
        let (model, timesteps) = (self.avatar.model(), self.timesteps());
        let recorded = self.recorded.as_ref().map(|recorded| recorded.get(timestep));
        match recorded {
            Some(Some(recorded)) => Ok(recorded.pose(model)),
            None if timestep < FRAMES => Ok(self.random_motion().at(model, timestep).pose),
            _ => wrong_settings!(
                "`{field}` {timestep}: the motion has timesteps 0 to {}",
                timesteps.saturating_sub(1)
            ),
        }
    }

    fn random_motion(&self) -> Motion {
        Motion::new(self.avatar.model(), Look::default(), Key::new(self.seed), FRAMES, FRAMES_PER_SECOND)
    }

    /// Length of the motion.
    pub fn timesteps(&self) -> usize {
        self.recorded.as_ref().map_or(FRAMES, Vec::len)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn action_units_have_numbers_sides_and_intensities() {
        let units: ActionUnits = "6=0.5, AU12_L=1".parse().unwrap();
        assert_eq!(units, ActionUnits(vec![(6, Side::Both, 0.5), (12, Side::Left, 1.0)]));
        for text in ["", "6", "6=2", "6=nan", "6_X=1", "x=1"] {
            assert!(text.parse::<ActionUnits>().is_err(), "{text}");
        }
    }
}
