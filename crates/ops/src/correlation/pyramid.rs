use std::borrow::Cow;

use rayon::prelude::*;

/// Feature maps of the second image; each level is half the size of the previous one (average of 2x2, an odd last row or column
/// is dropped). The channels of a pixel are adjacent.
#[derive(Debug, Clone)]
pub struct FeaturePyramid<'a> {
    pub batch: usize,
    pub channels: usize,
    pub(super) levels: Vec<Level<'a>>,
}

/// `[batch, height, width, channels]`.
#[derive(Debug, Clone)]
pub(super) struct Level<'a> {
    pub(super) height: usize,
    pub(super) width: usize,
    pub(super) features: Cow<'a, [f32]>,
}

impl<'a> FeaturePyramid<'a> {
    /// From `[batch, channels, height, width]`. Panics when the length of the slice does not match, or there is no level.
    pub fn new(features: &[f32], [batch, channels, height, width]: [usize; 4], levels: usize) -> Self {
        assert_eq!(
            features.len(),
            batch * channels * height * width,
            "features of {batch}x{channels}x{height}x{width}"
        );
        assert!(levels > 0, "a pyramid has a level");
        let first = Level { height, width, features: Cow::Owned(channels_last(features, batch, channels)) };
        let mut pyramid = Self { batch, channels, levels: vec![first] };
        while pyramid.levels.len() < levels {
            let last = &pyramid.levels[pyramid.levels.len() - 1];
            let pooled = last.pooled(batch, channels);
            pyramid.levels.push(pooled);
        }
        pyramid
    }

    /// From levels one after another in `packed`, each `[batch, height, width, channels]`; see [`level_sizes`].
    pub(super) fn of_packed(
        packed: &'a [f32],
        [batch, height, width, channels]: [usize; 4],
        levels: usize,
    ) -> Self {
        let mut rest = packed;
        let levels = level_sizes([height, width], levels)
            .into_iter()
            .map(|[height, width]| {
                let (features, after) = rest.split_at(batch * height * width * channels);
                rest = after;
                Level { height, width, features: Cow::Borrowed(features) }
            })
            .collect();
        Self { batch, channels, levels }
    }

    /// The adjoint of [`FeaturePyramid::new`]: the gradient of the feature map, `[batch, channels, height, width]`, given that of
    /// every level's features.
    pub fn backward(&self, mut grads: Vec<Vec<f32>>) -> Vec<f32> {
        while grads.len() > 1 {
            let Some(coarse) = grads.pop() else { break };
            let level = grads.len();
            self.levels[level].unpool(&coarse, &self.levels[level - 1], self.channels, &mut grads[level - 1]);
        }
        channels_first(&grads.swap_remove(0), self.batch, self.channels)
    }
}

/// Height and width of each level for a map of this size; 0 once nothing is left.
pub(super) fn level_sizes(finest: [usize; 2], levels: usize) -> Vec<[usize; 2]> {
    (0..levels).map(|level| finest.map(|size| size.checked_shr(level as u32).unwrap_or(0))).collect()
}

impl Level<'_> {
    fn pooled(&self, batch: usize, channels: usize) -> Level<'static> {
        let (height, width) = (self.height / 2, self.width / 2);
        let mut features = vec![0.0; batch * height * width * channels];
        let row = (width * channels).max(1);
        features.par_chunks_mut(row).enumerate().for_each(|(i, to)| {
            let (n, y) = (i / height, i % height);
            let source = |dy: usize, x: usize| ((n * self.height + 2 * y + dy) * self.width + x) * channels;
            for (x, to) in to.chunks_exact_mut(channels).enumerate() {
                let [a, b] =
                    [source(0, 2 * x), source(1, 2 * x)].map(|at| &self.features[at..at + 2 * channels]);
                for (c, to) in to.iter_mut().enumerate() {
                    *to = 0.25 * (a[c] + a[c + channels] + b[c] + b[c + channels]);
                }
            }
        });
        Level { height, width, features: Cow::Owned(features) }
    }

    /// Adds the gradient `coarse` of this level to that of the `fine` level below it.
    fn unpool(&self, coarse: &[f32], fine: &Level, channels: usize, to: &mut [f32]) {
        let row = (fine.width * channels).max(1);
        to.par_chunks_mut(row).enumerate().for_each(|(i, to)| {
            let (n, y) = (i / fine.height, i % fine.height / 2);
            if y >= self.height {
                return;
            }
            for (x, to) in to.chunks_exact_mut(channels).take(2 * self.width).enumerate() {
                let at = ((n * self.height + y) * self.width + x / 2) * channels;
                for (to, from) in to.iter_mut().zip(&coarse[at..at + channels]) {
                    *to += 0.25 * from;
                }
            }
        });
    }
}

/// `[batch, channels, pixels]` to `[batch, pixels, channels]`.
pub(super) fn channels_last(features: &[f32], batch: usize, channels: usize) -> Vec<f32> {
    transpose(features, batch, channels)
}

/// `[batch, pixels, channels]` to `[batch, channels, pixels]`.
pub(super) fn channels_first(features: &[f32], batch: usize, channels: usize) -> Vec<f32> {
    let pixels = features.len() / (batch * channels).max(1);
    transpose(features, batch, pixels)
}

/// Transposes `[batch, rows, columns]` to `[batch, columns, rows]`, in blocks that fit in the first-level cache.
fn transpose(from: &[f32], batch: usize, rows: usize) -> Vec<f32> {
    const BLOCK: usize = 16;
    let mut to = vec![0.0; from.len()];
    let columns = from.len() / (batch * rows).max(1);
    if to.is_empty() {
        return to;
    }
    for (to, from) in to.chunks_exact_mut(rows * columns).zip(from.chunks_exact(rows * columns)) {
        to.par_chunks_mut(BLOCK * rows).enumerate().for_each(|(block, to)| {
            let first = block * BLOCK;
            for start in (0..rows).step_by(BLOCK) {
                for (i, to) in to.chunks_exact_mut(rows).enumerate() {
                    for row in start..rows.min(start + BLOCK) {
                        to[row] = from[row * columns + first + i];
                    }
                }
            }
        });
    }
    to
}
