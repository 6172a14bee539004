//! The outlines of layers.

use glam::DVec2;
use srflow_core::random::Stream;

/// What a layer covers in frame 1, in pixels.
#[derive(Debug, Clone)]
pub enum Outline {
    /// The whole plane.
    Everywhere,
    /// A closed curve about its centre whose radius is a sum of waves.
    Blob { center: DVec2, radius: f64, waves: Vec<Wave> },
    /// A polygon with straight sides, its corners in turn.
    Polygon(Vec<DVec2>),
    /// A thin thing: a line through these points, of this width.
    Stroke { points: Vec<DVec2>, width: f64 },
}

/// One wave of a blob's radius: `share * cos(number * angle + phase)`, relative to the mean radius.
#[derive(Debug, Clone, Copy)]
pub struct Wave {
    share: f64,
    number: f64,
    phase: f64,
}

/// Pixels from the border beyond which its exact distance does not matter: more than the width of soft borders.
const FAR: f64 = 4.0;

impl Outline {
    /// A random outline about `center`, which reaches about `radius` px from it.
    pub fn random(center: DVec2, radius: f64, stream: &mut Stream) -> Self {
        match stream.below(10) {
            0..5 => {
                let wave = |number: u32| Wave {
                    share: f64::from(stream.uniform(0.0, 0.6)) / f64::from(number * number).max(2.0),
                    number: f64::from(number),
                    phase: f64::from(stream.uniform(0.0, std::f32::consts::TAU)),
                };
                Self::Blob { center, radius, waves: (2..7).map(wave).collect() }
            }
            5..8 => {
                let corners = 3 + stream.below(6);
                let turn = f64::from(stream.unit());
                let corner = |number: u32| {
                    let angle = std::f64::consts::TAU * (f64::from(number) + turn) / f64::from(corners);
                    let reach = radius * f64::from(stream.uniform(0.45, 1.2));
                    center + reach * DVec2::new(libm::cos(angle), libm::sin(angle))
                };
                Self::Polygon((0..corners).map(corner).collect())
            }
            _ => {
                let mut direction = f64::from(stream.uniform(0.0, std::f32::consts::TAU));
                let segments = 2 + stream.below(6);
                let mut at = center - radius * DVec2::new(libm::cos(direction), libm::sin(direction));
                let mut points = vec![at];
                for _ in 0..segments {
                    at += 2.0 * radius / f64::from(segments)
                        * DVec2::new(libm::cos(direction), libm::sin(direction));
                    points.push(at);
                    direction += 0.5 * f64::from(stream.normal());
                }
                Self::Stroke { points, width: f64::from(stream.uniform(1.2, 8.0)) }
            }
        }
    }

    /// Distance of a point from the outline in pixels, negative inside. Exact near the sides of polygons and strokes, and to first
    /// order near a blob.
    pub fn distance(&self, point: DVec2) -> f64 {
        match self {
            Self::Everywhere => f64::NEG_INFINITY,
            Self::Blob { center, radius, waves } => {
                let offset = point - *center;
                let distance = offset.length();
                // Far from the border, where alone it must be exact, without its angle.
                let spread: f64 = waves.iter().map(|wave| wave.share).sum();
                let [from_least, from_most] =
                    [1.0 - spread, 1.0 + spread].map(|reach| distance - radius * reach);
                if from_least < -FAR || from_most > FAR {
                    return if from_least < 0.0 { from_least } else { from_most };
                }
                let angle = libm::atan2(offset.y, offset.x);
                let (mut reach, mut slope) = (1.0, 0.0);
                for Wave { share, number, phase } in waves {
                    let (sin, cos) = libm::sincos(number * angle + phase);
                    reach += share * cos;
                    slope -= share * number * sin;
                }
                // The side is as steep as the radius changes with the angle.
                let reach = reach.max(0.05);
                (distance - radius * reach) / (1.0 + (slope / reach) * (slope / reach)).sqrt()
            }
            Self::Polygon(corners) => {
                let (mut nearest, mut inside) = (f64::INFINITY, false);
                for (number, &b) in corners.iter().enumerate() {
                    let a = corners[(number + corners.len() - 1) % corners.len()];
                    nearest = nearest.min(segment_distance_squared(point, a, b));
                    let crosses = (a.y > point.y) != (b.y > point.y);
                    if crosses && point.x < (b.x - a.x) * (point.y - a.y) / (b.y - a.y) + a.x {
                        inside = !inside;
                    }
                }
                if inside { -nearest.sqrt() } else { nearest.sqrt() }
            }
            Self::Stroke { points, width } => {
                let squared = points.windows(2).map(|ends| segment_distance_squared(point, ends[0], ends[1]));
                squared.fold(f64::INFINITY, f64::min).sqrt() - 0.5 * width
            }
        }
    }

    /// The smallest upright rectangle that this function knows to contain the layer, as its least and greatest corner; `None` for
    /// the whole plane.
    pub fn bounds(&self) -> Option<[DVec2; 2]> {
        let around = |points: &[DVec2], margin: f64| {
            let low = points.iter().fold(DVec2::INFINITY, |low, point| low.min(*point));
            let high = points.iter().fold(DVec2::NEG_INFINITY, |high, point| high.max(*point));
            Some([low - margin, high + margin])
        };
        match self {
            Self::Everywhere => None,
            Self::Blob { center, radius, waves } => {
                let reach = radius * (1.0 + waves.iter().map(|wave| wave.share).sum::<f64>());
                around(&[*center], reach)
            }
            Self::Polygon(corners) => around(corners, 0.0),
            Self::Stroke { points, width } => around(points, 0.5 * width),
        }
    }
}

fn segment_distance_squared(point: DVec2, a: DVec2, b: DVec2) -> f64 {
    let (side, offset) = (b - a, point - a);
    let along = (offset.dot(side) / side.length_squared().max(1e-12)).clamp(0.0, 1.0);
    (offset - along * side).length_squared()
}

#[cfg(test)]
mod tests {
    use super::*;
    use srflow_core::random::Key;

    #[test]
    fn outlines_lie_within_their_bounds_and_distances_change_by_at_most_the_way() {
        for number in 0..200 {
            let mut stream = Key::new(2).scene(number).stream("outline");
            let outline = Outline::random(DVec2::new(60.0, 40.0), 30.0, &mut stream);
            let [low, high] = outline.bounds().unwrap();
            let mut inside = 0;
            for y in (-40..120).step_by(2) {
                for x in (-40..160).step_by(2) {
                    let point = DVec2::new(f64::from(x), f64::from(y));
                    let distance = outline.distance(point);
                    if distance < 0.0 {
                        inside += 1;
                        assert!(point.cmpge(low).all() && point.cmple(high).all(), "{outline:?}: {point}");
                    }
                    // Only near its border is a blob's distance one.
                    if matches!(outline, Outline::Blob { .. }) && distance.abs() > 2.0 {
                        continue;
                    }
                    let step = DVec2::new(0.3, -0.4);
                    let change = (outline.distance(point + step) - distance).abs();
                    let most = if matches!(outline, Outline::Blob { .. }) { 1.0 } else { 0.5 + 1e-9 };
                    assert!(change <= most, "{outline:?}: {change} at {point}");
                }
            }
            assert!(inside > 5, "{outline:?}");
        }
        assert_eq!(Outline::Everywhere.bounds(), None);
        assert!(Outline::Everywhere.distance(DVec2::ZERO) < -1e9);
    }

    #[test]
    fn distances_from_a_square_and_a_line_are_known() {
        let corners = [(0.0, 0.0), (10.0, 0.0), (10.0, 10.0), (0.0, 10.0)].map(|(x, y)| DVec2::new(x, y));
        let square = Outline::Polygon(corners.to_vec());
        for (x, y, expected) in [(5.0, 5.0, -5.0), (2.0, 5.0, -2.0), (13.0, 5.0, 3.0), (13.0, 14.0, 5.0)] {
            assert!((square.distance(DVec2::new(x, y)) - expected).abs() < 1e-12);
        }
        let line = Outline::Stroke { points: vec![corners[0], corners[1]], width: 4.0 };
        for (x, y, expected) in [(5.0, 0.0, -2.0), (5.0, 3.0, 1.0), (-3.0, 0.0, 1.0)] {
            assert!((line.distance(DVec2::new(x, y)) - expected).abs() < 1e-12);
        }
        let blob = Outline::Blob { center: corners[0], radius: 7.0, waves: Vec::new() };
        assert!((blob.distance(DVec2::new(3.0, 4.0)) + 2.0).abs() < 1e-12);
    }
}
