//! The inner loop: blends splats front to back into one tile, one row of sixteen pixels (one or two vectors) at a time.

use srflow_simd::{Simd, exp2};

use crate::projection::{LOG2_ALPHA_MIN, Splat, TILE};
use crate::reference::{ALPHA_MAX, TRANSMITTANCE_MIN};

/// Sixteen numbers, aligned for whole-vector access.
#[derive(Debug, Clone, Copy, PartialEq)]
#[repr(C, align(64))]
pub(crate) struct Row(pub [f32; TILE]);

impl Row {
    pub(crate) const ZERO: Self = Self([0.0; TILE]);

    /// Transmittance in front of every splat, for a row whose first `width` columns are inside the image.
    #[inline(always)]
    pub(crate) fn transparent(width: usize) -> Self {
        Self(std::array::from_fn(|column| if column < width { 1.0 } else { -1.0 }))
    }
}

/// `0, 1, ... 15`.
const INDEX: Row = Row([0., 1., 2., 3., 4., 5., 6., 7., 8., 9., 10., 11., 12., 13., 14., 15.]);

/// Maximum number of vectors in a row.
pub(crate) const MAX_VECTORS: usize = 2;

/// Prefetch distance in splats.
pub(crate) const PREFETCH: usize = 6;

/// The accumulators of one tile; `CHANNELS` of [`Splat::features`] are blended.
pub(crate) struct Tile<const CHANNELS: usize> {
    pub rows: [TileRow<CHANNELS>; TILE],
}

#[derive(Clone, Copy)]
pub(crate) struct TileRow<const CHANNELS: usize> {
    /// Transmittance; negated once the pixel is done, or if it is outside the image.
    pub transmittance: Row,
    /// Weighted sums of the features.
    pub sums: [Row; CHANNELS],
}

impl<const CHANNELS: usize> Tile<CHANNELS> {
    /// A tile whose first `width` columns are inside the image.
    #[inline(always)]
    pub(crate) fn new(width: usize) -> Self {
        let transmittance = Row::transparent(width);
        Self { rows: [TileRow { transmittance, sums: [Row::ZERO; CHANNELS] }; TILE] }
    }

    /// Blends the splats of `list`, front to back, into the first `height` rows of the tile at pixel `(left, top)`.
    /// Returns the number of blended (splat, pixel) pairs.
    #[inline(always)]
    pub(crate) fn blend(
        &mut self,
        s: impl Simd,
        splats: &[Splat],
        list: &[u32],
        (left, top): (usize, usize),
        height: usize,
    ) -> u64 {
        let mut blended = 0;
        // Bit i: row i has a pixel that is not done.
        let mut live = rows_inside(height);
        for (i, &index) in list.iter().enumerate() {
            if let Some(&ahead) = list.get(i + PREFETCH) {
                s.prefetch(&splats[ahead as usize]);
            }
            let splat = &splats[index as usize];
            let (stripes, touched) = Stripes::new(s, splat, left, top);
            let features: [_; CHANNELS] = std::array::from_fn(|channel| s.splat(splat.features[channel]));
            let mut rows = touched & live;
            while rows != 0 {
                let row = rows.trailing_zeros() as usize % TILE;
                rows &= rows - 1;
                let (count, done) = self.rows[row].blend(s, &features, &stripes, row);
                blended += u64::from(count);
                live &= !(u16::from(done) << row);
            }
            if live == 0 {
                break;
            }
        }
        blended
    }
}

/// The first `height` rows, as bits.
#[inline(always)]
pub(crate) fn rows_inside(height: usize) -> u16 {
    if height >= TILE { u16::MAX } else { (1 << height) - 1 }
}

/// A splat's alpha along the rows of a tile: at column `x` of row `i` it is `2^(peaks[i] - e1^2)`, where `e1` is
/// `slope[x] + shear[i]`; see [`Splat`].
pub(crate) struct Stripes<V> {
    slope: [V; MAX_VECTORS],
    shear: Row,
    /// `e2` of each row.
    pub e2: Row,
    peaks: Row,
}

impl<V: Copy> Stripes<V> {
    /// The ridge in the tile at pixel `(left, top)`, and the rows (as bits) in which alpha may reach 1/255.
    #[inline(always)]
    pub(crate) fn new<S: Simd<Vector = V>>(s: S, splat: &Splat, left: usize, top: usize) -> (Self, u16) {
        let [xx, xy, yy] = splat.factor;
        let dx = (left as f64 - splat.center[0]) as f32;
        let dy = s.splat((top as f64 - splat.center[1]) as f32);
        let slope = [s.splat(0.0); MAX_VECTORS];
        let mut stripes = Self { slope, shear: Row::ZERO, e2: Row::ZERO, peaks: Row::ZERO };
        let mut touched = 0;
        for vector in 0..TILE / S::LANES {
            let at = vector * S::LANES;
            let index = s.read(&INDEX.0[at..]);
            stripes.slope[vector] = s.mul(s.add(s.splat(dx), index), s.splat(xx));
            let dy = s.add(dy, index);
            let shear = s.mul(dy, s.splat(xy));
            let e2 = s.mul(dy, s.splat(yy));
            let peaks = s.neg_mul_add(e2, e2, s.splat(splat.log2_opacity));
            // The column nearest to the ridge, clamped to the tile: the same operations as for the pixels, so that rounding
            // cannot make a difference.
            let first = s.add(s.splat(dx * xx), shear);
            let last = s.add(s.splat((dx + (TILE - 1) as f32) * xx), shear);
            let nearest = s.max(s.max(first, s.sub(s.splat(0.0), last)), s.splat(0.0));
            let best = s.neg_mul_add(nearest, nearest, peaks);
            touched |= s.bits(s.at_least(best, s.splat(LOG2_ALPHA_MIN))) << at;
            s.write(shear, &mut stripes.shear.0[at..]);
            s.write(e2, &mut stripes.e2.0[at..]);
            s.write(peaks, &mut stripes.peaks.0[at..]);
        }
        (stripes, touched)
    }

    /// `e1` of one vector of pixels of a row.
    #[inline(always)]
    pub(crate) fn e1<S: Simd<Vector = V>>(&self, s: S, vector: usize, row: usize) -> V {
        s.add(self.slope[vector], s.splat(self.shear.0[row]))
    }

    /// One vector of pixels of a row: where the splat reaches them, and its alpha there.
    #[inline(always)]
    pub(crate) fn alpha<S: Simd<Vector = V>>(&self, s: S, vector: usize, row: usize) -> (S::Mask, V) {
        let e1 = self.e1(s, vector, row);
        let log2_alpha = s.neg_mul_add(e1, e1, s.splat(self.peaks.0[row]));
        let hit = s.at_least(log2_alpha, s.splat(LOG2_ALPHA_MIN));
        // Misses are not used, but must stay in the range of exp2.
        let alpha = exp2(s, s.max(log2_alpha, s.splat(-10.0)));
        (hit, s.min(alpha, s.splat(ALPHA_MAX as f32)))
    }

    /// Blends the splat over one vector of pixels of a row, whose transmittance is `transmittance`.
    #[inline(always)]
    pub(crate) fn cover<S: Simd<Vector = V>>(
        &self,
        s: S,
        vector: usize,
        row: usize,
        transmittance: V,
    ) -> Cover<S> {
        let (hit, alpha) = self.alpha(s, vector, row);
        let remaining = s.neg_mul_add(transmittance, alpha, transmittance);
        let enough = s.at_least(remaining, s.splat(TRANSMITTANCE_MIN as f32));
        let blended = s.and(hit, enough);
        let stopped = s.and_not(hit, enough);
        let stopped = s.select(stopped, s.negative(transmittance), transmittance);
        Cover { alpha, blended, transmittance: s.select(blended, remaining, stopped) }
    }
}

/// See [`Stripes::cover`].
pub(crate) struct Cover<S: Simd> {
    /// Alpha of the splat where it is blended; elsewhere unspecified.
    pub alpha: S::Vector,
    /// Where it is blended.
    pub blended: S::Mask,
    /// Transmittance behind it; negated where the pixel is done.
    pub transmittance: S::Vector,
}

impl<const CHANNELS: usize> TileRow<CHANNELS> {
    /// Blends a splat into row number `row`. Returns how many pixels were blended, and whether all pixels are done.
    #[inline(always)]
    fn blend<S: Simd>(
        &mut self,
        s: S,
        features: &[S::Vector; CHANNELS],
        stripes: &Stripes<S::Vector>,
        row: usize,
    ) -> (u32, bool) {
        let (mut count, mut done) = (0, true);
        for vector in 0..TILE / S::LANES {
            let at = vector * S::LANES;
            let transmittance = s.read(&self.transmittance.0[at..]);
            let cover = stripes.cover(s, vector, row, transmittance);
            let weight = s.select(cover.blended, s.mul(transmittance, cover.alpha), s.splat(0.0));
            for (sum, &feature) in self.sums.iter_mut().zip(features) {
                let total = s.mul_add(weight, feature, s.read(&sum.0[at..]));
                s.write(total, &mut sum.0[at..]);
            }
            s.write(cover.transmittance, &mut self.transmittance.0[at..]);
            count += s.bits(cover.blended).count_ones();
            done &= s.bits(s.at_least(cover.transmittance, s.splat(0.0))) == 0;
        }
        (count, done)
    }
}
