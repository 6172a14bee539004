//! What strips add to the gradients of their splats, and its order by Gaussians.

use srflow_simd::MAX_LANES;

use crate::ordering::Bins;

/// Gaussians in a chunk: the unit of work after the strips, whose sums stay in the cache.
pub(super) const CHUNK: usize = 1024;

/// Buffers of the backward, reused between calls.
#[derive(Debug, Default)]
pub(crate) struct Buffers {
    pub(super) strips: Vec<Strip>,
}

/// What one strip adds to the gradients of its splats.
#[derive(Debug, Default)]
pub(super) struct Strip {
    pub(super) tiles: Bins<u32>,
    /// Index in `entries` of each splat of the strip's list; [`NO_SLOT`] if it has none.
    pub(super) slots: Vec<u32>,
    pub(super) entries: Vec<Partial>,
    /// `entries`, sorted by chunk of Gaussians.
    pub(super) sorted: Vec<Partial>,
    /// Chunk `c` is `sorted[starts[c]..starts[c + 1]]`.
    pub(super) starts: Vec<usize>,
}

pub(super) const NO_SLOT: u32 = u32::MAX;

/// Sums over pixels of one splat, the size of a cache line.
#[derive(Debug, Clone, Copy)]
#[repr(C, align(64))]
pub(crate) struct Partial {
    pub(super) splat: u32,
    /// [`moment`]s, then the gradients of the features.
    pub(super) sums: [f32; MAX_LANES - 1],
}

/// Sums over pixels that a splat's shape and opacity need: the first entries of [`Partial::sums`]. With `v` the gradient of the
/// natural logarithm of alpha, and `e1` and `e2` as for [`Splat`](crate::projection::Splat).
pub(crate) mod moment {
    /// `v`.
    pub(crate) const V: usize = 0;
    /// `v e1`.
    pub(crate) const E1: usize = 1;
    /// `v e2`.
    pub(crate) const E2: usize = 2;
    /// `v e1^2`.
    pub(crate) const E11: usize = 3;
    /// `v e1 e2`.
    pub(crate) const E12: usize = 4;
    /// `v e2^2`.
    pub(crate) const E22: usize = 5;
    /// `-|v e1|`.
    pub(crate) const ABSOLUTE_X: usize = 6;
    /// `-|v (xy e1 + yy e2)|`.
    pub(crate) const ABSOLUTE_Y: usize = 7;
    /// Number of these sums; the gradients of the features follow.
    pub(crate) const COUNT: usize = 8;
}

impl Partial {
    #[inline(always)]
    pub(crate) fn add(&mut self, sums: &[f32; MAX_LANES]) {
        for (total, sum) in self.sums.iter_mut().zip(sums) {
            *total += sum;
        }
    }
}

/// Counting sort by chunk of Gaussians.
pub(super) fn sort_by_chunk(
    entries: &[Partial],
    chunks: usize,
    sorted: &mut Vec<Partial>,
    starts: &mut Vec<usize>,
) {
    // During the sort, `starts[c + 1]` is the place of the next entry of chunk `c`.
    starts.clear();
    starts.resize(chunks + 2, 0);
    for entry in entries {
        starts[entry.splat as usize / CHUNK + 2] += 1;
    }
    for chunk in 2..starts.len() {
        starts[chunk] += starts[chunk - 1];
    }
    sorted.clear();
    sorted.resize(entries.len(), Partial { splat: 0, sums: [0.0; MAX_LANES - 1] });
    for entry in entries {
        let start = &mut starts[entry.splat as usize / CHUNK + 1];
        sorted[*start] = *entry;
        *start += 1;
    }
}
