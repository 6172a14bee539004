//! The inner loops: blends the splats of a tile once more, front to back, remembers every row of pixels that one was blended
//! into, and walks through these back to front.

use srflow_simd::{MAX_LANES, Simd};

use super::Partial;
use crate::FrameGradients;
use crate::blending::{MAX_VECTORS, PREFETCH, Row, Stripes, rows_inside};
use crate::ordering::Drawn;
use crate::projection::{Splat, TILE};
use crate::reference::ALPHA_MAX;

/// Sums over pixels that a splat's shape and opacity need: the first entries of [`Partial::sums`]. With `v` the gradient of the
/// natural logarithm of alpha, and `e1` and `e2` as for [`Splat`].
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

/// The blending of one tile, as it was in the forward pass.
#[derive(Default)]
pub(crate) struct Replay {
    /// Of each splat that was blended at a pixel, front to back: its position in the strip's list, and one past the last of its
    /// rows.
    splats: Vec<(u32, usize)>,
    rows: Vec<ReplayRow>,
    /// Number of the row in the tile, of each of `rows`.
    numbers: Vec<u8>,
}

#[derive(Clone, Copy)]
struct ReplayRow {
    /// Zero where the splat was not blended.
    alpha: Row,
    /// In front of the splat.
    transmittance: Row,
}

/// The image's part that a tile covers.
#[derive(Clone, Copy)]
pub(crate) struct Place {
    /// Width of the image.
    pub image_width: usize,
    pub left: usize,
    pub top: usize,
    /// Columns and rows inside the image.
    pub width: usize,
    pub height: usize,
}

impl Replay {
    /// Blends the splats of `list` (positions in `drawn`), as [`Tile::blend`](crate::blending::Tile::blend). Returns the final
    /// transmittance of each row.
    #[inline(always)]
    pub(crate) fn forward<S: Simd>(
        &mut self,
        s: S,
        splats: &[Splat],
        drawn: &[Drawn],
        list: &[u32],
        place: Place,
    ) -> [Row; TILE] {
        self.splats.clear();
        self.rows.clear();
        self.numbers.clear();
        let mut transmittance = [Row::transparent(place.width); TILE];
        // Bit i: row i has a pixel that is not done.
        let mut live = rows_inside(place.height);
        for (i, &position) in list.iter().enumerate() {
            if let Some(&ahead) = list.get(i + PREFETCH) {
                s.prefetch(&splats[drawn[ahead as usize].splat as usize]);
            }
            let splat = &splats[drawn[position as usize].splat as usize];
            let (stripes, touched) = Stripes::new(s, splat, place.left, place.top);
            let before = self.rows.len();
            let mut rows = touched & live;
            while rows != 0 {
                let row = rows.trailing_zeros() as usize % TILE;
                rows &= rows - 1;
                let mut replay = ReplayRow { alpha: Row::ZERO, transmittance: transmittance[row] };
                let (mut blended, mut done) = (0, true);
                for vector in 0..TILE / S::LANES {
                    let at = vector * S::LANES;
                    let cover = stripes.cover(s, vector, row, s.read(&transmittance[row].0[at..]));
                    let alpha = s.select(cover.blended, cover.alpha, s.splat(0.0));
                    s.write(alpha, &mut replay.alpha.0[at..]);
                    s.write(cover.transmittance, &mut transmittance[row].0[at..]);
                    blended |= s.bits(cover.blended);
                    done &= s.bits(s.at_least(cover.transmittance, s.splat(0.0))) == 0;
                }
                if blended != 0 {
                    self.rows.push(replay);
                    self.numbers.push(row as u8);
                }
                live &= !(u16::from(done) << row);
            }
            if self.rows.len() > before {
                self.splats.push((position, self.rows.len()));
            }
            if live == 0 {
                break;
            }
        }
        for row in &mut transmittance {
            row.0.iter_mut().for_each(|value| *value = value.abs());
        }
        transmittance
    }

    /// Whether no splat was blended.
    pub(crate) fn is_empty(&self) -> bool {
        self.splats.is_empty()
    }

    /// The blended splats, back to front: position in the strip's list, and range of rows.
    #[inline(always)]
    fn back_to_front(&self) -> impl Iterator<Item = (u32, std::ops::Range<usize>)> {
        self.splats.iter().enumerate().rev().map(|(i, &(position, end))| {
            let first = if i == 0 { 0 } else { self.splats[i - 1].1 };
            (position, first..end)
        })
    }

    /// Weighted sums of one feature.
    #[inline(always)]
    fn sums<S: Simd>(&self, s: S, splats: &[Splat], drawn: &[Drawn], feature: usize) -> [Row; TILE] {
        let mut sums = [Row::ZERO; TILE];
        let mut first = 0;
        for &(position, end) in &self.splats {
            let value = s.splat(splats[drawn[position as usize].splat as usize].features[feature]);
            for (replay, &row) in self.rows[first..end].iter().zip(&self.numbers[first..end]) {
                let sum = &mut sums[usize::from(row) % TILE].0;
                for at in (0..TILE).step_by(S::LANES) {
                    let weight = s.mul(s.read(&replay.alpha.0[at..]), s.read(&replay.transmittance.0[at..]));
                    let total = s.mul_add(weight, value, s.read(&sum[at..]));
                    s.write(total, &mut sum[at..]);
                }
            }
            first = end;
        }
        sums
    }

    /// Walks through the blended splats back to front, and passes `add` the position of each in the strip's list, and its
    /// sums over the pixels of the tile.
    #[inline(always)]
    pub(crate) fn backward<S: Simd, const CHANNELS: usize>(
        &self,
        s: S,
        splats: &[Splat],
        drawn: &[Drawn],
        place: Place,
        gradients: &mut TileGradients<CHANNELS>,
        mut add: impl FnMut(u32, &[f32; MAX_LANES]),
    ) {
        let zero = s.splat(0.0);
        for (position, rows) in self.back_to_front() {
            let splat = &splats[drawn[position as usize].splat as usize];
            let (stripes, _) = Stripes::new(s, splat, place.left, place.top);
            let (xy, yy) = (s.splat(splat.factor[1]), s.splat(splat.factor[2]));
            let mut values = [zero; CHANNELS];
            for (value, &feature) in values.iter_mut().zip(&splat.features) {
                *value = s.splat(feature);
            }
            let mut moments = [[zero; moment::COUNT]; MAX_VECTORS];
            let mut features = [[zero; CHANNELS]; MAX_VECTORS];
            for (replay, &row) in self.rows[rows.clone()].iter().zip(&self.numbers[rows]) {
                let row = usize::from(row) % TILE;
                let e2 = s.splat(stripes.e2.0[row]);
                let TileRowGradients { sums, behind } = &mut gradients.rows[row];
                for vector in 0..TILE / S::LANES {
                    let at = vector * S::LANES;
                    let alpha = s.read(&replay.alpha.0[at..]);
                    let weight = s.mul(alpha, s.read(&replay.transmittance.0[at..]));
                    let mut own = zero;
                    for channel in 0..CHANNELS {
                        let sum = s.read(&sums[channel].0[at..]);
                        own = s.mul_add(values[channel], sum, own);
                        let total = &mut features[vector][channel];
                        *total = s.mul_add(weight, sum, *total);
                    }
                    let further = s.read(&behind.0[at..]);
                    let difference = s.sub(own, further);
                    s.write(s.mul_add(alpha, difference, further), &mut behind.0[at..]);

                    // The gradient of log(alpha): none where alpha is at its limit.
                    let limited = s.at_least(alpha, s.splat(ALPHA_MAX as f32));
                    let v = s.select(limited, zero, s.mul(weight, difference));
                    let e1 = stripes.e1(s, vector, row);
                    let (v1, v2) = (s.mul(v, e1), s.mul(v, e2));
                    let total = &mut moments[vector];
                    total[moment::V] = s.add(total[moment::V], v);
                    total[moment::E1] = s.add(total[moment::E1], v1);
                    total[moment::E2] = s.add(total[moment::E2], v2);
                    total[moment::E11] = s.mul_add(v1, e1, total[moment::E11]);
                    total[moment::E12] = s.mul_add(v1, e2, total[moment::E12]);
                    total[moment::E22] = s.mul_add(v2, e2, total[moment::E22]);
                    total[moment::ABSOLUTE_X] = s.add(total[moment::ABSOLUTE_X], s.negative(v1));
                    let y = s.mul_add(v1, xy, s.mul(v2, yy));
                    total[moment::ABSOLUTE_Y] = s.add(total[moment::ABSOLUTE_Y], s.negative(y));
                }
            }
            let mut columns = [[0.0; MAX_LANES]; MAX_LANES];
            for vector in 0..TILE / S::LANES {
                let at = vector * S::LANES;
                for i in 0..moment::COUNT {
                    s.write(moments[vector][i], &mut columns[i][at..]);
                }
                for channel in 0..CHANNELS {
                    s.write(features[vector][channel], &mut columns[moment::COUNT + channel][at..]);
                }
            }
            add(position, &s.sum_rows(&columns));
        }
    }
}

/// Gradients with respect to what a tile's pixels are computed from.
pub(crate) struct TileGradients<const CHANNELS: usize> {
    rows: [TileRowGradients<CHANNELS>; TILE],
}

#[derive(Clone, Copy)]
struct TileRowGradients<const CHANNELS: usize> {
    /// Of the weighted sums of the features.
    sums: [Row; CHANNELS],
    /// Of the transmittance behind the splats that were walked through: at first, the final one.
    behind: Row,
}

impl<const CHANNELS: usize> TileGradients<CHANNELS> {
    /// The gradients of one tile, whose blending is `replay` and whose final transmittance is `transmittance`.
    #[inline(always)]
    pub(crate) fn new(
        s: impl Simd,
        gradients: &FrameGradients,
        background: [f32; 3],
        (splats, drawn): (&[Splat], &[Drawn]),
        replay: &Replay,
        transmittance: &[Row; TILE],
        place: Place,
    ) -> Self {
        let mut out =
            Self { rows: [TileRowGradients { sums: [Row::ZERO; CHANNELS], behind: Row::ZERO }; TILE] };
        for (y, row) in out.rows.iter_mut().enumerate().take(place.height) {
            let first = (place.top + y) * place.image_width + place.left;
            let span = first..first + place.width;
            if let Some(colors) = gradients.color.get(span.clone()) {
                for (x, color) in colors.iter().enumerate() {
                    for channel in 0..3 {
                        row.sums[channel].0[x] = color[channel];
                        row.behind.0[x] += color[channel] * background[channel];
                    }
                }
            }
            if let Some(alphas) = gradients.alpha.get(span.clone()) {
                for (behind, alpha) in row.behind.0.iter_mut().zip(alphas) {
                    *behind -= alpha;
                }
            }
            if CHANNELS == 7
                && let Some(flows) = gradients.flow.get(span)
            {
                for (x, flow) in flows.iter().enumerate() {
                    row.sums[4].0[x] = flow[0];
                    row.sums[5].0[x] = flow[1];
                }
            }
        }
        // A depth is the weighted sum over alpha.
        for (channel, list) in [(3, &gradients.depth), (6, &gradients.depth_next)] {
            if channel >= CHANNELS || list.is_empty() {
                continue;
            }
            let sums = replay.sums(s, splats, drawn, channel);
            for (y, row) in out.rows.iter_mut().enumerate().take(place.height) {
                let first = (place.top + y) * place.image_width + place.left;
                for (x, gradient) in list[first..first + place.width].iter().enumerate() {
                    let alpha = 1.0 - transmittance[y].0[x];
                    if alpha > 0.0 {
                        row.sums[channel].0[x] = gradient / alpha;
                        row.behind.0[x] += gradient / alpha * (sums[y].0[x] / alpha);
                    }
                }
            }
        }
        out
    }
}

impl Partial {
    #[inline(always)]
    pub(crate) fn add(&mut self, sums: &[f32; MAX_LANES]) {
        for (total, sum) in self.sums.iter_mut().zip(sums) {
            *total += sum;
        }
    }
}
