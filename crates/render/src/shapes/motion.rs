//! Smooth motions of the plane that can be inverted.

use glam::{DMat2, DVec2};
use srflow_core::random::Stream;

/// Control points along a side of the grid of [`Bend`].
const POINTS: usize = 8;

/// The largest displacement of a control point over the distance between two of them. A displacement by cubic B-splines changes by at
/// most `2 * LARGEST_BEND` per pixel along each axis: less than one, so that the motion does not fold.
const LARGEST_BEND: f64 = 0.1;

/// Steps of Newton's method in [`Motion::inverse`].
const STEPS: usize = 2;

/// Where each point of frame 1 is in frame 2: a smooth bend, then a linear map about a centre, then a translation.
#[derive(Debug, Clone)]
pub struct Motion {
    linear: DMat2,
    /// Of `linear`.
    inverse_linear: DMat2,
    center: DVec2,
    translation: DVec2,
    bend: Option<Bend>,
}

/// A displacement by uniform cubic B-splines, periodic beyond its control points.
#[derive(Debug, Clone)]
struct Bend {
    /// Pixels between two control points.
    spacing: f64,
    points: Box<[[DVec2; POINTS]; POINTS]>,
}

impl Motion {
    /// A random motion that moves points within about `radius` px of `center` by about `length` px.
    pub fn random(center: DVec2, radius: f64, length: f64, stream: &mut Stream) -> Self {
        let mut normal = || f64::from(stream.normal());
        let translation = DVec2::new(normal(), normal()) * (0.7 * length);
        // Such that the rim moves by a share of `length`.
        let share = (0.3 * length / radius).min(0.12);
        let (turn, zoom, stretch) = (normal() * share, normal() * share, normal() * 0.5 * share);
        let (sin, cos) = (libm::sin(turn), libm::cos(turn));
        let rotation = DMat2::from_cols(DVec2::new(cos, sin), DVec2::new(-sin, cos));
        let [x, y] = [zoom + stretch, zoom - stretch].map(|log_scale| libm::exp(log_scale.clamp(-0.4, 0.4)));
        let shear = DMat2::from_cols(DVec2::X, DVec2::new((normal() * 0.5 * share).clamp(-0.4, 0.4), 1.0));
        let linear = rotation * shear * DMat2::from_diagonal(DVec2::new(x, y));
        let bend = (stream.unit() < 0.6).then(|| Bend::random(radius, length, stream));
        Self { linear, inverse_linear: linear.inverse(), center, translation, bend }
    }

    /// The point in frame 2 of a point of frame 1.
    pub fn forward(&self, point: DVec2) -> DVec2 {
        let bent = self.bend.as_ref().map_or(point, |bend| point + bend.at(point).0);
        self.linear * (bent - self.center) + self.center + self.translation
    }

    /// The point in frame 1 of a point of frame 2, to 1e-3 px.
    pub fn inverse(&self, point: DVec2) -> DVec2 {
        let bent = self.inverse_linear * (point - self.center - self.translation) + self.center;
        let Some(bend) = &self.bend else { return bent };
        let mut found = bent - bend.at(bent).0;
        for _ in 0..STEPS {
            let (displacement, derivative) = bend.at(found);
            let step = (DMat2::IDENTITY + derivative).inverse() * (found + displacement - bent);
            found -= step;
        }
        found
    }

    /// A rectangle of frame 2, as its least and greatest corner, that contains every point of one of frame 1.
    pub fn bounds(&self, [low, high]: [DVec2; 2]) -> [DVec2; 2] {
        let bend = self.bend.as_ref().map_or(0.0, Bend::reach);
        let (low, high) = (low - bend - self.center, high + bend - self.center);
        let corners = [low, DVec2::new(high.x, low.y), high, DVec2::new(low.x, high.y)];
        let moved = corners.map(|corner| self.linear * corner + self.center + self.translation);
        let least = moved.into_iter().fold(DVec2::INFINITY, DVec2::min);
        [least, moved.into_iter().fold(DVec2::NEG_INFINITY, DVec2::max)]
    }
}

impl Bend {
    fn random(radius: f64, length: f64, stream: &mut Stream) -> Self {
        let spacing = radius * f64::from(stream.uniform(0.25, 0.8));
        let reach = (length * f64::from(stream.uniform(0.1, 0.8))).min(LARGEST_BEND * spacing);
        let mut point = || DVec2::from([0; 2].map(|_| reach * f64::from(stream.uniform(-1.0, 1.0))));
        let points = Box::new([(); POINTS].map(|()| [(); POINTS].map(|()| point())));
        Self { spacing, points }
    }

    /// The largest displacement along either axis, px.
    fn reach(&self) -> f64 {
        LARGEST_BEND * self.spacing
    }

    /// The displacement of a point and its derivative.
    fn at(&self, point: DVec2) -> (DVec2, DMat2) {
        let place = point / self.spacing;
        let cell = place.floor();
        let [x, y] = (place - cell).to_array().map(cubic);
        // A conversion of what is not finite is some number too.
        let [column, row] = cell.to_array().map(|place| (place as i32).rem_euclid(POINTS as i32) as usize);
        let (mut value, mut along_x, mut along_y) = (DVec2::ZERO, DVec2::ZERO, DVec2::ZERO);
        for (j, (weight_y, slope_y)) in y.into_iter().enumerate() {
            let points = &self.points[(row + j) % POINTS];
            for (i, (weight_x, slope_x)) in x.into_iter().enumerate() {
                let point = points[(column + i) % POINTS];
                value += point * (weight_x * weight_y);
                along_x += point * (slope_x * weight_y);
                along_y += point * (weight_x * slope_y);
            }
        }
        (value, DMat2::from_cols(along_x, along_y) * (1.0 / self.spacing))
    }
}

/// The four weights of the uniform cubic B-spline, and their derivatives.
fn cubic(t: f64) -> [(f64, f64); 4] {
    let s = 1.0 - t;
    [
        (s * s * s / 6.0, -s * s / 2.0),
        ((3.0 * t * t * t - 6.0 * t * t + 4.0) / 6.0, (3.0 * t * t - 4.0 * t) / 2.0),
        ((3.0 * s * s * s - 6.0 * s * s + 4.0) / 6.0, -(3.0 * s * s - 4.0 * s) / 2.0),
        (t * t * t / 6.0, t * t / 2.0),
    ]
}

#[cfg(test)]
mod tests {
    use super::*;
    use srflow_core::random::Key;

    #[test]
    fn every_motion_is_smooth_and_inverted() {
        let mut bent = 0;
        for number in 0..300 {
            let mut stream = Key::new(4).scene(number).stream("motion");
            let length = 0.05 * libm::exp(f64::from(stream.uniform(0.0, 7.0)));
            let radius = f64::from(stream.uniform(4.0, 400.0));
            let motion = Motion::random(DVec2::new(200.0, 100.0), radius, length, &mut stream);
            bent += u32::from(motion.bend.is_some());
            for _ in 0..20 {
                let point =
                    DVec2::new(stream.uniform(-50.0, 562.0).into(), stream.uniform(-50.0, 434.0).into());
                let back = motion.inverse(motion.forward(point));
                assert!((back - point).length() < 1e-3, "{motion:?}: {point} {back}");
                let corner = DVec2::new(100.0, 50.0);
                let [low, high] = motion.bounds([corner, corner + 80.0]);
                let inside =
                    motion.forward(corner + 80.0 * DVec2::new(stream.unit().into(), stream.unit().into()));
                assert!(inside.cmpge(low).all() && inside.cmple(high).all(), "{motion:?}: {inside}");
                let Some(bend) = &motion.bend else { continue };
                let (displacement, derivative) = bend.at(point);
                assert!(displacement.abs().max_element() <= bend.reach());
                let step = 1e-4;
                for (axis, along) in [(DVec2::X, derivative.x_axis), (DVec2::Y, derivative.y_axis)] {
                    let difference = bend.at(point + axis * step).0 - bend.at(point - axis * step).0;
                    assert!((difference / (2.0 * step) - along).length() < 1e-5, "{along}");
                }
            }
        }
        assert!((100..260).contains(&bent));
    }
}
