//! How much memory a network takes.

use crate::{Architecture, MemoryNeed};

impl Architecture {
    /// Memory that estimating one pair takes on a CPU at its peak, beside parameters and the program itself: a bound set by
    /// hand, not a fit. Whole processes took 0.34 GB (RAFT), 0.53 GB (GMA) and 0.51 GB (SKFlow) at 800x512, and 0.77 GB (RAFT)
    /// and 1.88 GB (GMA) at 1600x1200. The number of iterations does not matter.
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
