//! Smooth curves through random points, for cameras and heads.

/// A curve of `N` coordinates through equally spaced points, at rest at both ends and with continuous acceleration: a clamped
/// cubic spline. It uses additions, multiplications and divisions only, so its bits are the same everywhere.
#[derive(Debug, Clone)]
pub struct Path<const N: usize> {
    points: Vec<[f64; N]>,
    /// Derivative with respect to the point index, at each point.
    slopes: Vec<[f64; N]>,
}

impl<const N: usize> Path<N> {
    /// The curve through `points`, at rest at the first and the last.
    pub fn through(points: Vec<[f64; N]>) -> Self {
        let mut path = Self { slopes: vec![[0.0; N]; points.len()], points };
        for axis in 0..N {
            path.solve_slopes(axis);
        }
        path
    }

    /// Slopes that make the second derivative continuous: `s[i-1] + 4 s[i] + s[i+1] = 3 (p[i+1] - p[i-1])`, by the Thomas
    /// algorithm; the outer ones stay zero.
    fn solve_slopes(&mut self, axis: usize) {
        let last = self.points.len().saturating_sub(1);
        let mut ratios = vec![0.0; last.max(1)];
        for i in 1..last {
            let wanted = 3.0 * (self.points[i + 1][axis] - self.points[i - 1][axis]);
            let pivot = 4.0 - ratios[i - 1];
            ratios[i] = 1.0 / pivot;
            self.slopes[i][axis] = (wanted - self.slopes[i - 1][axis]) / pivot;
        }
        for i in (1..last).rev() {
            self.slopes[i][axis] -= ratios[i] * self.slopes[i + 1][axis];
        }
    }

    /// The curve at `t`, 0 at the first point and 1 at the last.
    pub fn at(&self, t: f64) -> [f64; N] {
        let last = self.points.len() - 1;
        let place = (t * last as f64).max(0.0);
        if place >= last as f64 {
            return self.points[last]; // exact, without the polynomial's rounding
        }
        let i = place as usize;
        let x = place - i as f64;
        std::array::from_fn(|axis| {
            let (p0, p1) = (self.points[i][axis], self.points[i + 1][axis]);
            let (s0, s1) = (self.slopes[i][axis], self.slopes[i + 1][axis]);
            let rise = p1 - p0;
            p0 + x * (s0 + x * ((3.0 * rise - 2.0 * s0 - s1) + x * (s0 + s1 - 2.0 * rise)))
        })
    }

    /// The same curve, every point multiplied by `factor`.
    pub fn scaled(mut self, factor: f64) -> Self {
        for value in self.points.iter_mut().chain(&mut self.slopes).flatten() {
            *value *= factor;
        }
        self
    }

    /// The greatest step of any coordinate between neighbours among `steps + 1` equally spaced moments.
    pub fn greatest_step(&self, steps: u32) -> f64 {
        let at = |step: u32| self.at(f64::from(step) / f64::from(steps));
        let step = |step: u32| {
            let (a, b) = (at(step), at(step + 1));
            a.iter().zip(b).map(|(a, b)| (b - a).abs()).fold(0.0, f64::max)
        };
        (0..steps).map(step).fold(0.0, f64::max)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn path() -> Path<2> {
        Path::through(vec![[0.0, 0.0], [10.0, -3.0], [4.0, 5.0], [-8.0, 2.0], [0.0, 0.0]])
    }

    #[test]
    fn passes_through_its_points() {
        let path = path();
        for (i, point) in [[0.0, 0.0], [10.0, -3.0], [4.0, 5.0], [-8.0, 2.0], [0.0, 0.0]].iter().enumerate() {
            let at = path.at(i as f64 / 4.0);
            assert!((at[0] - point[0]).abs() < 1e-12 && (at[1] - point[1]).abs() < 1e-12, "{at:?} {point:?}");
        }
    }

    #[test]
    fn starts_and_ends_at_rest_with_continuous_acceleration() {
        let path = path();
        let h = 1e-4;
        let speed = |t: f64| (path.at(t + h)[0] - path.at(t - h)[0]) / (2.0 * h);
        let bend = |t: f64| (path.at(t + h)[0] - 2.0 * path.at(t)[0] + path.at(t - h)[0]) / (h * h);
        assert!((path.at(h)[0] / h).abs() < 0.1 && (path.at(1.0 - h)[0] / h).abs() < 0.1);
        for knot in [0.25, 0.5, 0.75] {
            assert!((speed(knot + 2.0 * h) - speed(knot - 2.0 * h)).abs() < 1.0, "speed at {knot}");
            assert!((bend(knot + 2.0 * h) - bend(knot - 2.0 * h)).abs() < 10.0, "acceleration at {knot}");
        }
    }

    #[test]
    fn scaling_scales_the_greatest_step() {
        let step = path().greatest_step(50);
        assert!(step > 0.5 && (path().scaled(0.25).greatest_step(50) - step / 4.0).abs() < 1e-12);
    }

    #[test]
    fn a_single_point_stays() {
        assert_eq!(Path::through(vec![[2.0]]).at(0.7), [2.0]);
    }
}
