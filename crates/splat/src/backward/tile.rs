//! The inner loops: from the gradients of a tile's pixels and its blending to sums over the pixels of each splat.

use srflow_simd::{MAX_LANES, Simd};

use super::entries::moment;
use crate::FrameGradients;
use crate::blending::{MAX_VECTORS, Row, Stripes};
use crate::ordering::Drawn;
use crate::pixel_order::PixelOrder;
use crate::projection::{Splat, TILE};
use crate::reference::ALPHA_MAX;
use crate::replay::{Place, Replay};

impl Replay {
    /// The gradients of the splats: passes `add` the position of each in the strip's list, and its sums over the pixels of the
    /// tile. `order` is what blended the tile if its pixels were sorted.
    #[inline(always)]
    #[expect(clippy::too_many_arguments, reason = "a tile, its gradients and its blending")]
    pub(crate) fn backward<S: Simd, const CHANNELS: usize>(
        &self,
        s: S,
        splats: &[Splat],
        drawn: &[Drawn],
        place: Place,
        TileGradients { sums, behind }: &mut TileGradients<CHANNELS>,
        order: Option<&mut PixelOrder>,
        add: impl FnMut(u32, &[f32; MAX_LANES]),
    ) {
        let Some(order) = order else {
            return self.add_moments(
                s,
                (splats, drawn),
                place,
                sums,
                // From back to front, `behind` is what is behind the splat.
                #[inline(always)]
                |at, row, lane, features| {
                    let alpha = s.read(&self.rows[at].alpha.0[lane..]);
                    let weight = s.mul(alpha, s.read(&self.rows[at].transmittance.0[lane..]));
                    let own = dot(s, features, &sums[row], lane);
                    let further = s.read(&behind[row].0[lane..]);
                    let difference = s.sub(own, further);
                    s.write(s.mul_add(alpha, difference, further), &mut behind[row].0[lane..]);
                    // None where alpha is at its limit.
                    let limited = s.at_least(alpha, s.splat(ALPHA_MAX as f32));
                    s.select(limited, s.splat(0.0), s.mul(weight, difference))
                },
                add,
            );
        };
        order.slopes.clear();
        order.slopes.resize(self.rows.len(), Row::ZERO);
        for (position, rows) in self.back_to_front() {
            let features = features(s, &splats[drawn[position as usize].splat as usize]);
            for (at, row) in self.rows_of(rows) {
                for lane in (0..TILE).step_by(S::LANES) {
                    let own = dot::<S, CHANNELS>(s, &features, &sums[row], lane);
                    s.write(own, &mut order.slopes[at].0[lane..]);
                }
            }
        }
        order.differentiate(s, &self.rows, behind);
        self.add_moments(
            s,
            (splats, drawn),
            place,
            sums,
            #[inline(always)]
            |at, _, lane, _| {
                let blended = s.greater(s.read(&self.rows[at].alpha.0[lane..]), s.splat(0.0));
                s.select(blended, s.read(&order.slopes[at].0[lane..]), s.splat(0.0))
            },
            add,
        );
    }

    /// See [`Replay::backward`]. `slope` gives the gradient of the natural logarithm of alpha, for a vector of pixels: the place
    /// of their row in `rows`, its number in the tile, their first column, and the splat's features.
    #[inline(always)]
    fn add_moments<S: Simd, const CHANNELS: usize>(
        &self,
        s: S,
        (splats, drawn): (&[Splat], &[Drawn]),
        place: Place,
        sums: &[[Row; CHANNELS]; TILE],
        mut slope: impl FnMut(usize, usize, usize, &[S::Vector; CHANNELS]) -> S::Vector,
        mut add: impl FnMut(u32, &[f32; MAX_LANES]),
    ) {
        let zero = s.splat(0.0);
        for (position, rows) in self.back_to_front() {
            let splat = &splats[drawn[position as usize].splat as usize];
            let (stripes, _) = Stripes::new(s, splat, place.left, place.top);
            let (xy, yy) = (s.splat(splat.factor[1]), s.splat(splat.factor[2]));
            let values = features(s, splat);
            let mut moments = [[zero; moment::COUNT]; MAX_VECTORS];
            let mut totals = [[zero; CHANNELS]; MAX_VECTORS];
            for (at, row) in self.rows_of(rows) {
                let replay = &self.rows[at];
                let e2 = s.splat(stripes.e2.0[row]);
                for vector in 0..TILE / S::LANES {
                    let lane = vector * S::LANES;
                    let alpha = s.read(&replay.alpha.0[lane..]);
                    let weight = s.mul(alpha, s.read(&replay.transmittance.0[lane..]));
                    for (total, sum) in totals[vector].iter_mut().zip(&sums[row]) {
                        *total = s.mul_add(weight, s.read(&sum.0[lane..]), *total);
                    }
                    let v = slope(at, row, lane, &values);
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
                    s.write(totals[vector][channel], &mut columns[moment::COUNT + channel][at..]);
                }
            }
            add(position, &s.sum_rows(&columns));
        }
    }
}

/// The first features of a splat, each in all lanes.
#[inline(always)]
fn features<S: Simd, const CHANNELS: usize>(s: S, splat: &Splat) -> [S::Vector; CHANNELS] {
    std::array::from_fn(|channel| s.splat(splat.features[channel]))
}

/// Features times the gradients of their sums, for a vector of pixels.
#[inline(always)]
fn dot<S: Simd, const CHANNELS: usize>(
    s: S,
    features: &[S::Vector; CHANNELS],
    sums: &[Row; CHANNELS],
    lane: usize,
) -> S::Vector {
    let mut total = s.splat(0.0);
    for (&feature, sum) in features.iter().zip(sums) {
        total = s.mul_add(feature, s.read(&sum.0[lane..]), total);
    }
    total
}

/// Gradients with respect to what a tile's pixels are computed from.
pub(crate) struct TileGradients<const CHANNELS: usize> {
    /// Of the weighted sums of the features.
    sums: [[Row; CHANNELS]; TILE],
    /// Of the transmittance behind the splats that were walked through: at first, the final one.
    behind: [Row; TILE],
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
        let mut out = Self { sums: [[Row::ZERO; CHANNELS]; TILE], behind: [Row::ZERO; TILE] };
        for y in 0..place.height {
            let (sums, behind) = (&mut out.sums[y], &mut out.behind[y]);
            let first = (place.top + y) * place.image_width + place.left;
            let span = first..first + place.width;
            if let Some(colors) = gradients.color.get(span.clone()) {
                for (x, color) in colors.iter().enumerate() {
                    for channel in 0..3 {
                        sums[channel].0[x] = color[channel];
                        behind.0[x] += color[channel] * background[channel];
                    }
                }
            }
            if let Some(alphas) = gradients.alpha.get(span.clone()) {
                for (behind, alpha) in behind.0.iter_mut().zip(alphas) {
                    *behind -= alpha;
                }
            }
            if CHANNELS == 7
                && let Some(flows) = gradients.flow.get(span)
            {
                for (x, flow) in flows.iter().enumerate() {
                    sums[4].0[x] = flow[0];
                    sums[5].0[x] = flow[1];
                }
            }
        }
        // A depth is the weighted sum over alpha.
        for (channel, list) in [(3, &gradients.depth), (6, &gradients.depth_next)] {
            if channel >= CHANNELS || list.is_empty() {
                continue;
            }
            let splat_of = |position: u32| &splats[drawn[position as usize].splat as usize];
            let sums = replay.sums::<_, 1>(s, splat_of, channel);
            for y in 0..place.height {
                let first = (place.top + y) * place.image_width + place.left;
                for (x, gradient) in list[first..first + place.width].iter().enumerate() {
                    let alpha = 1.0 - transmittance[y].0[x];
                    if alpha > 0.0 {
                        out.sums[y][channel].0[x] = gradient / alpha;
                        out.behind[y].0[x] += gradient / alpha * (sums[y][0].0[x] / alpha);
                    }
                }
            }
        }
        out
    }
}
