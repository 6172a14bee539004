//! How well an estimate shows the motion of an expression, apart from that of the head.

use serde::{Deserialize, Serialize};
use srflow_core::{FlowField, Mask, Size};

/// The motion that remains when that of the head is taken away: of each flow its best affine fit within the head. For one pair,
/// or the mean over pairs.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct Expression {
    /// Correlation of the estimated motion with the true one, both components together: 1 at best, 0 for motion that has nothing to do
    /// with it, and for none at all.
    pub correlation: f64,
    /// Length of the estimated motion along the true one, relative to the true one: 1 at best, less when it is smoothed away.
    pub strength: f64,
    /// Root mean square of the true motion in pixels.
    pub true_rms: f64,
}

impl Expression {
    /// Of the pixels of `head`, or of all pixels, where both flows are known. All are of one size. `None` where the true flow is affine,
    /// or too few pixels are known.
    pub(crate) fn of(estimate: &FlowField, truth: &FlowField, head: Option<&Mask>) -> Option<Self> {
        let Size { width, height } = truth.size();
        let places = (0..height).flat_map(|y| (0..width).map(move |x| (x, y)));
        let counts = |&(x, y): &(usize, usize)| {
            head.is_none_or(|head| head.get(x, y)) && truth.is_known(x, y) && estimate.is_known(x, y)
        };
        let places: Vec<(usize, usize)> = places.filter(counts).collect();
        let fit = AffineFit::new(&places)?;
        let mut sums = [0.0; 3];
        for axis in [0, 1] {
            let rest = |flow: &FlowField| {
                let values = places.iter().map(|&(x, y)| f64::from(flow.get(x, y)[axis]));
                fit.rest(values.collect())
            };
            for (estimated, true_) in rest(estimate).into_iter().zip(rest(truth)) {
                sums[0] += estimated * true_;
                sums[1] += estimated * estimated;
                sums[2] += true_ * true_;
            }
        }
        let [product, estimated, true_] = sums;
        let true_rms = (true_ / places.len() as f64).sqrt();
        // Rounding alone leaves less than this of an affine flow.
        const LEAST: f64 = 1e-5;
        if true_rms < LEAST {
            return None;
        }
        let moves = estimated / places.len() as f64 > LEAST * LEAST;
        let correlation = if moves { product / (estimated * true_).sqrt() } else { 0.0 };
        Some(Self { correlation, strength: product / true_, true_rms })
    }

    /// The mean over pairs; `None` without pairs.
    pub(crate) fn mean(pairs: impl Iterator<Item = Self>) -> Option<Self> {
        let (mut sum, mut count) = (Self::default(), 0.0);
        for Self { correlation, strength, true_rms } in pairs {
            sum.correlation += correlation;
            sum.strength += strength;
            sum.true_rms += true_rms;
            count += 1.0;
        }
        let Self { correlation, strength, true_rms } = sum;
        (count > 0.0).then(|| Self {
            correlation: correlation / count,
            strength: strength / count,
            true_rms: true_rms / count,
        })
    }
}

/// Least squares of `a + b x + c y` over a set of pixels.
struct AffineFit {
    /// Of each pixel, relative to the centre of all.
    places: Vec<[f64; 2]>,
    /// Inverse of the matrix of their second moments.
    inverse: [[f64; 2]; 2],
}

impl AffineFit {
    /// `None` when the pixels lie on a line.
    fn new(places: &[(usize, usize)]) -> Option<Self> {
        let count = places.len().max(1) as f64;
        let mean = |of: fn(&(usize, usize)) -> usize| {
            places.iter().map(|place| of(place) as f64).sum::<f64>() / count
        };
        let centre = [mean(|place| place.0), mean(|place| place.1)];
        let places: Vec<[f64; 2]> =
            places.iter().map(|&(x, y)| [x as f64 - centre[0], y as f64 - centre[1]]).collect();
        let moment = |a: usize, b: usize| places.iter().map(|place| place[a] * place[b]).sum::<f64>();
        let [xx, xy, yy] = [moment(0, 0), moment(0, 1), moment(1, 1)];
        let determinant = xx * yy - xy * xy;
        // At least 1/4 for pixels that do not lie on a line.
        (determinant > 0.1).then(|| {
            let inverse = [[yy, -xy], [-xy, xx]].map(|row| row.map(|entry| entry / determinant));
            Self { places, inverse }
        })
    }

    /// What the best fit leaves of a value at each pixel.
    fn rest(&self, mut values: Vec<f64>) -> Vec<f64> {
        let mean = values.iter().sum::<f64>() / values.len() as f64;
        let product =
            |axis: usize| self.places.iter().zip(&values).map(|(place, value)| place[axis] * value).sum();
        let products: [f64; 2] = [product(0), product(1)];
        let slope = self.inverse.map(|row| row[0] * products[0] + row[1] * products[1]);
        for (place, value) in self.places.iter().zip(&mut values) {
            *value -= mean + slope[0] * place[0] + slope[1] * place[1];
        }
        values
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const SIZE: Size = Size::new(24, 20);

    fn flow(of: impl Fn(f32, f32) -> [f32; 2]) -> FlowField {
        FlowField::from_fn(SIZE.width, SIZE.height, |x, y| of(x as f32, y as f32))
    }

    fn expression(x: f32, y: f32) -> [f32; 2] {
        [0.2 * (0.9 * x).sin() * (0.7 * y).cos(), 0.1 * (0.8 * y).sin()]
    }

    fn with_head_motion(x: f32, y: f32) -> [f32; 2] {
        let [u, v] = expression(x, y);
        [u + 1.5 + 0.1 * x - 0.05 * y, v - 0.5 + 0.02 * x + 0.03 * y]
    }

    #[test]
    fn the_motion_of_the_head_does_not_count() {
        let truth = flow(with_head_motion);
        let close = |found: Option<Expression>, correlation: f64, strength: f64| {
            let found = found.expect("an expression");
            assert!((found.correlation - correlation).abs() < 1e-3, "{found:?}");
            assert!((found.strength - strength).abs() < 1e-3, "{found:?}");
        };
        close(Expression::of(&flow(expression), &truth, None), 1.0, 1.0);
        let half = flow(|x, y| expression(x, y).map(|x| 0.5 * x));
        close(Expression::of(&half, &truth, None), 1.0, 0.5);
        let opposite = flow(|x, y| with_head_motion(x, y).map(|x| -x));
        close(Expression::of(&opposite, &truth, None), -1.0, -1.0);
        let drift = flow(|x, y| [1.5 + 0.1 * x, -0.05 * y]);
        close(Expression::of(&drift, &truth, None), 0.0, 0.0);
        assert_eq!(Expression::of(&truth, &drift, None), None, "no expression to find");
    }

    #[test]
    fn only_known_pixels_of_the_head_count() {
        let head = Mask::from_fn(SIZE.width, SIZE.height, |x, _| x < 12);
        let outside = flow(|x, y| if x < 12.0 { expression(x, y) } else { [9.0, x * y] });
        let found = Expression::of(&outside, &flow(with_head_motion), Some(&head)).expect("an expression");
        assert!((found.correlation - 1.0).abs() < 1e-3, "{found:?}");
        let unknown = flow(|_, _| [f32::NAN; 2]);
        assert_eq!(Expression::of(&flow(expression), &unknown, None), None);
        let line = Mask::from_fn(SIZE.width, SIZE.height, |_, y| y == 3);
        assert_eq!(Expression::of(&flow(expression), &flow(expression), Some(&line)), None);
    }
}
