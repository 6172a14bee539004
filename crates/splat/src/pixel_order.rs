//! Blending in the order of each pixel, [`Sorting::PerPixel`](crate::Sorting::PerPixel).

use glam::{DMat3, DVec3};
use rayon::prelude::*;
use srflow_simd::Simd;

use crate::blending::{PREFETCH, Row, Stripes, rows_inside};
use crate::projection::{Placement, Splat, TILE, View};
use crate::reference::{ALPHA_MAX, LOW_PASS, TRANSMITTANCE_MIN};
use crate::replay::{Place, Replay, ReplayRow};
use crate::{Camera, Gaussians};

/// Where a splat is densest along the rays of the pixels. In the coordinates in which the filtered Gaussian is round and has
/// variance 1, the ray through pixel `(x, y)` has the direction `e = origin + x right + y down` (with a camera z of 1), and
/// the depth is `e . center / e . e`.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct Peak {
    center: DVec3,
    origin: DVec3,
    right: DVec3,
    down: DVec3,
}

/// One entry of each list per Gaussian; that of a hidden splat is unspecified.
#[derive(Debug, Default)]
pub(crate) struct Peaks {
    peaks: Vec<Peak>,
    /// At no pixel that the splat reaches is its depth less than this.
    nearest: Vec<f32>,
}

impl Peaks {
    pub(crate) fn find(
        &mut self,
        gaussians: &Gaussians,
        camera: &Camera,
        splats: &[Splat],
        placements: &[Placement],
    ) {
        let view = View::new(camera, false);
        self.peaks.resize(gaussians.len(), Peak::default());
        self.nearest.resize(gaussians.len(), 0.0);
        let lists = self.peaks.par_iter_mut().zip(&mut self.nearest);
        lists.with_min_len(1024).enumerate().for_each(|(index, (peak, nearest))| {
            if !placements[index].is_hidden() {
                (*peak, *nearest) = Peak::new(&view, gaussians, index, splats[index].log2_opacity);
            }
        });
    }
}

impl Peak {
    /// The peak, and its entry of [`Peaks::nearest`].
    fn new(view: &View, gaussians: &Gaussians, index: usize, log2_opacity: f32) -> (Self, f32) {
        let View { camera, rotation, .. } = view;
        let point = camera.camera_from_world.transform_point3(gaussians.positions[index].as_dvec3());
        let scale = gaussians.scales[index].as_dvec3();
        let axes = *rotation * DMat3::from_quat(gaussians.rotations[index].as_dquat().normalize());
        let variances = scale * scale + LOW_PASS * point.z * point.z / (camera.fx * camera.fy);
        let round_from_camera = DMat3::from_diagonal(variances.map(f64::sqrt).recip()) * axes.transpose();
        let (right, down) = (round_from_camera.x_axis / camera.fx, round_from_camera.y_axis / camera.fy);
        let origin = round_from_camera.z_axis - camera.cx * right - camera.cy * down;
        let depth_deviation = axes.row(2).dot(axes.row(2) * variances).sqrt();
        let nearest = view.nearest(point, round_from_camera, depth_deviation, log2_opacity);
        (Self { center: round_from_camera * point, origin, right, down }, nearest)
    }

    /// The depths at the pixels of a row that starts at `(left, y)`. In `f64`, like the definition: rounded to `f32` after that,
    /// they are in the same order.
    #[inline(always)]
    fn depths(&self, left: usize, y: usize) -> Row {
        let first = (self.origin + left as f64 * self.right + y as f64 * self.down).to_array();
        let (right, center) = (self.right.to_array(), self.center.to_array());
        let mut depths = Row::ZERO;
        for (x, depth) in depths.0.iter_mut().enumerate() {
            let e: [f64; 3] = std::array::from_fn(|axis| first[axis] + x as f64 * right[axis]);
            let along = e[0] * center[0] + e[1] * center[1] + e[2] * center[2];
            *depth = (along / (e[0] * e[0] + e[1] * e[1] + e[2] * e[2])) as f32;
            *depth = depth.min(f32::MAX);
        }
        depths
    }
}

impl View {
    /// A bound for [`Peaks::nearest`].
    ///
    /// The point `p + z d + t c`, with the centre `p = z c`, the offset `d` of a pixel's direction from the centre's direction
    /// `c`, and a number `t`, is projected to the pixel by the affine projection. With the best `t` its distance `m` from the
    /// centre, in standard deviations, is that on the image (to which the filter adds a little more where `fx` and `fy`
    /// differ), and `t` at most `m` times the deviation along z, `s`. So `d` has at most the length `m (1 + s |c|) / z`.
    /// The ray itself goes through `(z + t) (c + d)`, which is `t d` away from that point: its densest point is at most `m (1
    /// + s |d|)` deviations from the centre, and `s` times that in depth.
    fn nearest(&self, point: DVec3, round_from_camera: DMat3, deviation: f64, log2_opacity: f32) -> f32 {
        let direction = point.truncate() / point.z;
        if self.clamped(direction) != direction {
            return f32::NEG_INFINITY; // the projection is that of another direction
        }
        let stretch = (self.camera.fx / self.camera.fy).max(self.camera.fy / self.camera.fx);
        let reach = 2.0 * std::f64::consts::LN_2 * (f64::from(log2_opacity) + 8.0) * stretch;
        let m = reach.max(0.0).sqrt();
        let along = (round_from_camera * direction.extend(1.0)).length();
        let across = m * (1.0 + deviation * along) / point.z;
        let radius = m * (1.0 + deviation * across) * deviation;
        let nearest = point.z - 1.001 * radius - 1e-6 * point.z;
        // Written such that NaN is no bound.
        if nearest.is_finite() { nearest as f32 } else { f32::NEG_INFINITY }
    }
}

/// Blends the pixels of a tile, each in its own order.
#[derive(Debug, Default)]
pub(crate) struct PixelOrder {
    lines: Vec<Line>,
    /// The least depth that a splat of the list can have, from every entry on.
    nearest: Vec<f32>,
    /// Number of blended (splat, pixel) pairs.
    pub blended: u64,
    /// Of each row of the replay; see [`PixelOrder::differentiate`].
    pub slopes: Vec<Row>,
    /// Of each pixel of a line, the splats blended there, back to front: the bits of the transmittance in front of the splat, and
    /// its row of the replay.
    hits: [Vec<u64>; TILE],
}

/// A row of pixels.
#[derive(Debug, Clone)]
struct Line {
    waiting: Vec<Waiting>,
    /// Depth of the nearest splat that would reduce the transmittance too much, or infinite.
    stop: Row,
    /// All rows of the replay in this line.
    rows: Vec<u32>,
}

/// A splat that nearer ones may follow.
#[derive(Debug, Clone, Copy)]
struct Waiting {
    depth: Row,
    /// One minus alpha; 1 where the splat is not waiting.
    factor: Row,
    /// In front of the splat: the product of the factors of all splats found there until now.
    transmittance: Row,
    /// Its row of the replay.
    at: usize,
}

/// Number of splats between two times that those waiting are settled.
const BATCH: usize = 32;

impl PixelOrder {
    /// Blends the splats of `list`, which are sorted by the depths of their centres; `index` gives the splat of an entry. Fills
    /// `replay` and returns the final transmittance of each row.
    ///
    /// Nothing is sorted: the transmittance in front of a splat is the product of the factors of all that are nearer, in any
    /// order. A splat is multiplied with those found before it that still wait, one way or the other, all pixels of a row at once.
    /// It no longer waits when [`Peaks::nearest`] tells that nothing nearer can follow. A product only decreases: where it is too
    /// small the pixel stops, whatever follows, and all that is farther is left out.
    #[inline(always)]
    pub(crate) fn forward<S: Simd>(
        &mut self,
        s: S,
        (splats, peaks): (&[Splat], &Peaks),
        list: &[u32],
        index: impl Fn(u32) -> usize,
        place: Place,
        replay: &mut Replay,
    ) -> [Row; TILE] {
        replay.clear();
        self.lines.resize(TILE, Line { waiting: Vec::new(), stop: Row::ZERO, rows: Vec::new() });
        for line in &mut self.lines {
            line.waiting.clear();
            line.stop = Row([f32::INFINITY; TILE]);
            line.rows.clear();
        }
        self.blended = 0;
        self.nearest.clear();
        self.nearest.extend(list.iter().map(|&entry| peaks.nearest[index(entry)]));
        let mut least = f32::INFINITY;
        for nearest in self.nearest.iter_mut().rev() {
            least = least.min(*nearest);
            *nearest = least;
        }

        let mut transmittance = [Row::transparent(place.width); TILE];
        // Bit i: row i has a pixel that is not done.
        let mut live = rows_inside(place.height);
        for (i, &entry) in list.iter().enumerate() {
            if let Some(&ahead) = list.get(i + PREFETCH) {
                s.prefetch(&splats[index(ahead)]);
                s.prefetch(&peaks.peaks[index(ahead)].center);
                s.prefetch(&peaks.peaks[index(ahead)].down);
            }
            if i % BATCH == 0 && i > 0 {
                live = self.settle(s, live, self.nearest[i], replay, &mut transmittance);
                if live == 0 {
                    break;
                }
            }
            let (splat, peak) = (&splats[index(entry)], &peaks.peaks[index(entry)]);
            let (stripes, touched) = Stripes::new(s, splat, place.left, place.top);
            let mut rows = touched & live;
            while rows != 0 {
                let row = rows.trailing_zeros() as usize % TILE;
                rows &= rows - 1;
                let mut alphas = Row::ZERO;
                let mut hits = 0;
                for lane in (0..TILE).step_by(S::LANES) {
                    let (hit, alpha) = stripes.alpha(s, lane / S::LANES, row);
                    let hit = s.and(hit, s.at_least(s.read(&transmittance[row].0[lane..]), s.splat(0.0)));
                    s.write(s.select(hit, alpha, s.splat(0.0)), &mut alphas.0[lane..]);
                    hits |= s.bits(hit);
                }
                if hits != 0 {
                    let depth = peak.depths(place.left, place.top + row);
                    self.lines[row].push(s, &transmittance[row], alphas, depth, row, replay);
                }
            }
            replay.push_splat(entry);
        }
        self.settle(s, live, f32::MAX, replay, &mut transmittance);
        for row in &mut transmittance {
            row.0.iter_mut().for_each(|value| *value = value.abs());
        }
        transmittance
    }

    /// Blends what waits at up to this depth, in the rows `live`. Returns those with a pixel that is not done.
    #[inline(always)]
    fn settle<S: Simd>(
        &mut self,
        s: S,
        live: u16,
        depth: f32,
        replay: &mut Replay,
        transmittance: &mut [Row; TILE],
    ) -> u16 {
        let (mut rows, mut still) = (live, live);
        while rows != 0 {
            let row = rows.trailing_zeros() as usize % TILE;
            rows &= rows - 1;
            let (blended, done) = self.lines[row].settle(s, depth, replay, &mut transmittance[row]);
            self.blended += u64::from(blended);
            still &= !(u16::from(done) << row);
        }
        still
    }

    /// The gradients of the natural logarithm of alpha. `self.slopes` holds, for each row of the replay, the splat's features
    /// times the gradients of their sums, and gets the result, unspecified where the splat was not blended. `behind` is the
    /// gradient with respect to the final transmittance.
    #[inline(always)]
    pub(crate) fn differentiate<S: Simd>(&mut self, s: S, rows: &[ReplayRow], behind: &[Row; TILE]) {
        for (line, behind) in self.lines.iter().zip(behind) {
            self.hits.iter_mut().for_each(Vec::clear);
            for &at in line.rows.iter().rev() {
                let ReplayRow { alpha, transmittance } = &rows[at as usize];
                let mut bits = 0;
                for lane in (0..TILE).step_by(S::LANES) {
                    bits |= s.bits(s.greater(s.read(&alpha.0[lane..]), s.splat(0.0))) << lane;
                }
                while bits != 0 {
                    let column = bits.trailing_zeros() as usize % TILE;
                    bits &= bits - 1;
                    // Positive numbers sort like their bits.
                    let sortable = transmittance.0[column].to_bits();
                    insert(&mut self.hits[column], u64::from(sortable) << 32 | u64::from(at));
                }
            }
            for (column, hits) in self.hits.iter_mut().enumerate() {
                let mut behind = behind.0[column];
                for &hit in &*hits {
                    let at = hit as u32 as usize;
                    let (alpha, transmittance) = (rows[at].alpha.0[column], rows[at].transmittance.0[column]);
                    let slope = &mut self.slopes[at].0[column];
                    let difference = *slope - behind;
                    behind = alpha.mul_add(difference, behind);
                    // None where alpha is at its limit.
                    *slope = if alpha >= ALPHA_MAX as f32 { 0.0 } else { alpha * transmittance * difference };
                }
            }
        }
    }
}

/// Inserts into a sorted list. Splats come sorted by the depths of their centres, so there is little to move.
#[inline(always)]
fn insert(list: &mut Vec<u64>, item: u64) {
    list.push(item);
    let mut sorted = &mut list[..];
    while let [.., before, last] = sorted
        && *before > item
    {
        *last = *before;
        *before = item;
        let rest = sorted.len() - 1;
        sorted = &mut sorted[..rest];
    }
}

impl Line {
    /// Adds a splat to those waiting. `alphas` is zero where it does not reach the pixel, `front` the transmittance behind all
    /// that is settled.
    #[inline(always)]
    fn push<S: Simd>(
        &mut self,
        s: S,
        front: &Row,
        mut alphas: Row,
        depth: Row,
        row: usize,
        replay: &mut Replay,
    ) {
        let (zero, one) = (s.splat(0.0), s.splat(1.0));
        let mut new = Waiting { depth, factor: Row::ZERO, transmittance: Row::ZERO, at: replay.rows.len() };
        let mut hits = 0;
        for lane in (0..TILE).step_by(S::LANES) {
            let alpha = s.read(&alphas.0[lane..]);
            let covered = s.at_least(s.read(&depth.0[lane..]), s.read(&self.stop.0[lane..]));
            let alpha = s.select(covered, zero, alpha);
            s.write(alpha, &mut alphas.0[lane..]);
            hits |= s.bits(s.greater(alpha, zero));
            s.write(s.sub(one, alpha), &mut new.factor.0[lane..]);
        }
        if hits == 0 {
            return;
        }
        for lane in (0..TILE).step_by(S::LANES) {
            let (depth, factor) = (s.read(&depth.0[lane..]), s.read(&new.factor.0[lane..]));
            let mut transmittance = s.read(&front.0[lane..]);
            for waiting in &mut self.waiting {
                let in_front = s.at_least(depth, s.read(&waiting.depth.0[lane..]));
                let of_waiting = s.select(in_front, s.read(&waiting.factor.0[lane..]), one);
                transmittance = s.mul(transmittance, of_waiting);
                let behind = s.mul(s.read(&waiting.transmittance.0[lane..]), s.select(in_front, one, factor));
                s.write(behind, &mut waiting.transmittance.0[lane..]);
            }
            s.write(transmittance, &mut new.transmittance.0[lane..]);
        }
        self.waiting.push(new);
        self.rows.push(new.at as u32);
        replay.push_row(ReplayRow { alpha: alphas, transmittance: Row::ZERO }, row);
    }

    /// Blends what waits at up to this depth. Returns the number of blended (splat, pixel) pairs, and whether all pixels are
    /// done.
    #[inline(always)]
    fn settle<S: Simd>(&mut self, s: S, depth: f32, replay: &mut Replay, front: &mut Row) -> (u32, bool) {
        let (zero, one, depth) = (s.splat(0.0), s.splat(1.0), s.splat(depth));
        let mut count = 0;
        let mut kept = 0;
        for i in 0..self.waiting.len() {
            let mut waiting = self.waiting[i];
            let replay = &mut replay.rows[waiting.at];
            let mut left = 0;
            for lane in (0..TILE).step_by(S::LANES) {
                let own = s.read(&waiting.depth.0[lane..]);
                let factor = s.read(&waiting.factor.0[lane..]);
                let transmittance = s.read(&waiting.transmittance.0[lane..]);
                let alpha = s.read(&replay.alpha.0[lane..]);
                let is_waiting = s.greater(one, factor);
                let enough = s.at_least(s.mul(transmittance, factor), s.splat(TRANSMITTANCE_MIN as f32));
                let stops = s.and_not(is_waiting, enough);
                let stop = s.read(&self.stop.0[lane..]);
                s.write(s.select(stops, s.min(own, stop), stop), &mut self.stop.0[lane..]);
                s.write(s.select(stops, zero, alpha), &mut replay.alpha.0[lane..]);

                let blends = s.and(s.and(is_waiting, enough), s.at_least(depth, own));
                count += s.bits(blends).count_ones();
                let before = s.read(&front.0[lane..]);
                s.write(s.select(blends, s.mul(before, factor), before), &mut front.0[lane..]);
                let unset = s.read(&replay.transmittance.0[lane..]);
                s.write(s.select(blends, transmittance, unset), &mut replay.transmittance.0[lane..]);

                let later = s.and_not(s.and(is_waiting, enough), blends);
                s.write(s.select(later, factor, one), &mut waiting.factor.0[lane..]);
                left |= s.bits(later);
            }
            if left != 0 {
                self.waiting[kept] = waiting;
                kept += 1;
            }
        }
        self.waiting.truncate(kept);
        let mut live = 0;
        for lane in (0..TILE).step_by(S::LANES) {
            let before = s.read(&front.0[lane..]);
            let done = s.at_least(depth, s.read(&self.stop.0[lane..]));
            let after = s.select(done, s.negative(before), before);
            s.write(after, &mut front.0[lane..]);
            live |= s.bits(s.at_least(after, zero));
        }
        (count, live == 0)
    }
}

#[cfg(test)]
mod tests {
    use glam::{DVec3, Vec3};
    use srflow_simd::Portable;

    use super::*;
    use crate::tests::scenes::{camera, moved, random};
    use crate::{Frame, Options, Rasterizer, Sorting};

    /// Pixels are done early because of this bound.
    #[test]
    fn no_splat_is_nearer_than_its_bound_at_a_pixel_that_it_reaches() {
        let (mut reached, mut tight) = (0, 0);
        for seed in 0..12 {
            let camera = Camera {
                fx: [90.0, 150.0, 40.0][seed % 3],
                ..moved(camera(), 0.1, 0.2, DVec3::new(0.1, 0.0, 0.1))
            };
            let mut gaussians = random(seed as u64, 200, 0);
            gaussians.scales.iter_mut().step_by(3).for_each(|scale| *scale *= Vec3::new(1.0, 3.0, 0.01));
            let mut rasterizer = Rasterizer::new();
            let options = Options { sorting: Sorting::PerPixel, ..Options::default() };
            let visible: Vec<bool> = rasterizer
                .render(&gaussians, &camera, None, &options, &mut Frame::new())
                .unwrap()
                .visible()
                .collect();
            for index in (0..visible.len()).filter(|&index| visible[index]) {
                let (peak, bound) = (rasterizer.peaks.peaks[index], rasterizer.peaks.nearest[index]);
                let splat = rasterizer.splats[index];
                let mut nearest = f32::INFINITY;
                for (left, top) in (0..camera.width)
                    .step_by(TILE)
                    .flat_map(|left| (0..camera.height).step_by(TILE).map(move |top| (left, top)))
                {
                    let (stripes, touched) = Stripes::new(Portable, &splat, left, top);
                    for row in (0..TILE).filter(|row| touched >> row & 1 == 1) {
                        let depths = peak.depths(left, top + row).0;
                        for vector in 0..TILE / Portable::LANES {
                            let hits = Portable.bits(stripes.alpha(Portable, vector, row).0);
                            for lane in (0..Portable::LANES).filter(|lane| hits >> lane & 1 == 1) {
                                nearest = nearest.min(depths[vector * Portable::LANES + lane]);
                            }
                        }
                    }
                }
                assert!(nearest >= bound, "{index}: {nearest} is nearer than {bound}");
                if nearest.is_finite() {
                    reached += 1;
                    let depth = splat.features[3];
                    tight += usize::from(depth - bound < 4.0 * (depth - nearest) + 0.02 * depth);
                }
            }
        }
        assert!(reached > 300 && tight * 2 > reached, "{reached} reached, {tight} bounds were tight");
    }
}
