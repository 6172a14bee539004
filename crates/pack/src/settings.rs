use serde::{Deserialize, Serialize};
use srflow_core::{FlowField, named, serialize_as_text};
use srflow_files::{FileProblem, FlowFormat, encode_flow, encode_flow_half};

use crate::clap::Args;
use crate::tar_size::TarSize;

/// How flow is packed.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum PackedFlow {
    /// `.npy` of float16: half the size of float32; see [`encode_flow_half`] for its error.
    Npy,
    /// `.npy` of float32.
    Npy32,
    /// KITTI's 16-bit PNG.
    Png,
    /// The format of SRFlow datasets, which `srflow` and NumPy read, and others take for bytes.
    Npz16,
}

named!(PackedFlow, "a format of packed flow", {
    Npy => "npy",
    Npy32 => "npy32",
    Png => "png",
    Npz16 => "npz16",
});

serialize_as_text!(PackedFlow);

impl PackedFlow {
    /// The file extension.
    pub(crate) fn extension(self) -> &'static str {
        match self {
            Self::Npy | Self::Npy32 => "npy",
            Self::Png => "png",
            Self::Npz16 => "npz16",
        }
    }

    /// Its description in a dataset card.
    pub(crate) fn about(self) -> &'static str {
        match self {
            Self::Npy => "NumPy array of float16, NaN where unknown",
            Self::Npy32 => "NumPy array of float32, NaN where unknown",
            Self::Png => "KITTI's 16-bit PNG: `(value - 32768) / 64`, blue is 0 where unknown",
            Self::Npz16 => {
                "NumPy archive of steps of 1/256 px, as srflow's docs/reference/dataset-format.md describes it"
            }
        }
    }

    /// The format of files that have the same bytes.
    pub(crate) fn format(self) -> Option<FlowFormat> {
        match self {
            // A `.npy` file of a dataset may have any type of number.
            Self::Npy | Self::Npy32 => None,
            Self::Png => Some(FlowFormat::KittiPng),
            Self::Npz16 => Some(FlowFormat::Npz16),
        }
    }

    pub(crate) fn encode(self, flow: &FlowField) -> Result<Vec<u8>, FileProblem> {
        match self {
            Self::Npy => encode_flow_half(flow),
            Self::Npy32 => encode_flow(flow, FlowFormat::Npy),
            Self::Png => encode_flow(flow, FlowFormat::KittiPng),
            Self::Npz16 => encode_flow(flow, FlowFormat::Npz16),
        }
    }
}

/// The settings that determine the bytes of a packed dataset.
#[derive(Args, Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default)]
pub struct PackSettings {
    /// Flow: npy (float16), npy32 (float32), png (KITTI's 16-bit PNG) or npz16 (as `srflow render` writes it)
    #[arg(long, value_name = "FORMAT", default_value_t = Self::default().flow)]
    pub flow: PackedFlow,
    /// Approximate size of a tar: bytes, or with kB, MB or GB
    #[arg(long, value_name = "SIZE", default_value_t = Self::default().shard_size)]
    pub shard_size: TarSize,
}

impl Default for PackSettings {
    fn default() -> Self {
        Self { flow: PackedFlow::Npy, shard_size: TarSize { bytes: 1_000_000_000 } }
    }
}
