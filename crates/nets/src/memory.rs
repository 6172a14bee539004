//! Memory needs of the networks.

use crate::blocks::KEPT_BYTES;
use crate::{Architecture, MemoryNeed};

impl Architecture {
    /// Memory that estimating one pair takes on a CPU at its peak, beside parameters and the program itself (100 MB).
    ///
    /// A straight line over the pixels, and for GMA and SKFlow the attention's weights besides, laid above the peaks of whole
    /// processes at 320x256 to 3840x2160 that `tools/bench/memory.py` measured on two threads (`docs/benchmarks.md` lists
    /// them). From 1024x768 on it is 0.4 to 32 % above these, for smaller frames up to 350 MB. The number of iterations does
    /// not matter.
    pub fn memory_need(self) -> MemoryNeed {
        let (fixed_megabytes, per_pixel, attending) = match self {
            Self::Raft => (235, 340, 0),
            Self::RaftSmall => (125, 235, 0),
            Self::Gma | Self::SkFlow => (370, 275, 1),
        };
        let fixed = fixed_megabytes * 1_000_000;
        MemoryNeed { fixed, per_pixel, attending, most_weights: KEPT_BYTES as u64 }
    }
}
