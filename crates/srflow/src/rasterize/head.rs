//! Settings of a head avatar instead of a file of Gaussians, in this frame and the next.

use serde::{Deserialize, Serialize};
use srflow_avatar::PosedHead;
use srflow_head::HeadPose;
use srflow_splat::Gaussians;

use crate::clap::Args;
use crate::posed_head::{ActionUnits, HeadArgs};

/// A head avatar, and its poses in this frame and the next.
#[derive(Args, Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct TwoPoses {
    #[command(flatten)]
    #[serde(flatten)]
    pub first: HeadArgs,
    /// Timestep of the motion in the next frame
    #[arg(long, value_name = "N", requires = "head", conflicts_with_all = ["next", "orbit", "path", "action_units"])]
    pub timestep_next: Option<usize>,
    /// Action units in the next frame
    #[arg(long, value_name = "UNITS", requires = "head", conflicts_with_all = ["motion", "timestep", "timestep_next", "next", "orbit", "path"])]
    pub action_units_next: Option<ActionUnits>,
}

impl TwoPoses {
    /// The Gaussians of this frame and, where it was asked for, of the next; `None` without a head.
    ///
    /// # Errors
    /// When the head or the motion cannot be read, or has no such timestep or action unit.
    pub fn gaussians(&self) -> anyhow::Result<Option<(Gaussians, Option<Gaussians>)>> {
        let Some(head) = self.first.open()? else { return Ok(None) };
        let model = head.avatar.model();
        let (first, next) = match (&self.action_units_next, self.timestep_next) {
            (Some(units), _) => (self.first.pose_or_rest(&head)?, Some(units.pose(model)?)),
            (None, Some(timestep)) => (self.first.pose(&head)?, Some(head.pose("timestep_next", timestep)?)),
            (None, None) => (self.first.pose(&head)?, None),
        };
        let mut buffers = PosedHead::default();
        let mut posed = |pose: &HeadPose| {
            let mut gaussians = Gaussians::default();
            head.avatar.gaussians_into(pose, &mut buffers, &mut gaussians);
            gaussians
        };
        Ok(Some((posed(&first), next.as_ref().map(posed))))
    }
}
