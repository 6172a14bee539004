//! The motion of a rigid surface in a flow that has other motions, too.

use rayon::prelude::*;

use crate::{FlowField, Plane, Size, dense};

/// Terms of a polynomial of the second degree: 1, x, y, x², xy, y².
const TERMS: usize = 6;

/// How often weights are computed from the rest, and a motion from the weights.
const ROUNDS: usize = 24;

/// Flow with this deviation, in pixels, is exact: the scale of weights never falls below it.
const LEAST_DEVIATION_PX: f64 = 1e-3;

/// Flow of a curved surface that moves a little, such as a head: a polynomial of the second degree of the place, which to first
/// order in the rotation is what a smooth surface shows in perspective.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SurfaceMotion {
    /// Of u and v, by term; x and y are -1 and 1 at the outermost pixels of the longer side.
    coefficients: [[f64; TERMS]; 2],
    size: Size,
    /// Deviation of the flow that follows the motion, per component, in pixels.
    deviation_px: f64,
}

impl SurfaceMotion {
    /// The motion that most of the flow follows: a fit with the weights of Geman and McClure, whose scale falls from the greatest rest
    /// to twice the deviation of the better half (graduated non-convexity: Black and Rangarajan, *On the unification of line
    /// processes, outlier rejection, and robust statistics in early vision*, IJCV 1996). `weights` of the same size count
    /// pixels; those of weight 0 and unknown flow are ignored. `None` if what remains has no two-dimensional extent.
    ///
    /// # Panics
    /// If the weights have another size.
    pub fn fit(flow: &FlowField, weights: Option<&Plane>) -> Option<Self> {
        let size = flow.size();
        assert!(weights.is_none_or(|weights| weights.size() == size), "weights have the size of the flow");
        let axis = Axis::of(size);
        let weight = |index: usize| weights.map_or(1.0, |weights| f64::from(weights.pixels()[index]));
        let known =
            |index: &usize| weight(*index) > 0.0 && flow.pixels()[*index].iter().all(|c| c.is_finite());
        let places: Vec<usize> = (0..flow.pixels().len()).filter(known).collect();
        let points: Vec<Point> = places
            .iter()
            .map(|&index| Point {
                terms: axis.terms(index % size.width, index / size.width),
                flow: flow.pixels()[index].map(f64::from),
                weight: weight(index),
            })
            .collect();
        let mut rests = vec![0.0; points.len()];
        let mut coefficients = [[0.0; TERMS]; 2];
        let mut scale = f64::INFINITY;
        let mut deviation_px = 0.0;
        for _ in 0..ROUNDS {
            coefficients = fitted(&points, &rests, scale)?;
            let rest = |point: &Point| {
                let [u, v] = at(&coefficients, &point.terms);
                (point.flow[0] - u).powi(2) + (point.flow[1] - v).powi(2)
            };
            points.par_iter().map(rest).collect_into_vec(&mut rests);
            deviation_px = deviation(&rests).max(LEAST_DEVIATION_PX);
            let greatest = rests.iter().copied().fold(0.0, f64::max).sqrt();
            scale = (scale / 2.0).min(greatest).max(2.0 * deviation_px);
        }
        Some(Self { coefficients, size, deviation_px })
    }

    /// At a pixel.
    pub fn at(&self, x: usize, y: usize) -> [f32; 2] {
        at(&self.coefficients, &Axis::of(self.size).terms(x, y)).map(|component| component as f32)
    }

    /// What remains of a flow of the same size.
    ///
    /// # Panics
    /// If it has another size.
    pub fn subtracted_from(&self, flow: &FlowField) -> FlowField {
        assert_eq!(flow.size(), self.size, "a motion belongs to the flow that it was fitted to");
        FlowField::from_fn(self.size.width, self.size.height, |x, y| {
            let ([u, v], [head_u, head_v]) = (flow.get(x, y), self.at(x, y));
            [u - head_u, v - head_v]
        })
    }

    /// In the middle, in pixels to the right and down.
    pub fn translation_px(&self) -> [f64; 2] {
        self.coefficients.map(|component| component[0])
    }

    /// In the middle, in degrees, clockwise as seen.
    pub fn rotation_degrees(&self) -> f64 {
        let [[_, _, u_y, ..], [_, v_x, ..]] = self.coefficients;
        ((v_x - u_y) / 2.0 / Axis::of(self.size).half).to_degrees()
    }

    /// Growth in the middle: 1.01 is larger by 1 %.
    pub fn scale(&self) -> f64 {
        let [[_, u_x, ..], [_, _, v_y, ..]] = self.coefficients;
        1.0 + (u_x + v_y) / 2.0 / Axis::of(self.size).half
    }

    /// Deviation of the flow that follows the motion, per component, in pixels.
    pub fn deviation_px(&self) -> f64 {
        self.deviation_px
    }
}

/// One pixel's flow.
struct Point {
    terms: [f64; TERMS],
    flow: [f64; 2],
    weight: f64,
}

/// Coordinates about the middle, 1 at the end of the longer side.
struct Axis {
    middle: [f64; 2],
    /// Pixels of 1.
    half: f64,
}

impl Axis {
    fn of(Size { width, height }: Size) -> Self {
        let middle = [width, height].map(|side| side.saturating_sub(1) as f64 / 2.0);
        Self { middle, half: middle[0].max(middle[1]).max(0.5) }
    }

    fn terms(&self, x: usize, y: usize) -> [f64; TERMS] {
        let (x, y) = ((x as f64 - self.middle[0]) / self.half, (y as f64 - self.middle[1]) / self.half);
        [1.0, x, y, x * x, x * y, y * y]
    }
}

fn at(coefficients: &[[f64; TERMS]; 2], terms: &[f64; TERMS]) -> [f64; 2] {
    coefficients.map(|component| component.iter().zip(terms).map(|(factor, term)| factor * term).sum())
}

/// Least squares with weights of squared `rests`.
fn fitted(points: &[Point], rests: &[f64], scale: f64) -> Option<[[f64; TERMS]; 2]> {
    // Six sums below the diagonal and two right sides of each chunk, added in order: the same for any number of threads.
    const CHUNK: usize = 4096;
    let sums = |(points, rests): (&[Point], &[f64])| {
        let (mut normal, mut right) = ([[0.0; TERMS]; TERMS], [[0.0; TERMS]; 2]);
        for (Point { terms, flow, weight }, rest) in points.iter().zip(rests) {
            let closeness = 1.0 / (1.0 + rest / (scale * scale));
            let weight = weight * closeness * closeness;
            for (i, term) in terms.iter().enumerate() {
                let weighted = weight * term;
                for (sum, other) in normal[i][..=i].iter_mut().zip(terms) {
                    *sum += weighted * other;
                }
                for (sums, component) in right.iter_mut().zip(flow) {
                    sums[i] += weighted * component;
                }
            }
        }
        (normal, right)
    };
    let chunks: Vec<_> = points.par_chunks(CHUNK).zip(rests.par_chunks(CHUNK)).map(sums).collect();
    let (mut normal, mut right) = (vec![0.0; TERMS * TERMS], [[0.0; TERMS]; 2]);
    for (of_chunk, right_of_chunk) in &chunks {
        normal.iter_mut().zip(of_chunk.as_flattened()).for_each(|(sum, value)| *sum += value);
        right
            .as_flattened_mut()
            .iter_mut()
            .zip(right_of_chunk.as_flattened())
            .for_each(|(sum, value)| *sum += value);
    }
    let largest = (0..TERMS).map(|i| normal[i * TERMS + i]).fold(0.0, f64::max);
    // Points on a line or few of them leave terms open: those are kept small.
    (0..TERMS).for_each(|i| normal[i * TERMS + i] += 1e-9 * largest);
    let inverse = dense::inverse(normal, TERMS)?;
    Some(right.map(|right| {
        let solved = dense::product(&inverse, &right, TERMS, 1);
        std::array::from_fn(|term| solved[term])
    }))
}

/// Deviation per component of the better half, from squared lengths of two normal components, whose median is 2 ln 2 variances.
fn deviation(rests: &[f64]) -> f64 {
    let mut rests = rests.to_vec();
    let middle = rests.len() / 2;
    let (_, median, _) = rests.select_nth_unstable_by(middle, f64::total_cmp);
    (*median / (2.0 * std::f64::consts::LN_2)).sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A head that moves by a polynomial, with an expression in a fifth of the frame and some unknown pixels.
    fn example() -> (FlowField, FlowField) {
        let head = FlowField::from_fn(80, 60, |x, y| {
            let (x, y) = (x as f32 / 80.0, y as f32 / 60.0);
            [0.4 + 0.3 * x - 0.2 * y + 0.1 * x * y, -0.2 + 0.1 * x + 0.25 * y - 0.05 * x * x]
        });
        let flow = FlowField::from_fn(80, 60, |x, y| {
            let ([u, v], expression) = (head.get(x, y), (20..50).contains(&x) && (10..40).contains(&y));
            match (expression, (x + y) % 97) {
                (_, 0) => [f32::NAN; 2],
                (true, _) => [u + 0.6, v - 0.9],
                (false, _) => [u, v],
            }
        });
        (head, flow)
    }

    #[test]
    fn most_of_the_flow_decides() {
        let (head, flow) = example();
        let motion = SurfaceMotion::fit(&flow, None).unwrap();
        let rest = motion.subtracted_from(&flow);
        for (x, y) in [(0, 0), (79, 59), (30, 20), (60, 30)] {
            let ([u, v], [found_u, found_v]) = (head.get(x, y), motion.at(x, y));
            assert!((u - found_u).abs() < 1e-3 && (v - found_v).abs() < 1e-3, "{x} {y}");
        }
        let [u, v] = rest.get(31, 25);
        assert!((u - 0.6).abs() < 1e-3 && (v + 0.9).abs() < 1e-3, "{u} {v}: the expression is left");
        assert!(motion.deviation_px() < 2e-3);
    }

    #[test]
    fn parts_that_do_not_count_do_not_decide() {
        let (_, flow) = example();
        let inside = Plane::from_fn(80, 60, |x, y| f32::from((25..45).contains(&x) && (15..35).contains(&y)));
        let rest = SurfaceMotion::fit(&flow, Some(&inside)).unwrap().subtracted_from(&flow);
        let [u, v] = rest.get(31, 25);
        assert!(u.abs() < 1e-3 && v.abs() < 1e-3, "{u} {v}: the expression is all that counts");
    }

    #[test]
    fn a_turn_and_a_growth_are_reported() {
        let (angle, growth) = (0.5_f32.to_radians(), 0.02);
        let flow = FlowField::from_fn(101, 51, |x, y| {
            let (x, y) = (x as f32 - 50.0, y as f32 - 25.0);
            [1.5 + growth * x - angle * y, -0.5 + angle * x + growth * y]
        });
        let motion = SurfaceMotion::fit(&flow, None).unwrap();
        let [x, y] = motion.translation_px();
        assert!((x - 1.5).abs() < 1e-4 && (y + 0.5).abs() < 1e-4);
        assert!((motion.rotation_degrees() - 0.5).abs() < 1e-3, "{}", motion.rotation_degrees());
        assert!((motion.scale() - 1.02).abs() < 1e-5, "{}", motion.scale());
    }

    #[test]
    fn without_known_flow_there_is_no_motion() {
        let nothing = FlowField::from_fn(9, 9, |_, _| [f32::NAN; 2]);
        assert_eq!(SurfaceMotion::fit(&nothing, None), None);
        assert_eq!(SurfaceMotion::fit(&FlowField::from_fn(0, 0, |_, _| [0.0; 2]), None), None);
        let one = SurfaceMotion::fit(&FlowField::from_fn(1, 1, |_, _| [0.25, 0.0]), None);
        assert!(one.is_some_and(|motion| (motion.at(0, 0)[0] - 0.25).abs() < 1e-4));
    }
}
