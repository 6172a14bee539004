//! Curves of motion.

use srflow_core::random::Stream;

/// A random curve band-limited by its knots: a uniform cubic B-spline.
#[derive(Debug, Clone)]
pub(super) struct Curve {
    knot_seconds: f32,
    knots: Vec<f32>,
}

impl Curve {
    pub fn random(stream: &mut Stream, seconds: f32, knot_seconds: f32, reach: f32) -> Self {
        let count = (seconds / knot_seconds).min(1e6) as usize + 4;
        Self { knot_seconds, knots: (0..count).map(|_| stream.uniform(-reach, reach)).collect() }
    }

    pub fn at(&self, time: f32) -> f32 {
        let position = (time / self.knot_seconds).clamp(0.0, (self.knots.len() - 4) as f32);
        let first = position as usize;
        let t = position - first as f32;
        let basis = [
            (1.0 - t) * (1.0 - t) * (1.0 - t),
            3.0 * t * t * t - 6.0 * t * t + 4.0,
            3.0 * (t + t * t - t * t * t) + 1.0,
            t * t * t,
        ];
        self.knots[first..].iter().zip(basis).map(|(knot, weight)| knot * weight / 6.0).sum()
    }
}

/// 0 up to 0, 1 from 1 on, and between them a step with continuous velocity and acceleration.
pub fn quintic(t: f32) -> f32 {
    let t = t.clamp(0.0, 1.0);
    t * t * t * (t * (t * 6.0 - 15.0) + 10.0)
}
