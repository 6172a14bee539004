//! Curves and falloffs shared by the sculpting stages. Lengths are in millimetres.

use glam::{Vec2, Vec3};

/// A natural cubic spline of `N` channels: smooth to the second derivative, so that shading shows no bands.
#[derive(Debug, Clone)]
pub(super) struct Spline<const N: usize> {
    knots: Vec<f32>,
    values: Vec<[f32; N]>,
    curvatures: Vec<[f32; N]>,
}

impl<const N: usize> Spline<N> {
    /// Through `values` at ascending `knots`; at least two.
    pub(super) fn through(knots: Vec<f32>, values: Vec<[f32; N]>) -> Self {
        let count = knots.len();
        // Second derivatives from the tridiagonal system of the natural spline (Thomas algorithm).
        let mut upper = vec![0.0_f32; count];
        let mut curvatures = vec![[0.0_f32; N]; count];
        for i in 1..count - 1 {
            let (before, after) = (knots[i] - knots[i - 1], knots[i + 1] - knots[i]);
            let pivot = 2.0 * (before + after) - before * upper[i - 1];
            upper[i] = after / pivot;
            curvatures[i] = std::array::from_fn(|c| {
                let rise = |from: usize| values[from + 1][c] - values[from][c];
                let bend = rise(i) / after - rise(i - 1) / before;
                (6.0 * bend - before * curvatures[i - 1][c]) / pivot
            });
        }
        for i in (1..count - 1).rev() {
            curvatures[i] = std::array::from_fn(|c| curvatures[i][c] - upper[i] * curvatures[i + 1][c]);
        }
        Self { knots, values, curvatures }
    }

    /// The value at `t`, constant beyond the ends.
    pub(super) fn at(&self, t: f32) -> [f32; N] {
        let last = self.knots.len() - 1;
        let t = t.clamp(self.knots[0], self.knots[last]);
        let i = self.knots.partition_point(|&knot| knot <= t).clamp(1, last) - 1;
        let width = self.knots[i + 1] - self.knots[i];
        let (a, b) = ((self.knots[i + 1] - t) / width, (t - self.knots[i]) / width);
        let (ka, kb) = ((a * a * a - a) * width * width / 6.0, (b * b * b - b) * width * width / 6.0);
        std::array::from_fn(|c| {
            a * self.values[i][c]
                + b * self.values[i + 1][c]
                + ka * self.curvatures[i][c]
                + kb * self.curvatures[i + 1][c]
        })
    }

    pub(super) fn end(&self) -> f32 {
        self.knots[self.knots.len() - 1]
    }
}

/// A smooth function through the given points, sorted by their first coordinate.
pub(super) fn curve(points: &[(f32, f32)]) -> Spline<1> {
    Spline::through(points.iter().map(|p| p.0).collect(), points.iter().map(|p| [p.1]).collect())
}

/// A bell over `[-1, 1]`: 1 at 0, and 0 with two continuous derivatives at and beyond the ends.
pub(super) fn bell(q: f32) -> f32 {
    let rest = (1.0 - q * q).max(0.0);
    rest * rest * rest
}

/// [`bell`] over an ellipse with half-axes `radii` about `center`.
pub(super) fn dome(point: Vec2, center: Vec2, radii: Vec2) -> f32 {
    let q = (point - center) / radii;
    let rest = (1.0 - q.length_squared()).max(0.0);
    rest * rest * rest
}

/// [`dome`] on the left plus its mirror image on the right, so that the sum is smooth across the midline. A dome on the
/// midline counts once.
pub(super) fn twin_dome(point: Vec2, center: Vec2, radii: Vec2) -> f32 {
    let here = dome(point, center, radii);
    if center.x == 0.0 { here } else { here + dome(point * Vec2::new(-1.0, 1.0), center, radii) }
}

/// [`bell`] of the distance to the segment `a`-`b`, over `radius`.
pub(super) fn ridge(point: Vec3, a: Vec3, b: Vec3, radius: f32) -> f32 {
    let along = ((point - a).dot(b - a) / (b - a).length_squared()).clamp(0.0, 1.0);
    bell(point.distance(a + (b - a) * along) / radius)
}

/// 0 below `low`, 1 above `high`, with two continuous derivatives between.
pub(super) fn smoothstep(low: f32, high: f32, x: f32) -> f32 {
    let t = ((x - low) / (high - low)).clamp(0.0, 1.0);
    t * t * t * (t * (t * 6.0 - 15.0) + 10.0)
}

/// The larger of two, smoothed over a difference of `softness`.
pub(super) fn smooth_max(a: f32, b: f32, softness: f32) -> f32 {
    let near = (softness - (a - b).abs()).max(0.0) / softness;
    a.max(b) + near * near * near * softness / 6.0
}

pub(super) fn lerp(a: f32, b: f32, t: f32) -> f32 {
    a + (b - a) * t
}
