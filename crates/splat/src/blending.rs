//! The inner loop: blends splats front to back into one tile, a row of sixteen pixels at a time.

use crate::projection::{Splat, TILE};
use crate::reference::{ALPHA_MAX, TRANSMITTANCE_MIN};
use crate::simd::{InstructionSet, Row};

/// `log2(1/255)`.
pub(crate) const LOG2_ALPHA_MIN: f32 = -7.994_353_3;

/// How many splats ahead memory is asked for.
const PREFETCH: usize = 6;

/// The sums of one tile; `CHANNELS` of [`Splat::features`] are blended.
pub(crate) struct Tile<const CHANNELS: usize> {
    pub rows: [TileRow<CHANNELS>; TILE],
}

/// One row of a tile.
#[derive(Clone, Copy)]
pub(crate) struct TileRow<const CHANNELS: usize> {
    /// What is left of the light; negated once the pixel is done, or if it lies outside the image.
    pub transmittance: Row,
    /// Weighted sums of the features.
    pub sums: [Row; CHANNELS],
}

impl<const CHANNELS: usize> Tile<CHANNELS> {
    /// A tile of which the first `width` columns lie inside the image.
    #[inline(always)]
    pub(crate) fn new(width: usize) -> Self {
        let transmittance = Row(std::array::from_fn(|column| if column < width { 1.0 } else { -1.0 }));
        Self { rows: [TileRow { transmittance, sums: [Row([0.0; TILE]); CHANNELS] }; TILE] }
    }

    /// Blends the splats of `list`, front to back, into the first `height` rows of the tile at pixel `(left, top)`.
    /// Returns how many (splat, pixel) pairs were blended.
    #[inline(always)]
    pub(crate) fn blend(
        &mut self,
        isa: impl InstructionSet,
        splats: &[Splat],
        list: &[u32],
        (left, top): (usize, usize),
        height: usize,
    ) -> u64 {
        let mut blended = 0;
        // Bit i: row i has a pixel that is not done.
        let mut live = if height >= TILE { u16::MAX } else { (1 << height) - 1 };
        for (i, &index) in list.iter().enumerate() {
            if let Some(&ahead) = list.get(i + PREFETCH) {
                isa.prefetch(&splats[ahead as usize]);
            }
            let splat = &splats[index as usize];
            let (stripes, touched) = Stripes::new(isa, splat, left, top);
            let features: [_; CHANNELS] = std::array::from_fn(|channel| isa.splat(splat.features[channel]));
            let mut rows = touched & live;
            while rows != 0 {
                let row = rows.trailing_zeros() as usize % TILE;
                rows &= rows - 1;
                let (count, done) = self.rows[row].blend(isa, &features, &stripes, row);
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

/// A splat's alpha along the rows of a tile: at column `x` of row `i` it is
/// `2^(peaks[i] - (slope[x] + shear[i])^2)`.
struct Stripes<V> {
    slope: V,
    shear: Row,
    peaks: Row,
}

impl<V: Copy> Stripes<V> {
    /// The stripes in the tile at pixel `(left, top)`, and the rows (as bits) in which alpha may reach 1/255.
    #[inline(always)]
    fn new<I: InstructionSet<Vector = V>>(isa: I, splat: &Splat, left: usize, top: usize) -> (Self, u16) {
        let [xx, xy, yy] = splat.factor;
        let dx = (left as f64 - splat.center[0]) as f32;
        let dy = isa.add(isa.splat((top as f64 - splat.center[1]) as f32), isa.load(&Row::INDEX));
        let slope = isa.mul(isa.add(isa.splat(dx), isa.load(&Row::INDEX)), isa.splat(xx));
        let shear = isa.mul(dy, isa.splat(xy));
        let e2 = isa.mul(dy, isa.splat(yy));
        let peaks = isa.neg_mul_add(e2, e2, isa.splat(splat.log2_opacity));
        // The column nearest to the ridge, at the first or last column or between: the same operations as
        // for the pixels, so that rounding cannot tell them apart.
        let first = isa.add(isa.splat(dx * xx), shear);
        let last = isa.add(isa.splat((dx + (TILE - 1) as f32) * xx), shear);
        let nearest = isa.max(isa.max(first, isa.sub(isa.splat(0.0), last)), isa.splat(0.0));
        let best = isa.neg_mul_add(nearest, nearest, peaks);
        let touched = isa.bits(isa.at_least(best, isa.splat(LOG2_ALPHA_MIN)));
        let mut stripes = Self { slope, shear: Row([0.0; TILE]), peaks: Row([0.0; TILE]) };
        isa.store(shear, &mut stripes.shear);
        isa.store(peaks, &mut stripes.peaks);
        (stripes, touched)
    }
}

impl<const CHANNELS: usize> TileRow<CHANNELS> {
    /// Blends a splat into row number `row`. Returns how many pixels took part, and whether all pixels are done.
    #[inline(always)]
    fn blend<I: InstructionSet>(
        &mut self,
        isa: I,
        features: &[I::Vector; CHANNELS],
        stripes: &Stripes<I::Vector>,
        row: usize,
    ) -> (u32, bool) {
        let e1 = isa.add(stripes.slope, isa.splat(stripes.shear.0[row]));
        let log2_alpha = isa.neg_mul_add(e1, e1, isa.splat(stripes.peaks.0[row]));
        let hit = isa.at_least(log2_alpha, isa.splat(LOG2_ALPHA_MIN));
        // Misses are not used, but must stay in the range of exp2.
        let alpha = isa.exp2(isa.max(log2_alpha, isa.splat(-10.0)));
        let alpha = isa.min(alpha, isa.splat(ALPHA_MAX as f32));

        let transmittance = isa.load(&self.transmittance);
        let remaining = isa.neg_mul_add(transmittance, alpha, transmittance);
        let enough = isa.at_least(remaining, isa.splat(TRANSMITTANCE_MIN as f32));
        let blended = isa.and(hit, enough);
        let weight = isa.select(blended, isa.mul(transmittance, alpha), isa.splat(0.0));
        for (sum, &feature) in self.sums.iter_mut().zip(features) {
            let total = isa.mul_add(weight, feature, isa.load(sum));
            isa.store(total, sum);
        }
        let stopped = isa.and_not(hit, enough);
        let left =
            isa.select(blended, remaining, isa.select(stopped, isa.negative(transmittance), transmittance));
        let done = isa.bits(isa.at_least(left, isa.splat(0.0))) == 0;
        isa.store(left, &mut self.transmittance);
        (isa.bits(blended).count_ones(), done)
    }
}
