//! How much memory a network takes.

use crate::{Architecture, MemoryNeed};

impl Architecture {
    /// Memory that estimating one pair takes on a CPU at its peak, beside parameters and the program itself: a bound from the
    /// largest tensors that are alive together and the blocks that the allocator keeps, not a fit. At 800x512 (width by
    /// height) 240 MB were measured for RAFT and 440 MB for GMA and SKFlow, half of the bound; `tools/bench/memory.py`
    /// measures more sizes. The number of iterations does not matter.
    pub fn memory_need(self) -> MemoryNeed {
        let (fixed_megabytes, per_pixel) = match self {
            Self::Raft => (250, 700),
            Self::RaftSmall => (200, 500),
            Self::Gma => (600, 700),
            Self::SkFlow => (600, 700),
        };
        MemoryNeed { fixed: fixed_megabytes * 1_000_000, per_pixel }
    }
}
