//! Polynomial expansion: around each pixel the image is fitted by `d^T A d + b^T d + c`, `d` the offset in pixels.

/// The fit at one pixel. `A` is `[[xx, xy / 2], [xy / 2, yy]]` and `b` is `[x, y]`; `c` is not kept.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Polynomial {
    pub x: f32,
    pub y: f32,
    pub xx: f32,
    pub yy: f32,
    pub xy: f32,
}

/// The weights of a fit: a normalised Gaussian `g` and what is needed of the inverse of its moment matrix.
#[derive(Debug, Clone)]
pub struct ExpansionKernel {
    /// `g(k)`, `k g(k)` and `k^2 g(k)` for `k` from 0 to the radius.
    pub g: Vec<[f32; 3]>,
    /// Entries of the inverse moment matrix.
    pub inverse: InverseMoments,
}

/// Entries of the inverse moment matrix of the basis 1, x, y, x^2, y^2, xy. The weight being separable, x^2 and y^2
/// do not mix.
#[derive(Debug, Clone, Copy)]
pub struct InverseMoments {
    /// (x, x) and (y, y).
    pub linear: f32,
    /// (1, x^2) and (1, y^2).
    pub constant_square: f32,
    /// (x^2, x^2) and (y^2, y^2).
    pub square: f32,
    /// (xy, xy).
    pub mixed: f32,
}

impl ExpansionKernel {
    /// `None` when the weight is so narrow that the moments cannot be inverted.
    pub fn new(radius: usize, sigma: f64) -> Option<Self> {
        let sigma = if sigma < f64::from(f32::EPSILON) { radius as f64 * 0.3 } else { sigma };
        let weights: Vec<f64> =
            (0..=radius).map(|k| libm::exp(-((k * k) as f64) / (2.0 * sigma * sigma))).collect();
        let sum = weights[0] + 2.0 * weights[1..].iter().sum::<f64>();
        let g: Vec<[f32; 3]> = (0_u16..)
            .zip(&weights)
            .map(|(k, weight)| {
                let (k, g) = (f32::from(k), (weight / sum) as f32);
                [g, k * g, k * k * g]
            })
            .collect();

        let moment = |power| {
            (1_u16..).zip(&g[1..]).map(|(k, g)| 2.0 * f64::from(g[0]) * f64::from(k).powi(power)).sum()
        };
        let (second, fourth): (f64, f64) = (moment(2), moment(4));
        let spread = fourth - second * second;
        let inverse = InverseMoments {
            linear: (1.0 / second) as f32,
            constant_square: (-second / spread) as f32,
            square: (1.0 / spread) as f32,
            mixed: (1.0 / (second * second)) as f32,
        };
        let finite = [inverse.linear, inverse.constant_square, inverse.square, inverse.mixed];
        finite.iter().all(|entry| entry.is_finite()).then_some(Self { g, inverse })
    }
}
