//! Arguments for a head avatar in place of a file of Gaussians.

use std::str::FromStr;

use clap::Args;
use srflow_avatar::{Avatar, HeadParameters, HeadPose, HeadSource, Motion, PosedHead, Side};
use srflow_field::random::Key;
use srflow_render::generate::MotionSource;
use srflow_splat::Gaussians;

use crate::usage::wrong_usage;

/// The help of `--head`.
fn head_help() -> String {
    format!("Head in place of PLY: {}", HeadSource::help())
}

/// Length and rate of the random motion.
const FRAMES: usize = 240;
const FRAMES_PER_SECOND: f32 = 24.0;

/// A head avatar, and its poses in this frame and the next.
#[derive(Args)]
pub struct HeadArgs {
    /// Head in place of PLY
    #[arg(long, value_name = "HEAD", help = head_help())]
    pub head: Option<HeadSource>,
    /// Motion of the head: `own` (the one that an avatar was trained on), a flame_param.npz or capture of another subject with the
    /// same kind of head, or `curves` (10 s of random motion at 24 frames per second) [default: own if it has one, else curves]
    #[arg(long, value_name = "MOTION", requires = "head")]
    motion: Option<MotionSource>,
    /// Timestep of the motion in this frame, from 0
    #[arg(long, value_name = "N", requires = "head")]
    timestep: Option<usize>,
    /// Timestep of the motion in the next frame
    #[arg(long, value_name = "N", requires = "head", conflicts_with_all = ["next", "orbit", "path"])]
    timestep_next: Option<usize>,
    /// Action units in place of a motion, 0 to 1 each, such as 6=0.5,12_L=1
    #[arg(long, value_name = "UNITS", requires = "head", conflicts_with_all = ["motion", "timestep", "timestep_next"])]
    action_units: Option<ActionUnits>,
    /// Action units in the next frame
    #[arg(long, value_name = "UNITS", requires = "head", conflicts_with_all = ["motion", "timestep", "timestep_next", "next", "orbit", "path"])]
    action_units_next: Option<ActionUnits>,
    /// Seed of the person and of the random motion, for heads that are made from one
    #[arg(long, value_name = "N", requires = "head", default_value_t = 1)]
    seed: u64,
}

/// Numbers, sides and intensities.
#[derive(Debug, Clone, PartialEq)]
pub struct ActionUnits(Vec<(u8, Side, f32)>);

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

impl HeadArgs {
    /// The Gaussians of this frame and, where it was asked for, of the next; `None` without `--head`.
    ///
    /// # Errors
    /// When the head or the motion cannot be read, or has no such timestep or action unit.
    pub fn gaussians(&self) -> anyhow::Result<Option<(Gaussians, Option<Gaussians>)>> {
        let Some(head) = &self.head else { return Ok(None) };
        // Before the head, which takes longer to make.
        let recorded = self.motion.as_ref().map_or(Ok(None), MotionSource::read)?;
        let avatar = head.avatar(self.seed)?;
        let (first, next) = self.poses(&avatar, recorded)?;
        let mut buffers = PosedHead::default();
        let mut posed = |pose: &HeadPose| {
            let mut gaussians = Gaussians::default();
            avatar.gaussians_into(pose, &mut buffers, &mut gaussians);
            gaussians
        };
        Ok(Some((posed(&first), next.as_ref().map(posed))))
    }

    fn poses(
        &self,
        avatar: &Avatar,
        recorded: Option<HeadParameters>,
    ) -> anyhow::Result<(HeadPose, Option<HeadPose>)> {
        let model = avatar.model();
        if self.action_units.is_some() || self.action_units_next.is_some() {
            let pose = |units: &Option<ActionUnits>| {
                model.pose_of_action_units(units.as_ref().map_or(&[], |units| &units.0))
            };
            let next = self.action_units_next.is_some().then(|| pose(&self.action_units_next)).transpose()?;
            return Ok((pose(&self.action_units)?, next));
        }
        let default = if avatar.own_motion().is_empty() { MotionSource::Curves } else { MotionSource::Own };
        let source = self.motion.as_ref().unwrap_or(&default);
        if *source == MotionSource::Mixed {
            wrong_usage!(
                "--motion mixed: expected own, curves or a file; mixed is a motion of `srflow render`"
            );
        }
        let recorded = match source.poses_of(recorded, avatar) {
            Err(error @ srflow_render::RenderError::Argument { .. }) => wrong_usage!("{error}"),
            poses => poses?,
        };
        let motion = Motion::new(model, Key::new(self.seed), FRAMES, FRAMES_PER_SECOND);
        let timesteps = recorded.as_ref().map_or(FRAMES, Vec::len);
        let pose = |option: &str, timestep: usize| {
            if timestep >= timesteps {
                wrong_usage!("{option} {timestep}: the motion has timesteps 0 to {}", timesteps - 1);
            }
            anyhow::Ok(match &recorded {
                Some(recorded) => recorded[timestep].pose(model),
                None => motion.at(model, timestep).pose,
            })
        };
        let first = pose("--timestep", self.timestep.unwrap_or(0))?;
        Ok((first, self.timestep_next.map(|timestep| pose("--timestep-next", timestep)).transpose()?))
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
