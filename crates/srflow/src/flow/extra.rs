//! Outputs of some networks in addition to the flow.

use srflow_core::{FlowEstimate, Plane};
use srflow_nets::Architecture;

/// One number per pixel of the first frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ExtraOutput {
    Uncertainty,
    Occlusion,
}

impl ExtraOutput {
    pub const ALL: [Self; 2] = [Self::Uncertainty, Self::Occlusion];

    /// Name of the setting, and key in reports.
    pub fn name(self) -> &'static str {
        match self {
            Self::Uncertainty => "uncertainty",
            Self::Occlusion => "occlusion",
        }
    }

    pub fn help(self) -> String {
        let what = match self {
            Self::Uncertainty => "the expected error of each component of the flow in pixels",
            Self::Occlusion => "the probability that a pixel of the first frame is hidden in the second",
        };
        format!(
            "Also write {what}, as .npy of shape (H, W), a file or a folder like --out; with --viz also as PNG next to it; for {}",
            self.networks()
        )
    }

    pub fn is_predicted_by(self, network: Architecture) -> bool {
        match self {
            Self::Uncertainty => network.facts().mixture,
            Self::Occlusion => network.facts().occlusion,
        }
    }

    /// Names of the networks that predict it.
    fn networks(self) -> String {
        let names = Architecture::ALL.into_iter().filter(|network| self.is_predicted_by(*network));
        names.map(Architecture::name).collect::<Vec<_>>().join(", ")
    }

    /// Message for a method that does not predict it.
    pub fn missing(self, method: &str) -> String {
        format!("`{}`: {method} does not predict it; these networks do: {}", self.name(), self.networks())
    }

    pub fn of(self, estimate: &FlowEstimate) -> Option<&Plane> {
        match self {
            Self::Uncertainty => estimate.uncertainty.as_ref(),
            Self::Occlusion => estimate.occlusion.as_ref(),
        }
    }

    /// The value shown in the brightest colour.
    pub fn brightest(self, plane: &Plane, viz_max: Option<f32>) -> f32 {
        match self {
            Self::Uncertainty => {
                viz_max.unwrap_or_else(|| plane.pixels().iter().copied().fold(f32::MIN_POSITIVE, f32::max))
            }
            Self::Occlusion => 1.0,
        }
    }
}
