//! How much memory a network takes.

use crate::{Architecture, MemoryNeed};

impl Architecture {
    /// Memory that estimating one pair takes on a CPU at its peak, beside parameters and the program itself, with a tenth
    /// to spare. Measured as the peak of the process at several sizes, by `tools/bench/memory.py`; it does not depend on the
    /// number of iterations.
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
