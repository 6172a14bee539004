use glam::Vec3;

use super::curves::Spline;
use super::identity::Plan;

/// The head without features: a closed ring of skin at every station from the crown to the shoulders.
///
/// A ring consists of half an ellipse in front and half an ellipse behind, which meet at the sides.
#[derive(Debug)]
pub(super) struct Skull {
    rings: Spline<9>,
}

/// Front (y, z), side (x, y, z), back (y, z), fullness in front and behind, of each ring.
#[rustfmt::skip]
const RINGS: [[f32; 9]; 28] = [
    // front y, z      side x, y, z             back y, z         fullness
    [143.0, -10.0,     0.1, 143.0, -10.0,      143.0, -10.0,      0.00, 0.00],
    [141.3,  13.0,    22.0, 141.3, -11.0,      141.0, -34.0,      0.00, 0.00],
    [135.5,  35.0,    41.0, 135.5, -12.0,      134.5, -56.0,      0.01, 0.01],
    [125.5,  55.5,    56.5, 124.5, -12.0,      122.5, -74.5,      0.02, 0.02],
    [111.5,  73.5,    67.5, 109.0, -12.5,      106.5, -88.0,      0.03, 0.02],
    [ 95.0,  86.0,    73.3,  91.5, -13.0,       88.5, -96.0,      0.03, 0.02],
    [ 78.0,  93.3,    75.6,  73.5, -12.5,       70.0, -99.0,      0.03, 0.02],
    [ 62.0,  96.4,    75.7,  57.0, -11.0,       52.0, -97.7,      0.03, 0.02],
    [ 48.0,  97.2,    74.8,  43.5,  -8.5,       36.0, -93.7,      0.02, 0.02],
    [ 38.0,  96.6,    73.7,  33.5,  -6.0,       23.5, -89.2,      0.02, 0.02],
    [ 28.0,  95.6,    72.5,  24.0,  -3.5,       11.0, -84.3,      0.02, 0.02],
    [ 16.0,  94.8,    71.0,  13.0,  -0.5,       -3.0, -79.3,      0.02, 0.02],
    [  2.0,  94.9,    69.2,   1.0,   2.3,      -17.0, -74.6,      0.01, 0.02],
    [-11.0,  96.0,    67.3, -10.0,   4.4,      -29.0, -70.6,      0.00, 0.01],
    [-21.0,  97.2,    65.3, -18.0,   5.6,      -38.0, -67.6,     -0.01, 0.01],
    [-32.0,  98.4,    62.7, -26.5,   6.3,      -47.0, -65.1,     -0.02, 0.00],
    [-43.0,  98.6,    59.7, -35.0,   6.0,      -56.0, -63.0,     -0.03, 0.00],
    [-55.0,  97.0,    56.0, -44.0,   4.5,      -64.5, -62.0,     -0.04, 0.00],
    [-68.0,  96.0,    53.4, -53.5,   1.0,      -73.0, -61.8,     -0.05, 0.00],
    [-80.0,  93.8,    50.0, -63.0,  -4.5,      -81.5, -62.2,     -0.05, 0.00],
    [-88.5,  85.5,    46.2, -71.5, -10.5,      -89.5, -63.2,     -0.05, 0.00],
    [-93.5,  70.0,    43.2, -79.5, -16.0,      -97.5, -64.8,     -0.03, 0.00],
    [-99.0,  51.0,    41.8, -89.0, -20.0,     -107.0, -67.2,     -0.01, 0.00],
    [-115.0, 39.5,    42.6,-104.0, -24.5,     -121.0, -72.5,      0.00, 0.00],
    [-142.0, 33.5,    48.4,-126.0, -28.5,     -138.0, -82.0,      0.00, 0.00],
    [-170.0, 33.5,    71.0,-146.0, -32.0,     -159.0, -94.0,      0.00, 0.02],
    [-194.0, 44.0,   114.0,-170.0, -34.0,     -185.0,-101.5,      0.02, 0.04],
    [-222.0, 56.0,   158.0,-198.0, -34.0,     -215.0,-106.0,      0.04, 0.06],
];

/// Station after which the rings belong to the neck.
const NECK_START: usize = 21;

impl Skull {
    pub(super) fn new(plan: &Plan) -> Self {
        let rings: Vec<[f32; 9]> =
            RINGS.iter().enumerate().map(|(number, ring)| personal(plan, number, *ring)).collect();
        // Stations are spaced by the mean step of front and back, which makes the splines even.
        let mut knots = vec![0.0];
        for pair in rings.windows(2) {
            let step = |y: usize, z: usize| (pair[1][y] - pair[0][y]).hypot(pair[1][z] - pair[0][z]);
            knots.push(knots[knots.len() - 1] + 0.5 * (step(0, 1) + step(5, 6)));
        }
        Self { rings: Spline::through(knots, rings) }
    }

    /// The last station, at the shoulders.
    pub(super) fn end(&self) -> f32 {
        self.rings.end()
    }

    /// The skin at `station` and `azimuth` (0 in front, pi/2 on the left, pi behind).
    pub(super) fn point(&self, station: f32, azimuth: f32) -> Vec3 {
        let [front_y, front_z, side_x, side_y, side_z, back_y, back_z, front_full, back_full] =
            self.rings.at(station);
        let (sin, cos) = (libm::sinf(azimuth), libm::cosf(azimuth));
        let corner = 4.0 * sin * sin * cos * cos;
        let (y, z, full) =
            if cos >= 0.0 { (front_y, front_z, front_full) } else { (back_y, back_z, back_full) };
        let full = 1.0 + full * corner;
        Vec3::new(
            side_x * sin * full,
            side_y + (y - side_y) * cos * cos,
            side_z + (z - side_z) * cos.abs() * full,
        )
    }

    /// The station whose front is at height `y`.
    pub(super) fn station(&self, y: f32) -> f32 {
        let (mut low, mut high) = (0.0, self.end());
        for _ in 0..40 {
            let middle = 0.5 * (low + high);
            if self.rings.at(middle)[0] > y { low = middle } else { high = middle }
        }
        0.5 * (low + high)
    }

    /// Station and azimuth of the skin at `x` and `y` in front, found from an initial guess (Newton).
    pub(super) fn beneath(&self, x: f32, y: f32, guess: (f32, f32)) -> (f32, f32) {
        const STEP: (f32, f32) = (0.25, 0.004);
        let (mut station, mut azimuth) = guess;
        for _ in 0..6 {
            let here = self.point(station, azimuth);
            let down = (self.point(station + STEP.0, azimuth) - here) / STEP.0;
            let around = (self.point(station, azimuth + STEP.1) - here) / STEP.1;
            let (ex, ey) = (x - here.x, y - here.y);
            let determinant = down.x * around.y - around.x * down.y;
            station += (ex * around.y - around.x * ey) / determinant;
            azimuth += (down.x * ey - ex * down.y) / determinant;
        }
        (station, azimuth)
    }
}

/// One ring with the person's proportions.
fn personal(plan: &Plan, number: usize, ring: [f32; 9]) -> [f32; 9] {
    let t = &plan.traits;
    let [front_y, front_z, side_x, side_y, side_z, back_y, back_z, front_full, back_full] = ring;
    let crown = ((front_y - 60.0) / 80.0).clamp(0.0, 1.0);
    let cranium = ((side_y + 20.0) / 40.0).clamp(0.0, 1.0);
    let neck = ((number as f32 - NECK_START as f32 + 1.0) / 3.0).clamp(0.0, 1.0);
    let jaw = (1.0 - cranium) * (1.0 - neck);
    let lift = 3.5 * t.crown_height * crown * crown;
    let width = 1.0
        + 0.034 * t.head_width * (cranium + 0.5 * jaw)
        + 0.045 * t.jaw_width * jaw
        + 0.075 * t.neck_girth * neck;
    let slope = -3.0 * t.forehead_slope * (1.0 - ((front_y - 95.0) / 45.0).powi(2)).max(0.0);
    let chin = ((-50.0 - front_y) / 25.0).clamp(0.0, 1.0) * (1.0 - neck);
    let length = 1.0 + 0.034 * t.head_length;
    let girth = 1.0 + 0.05 * t.neck_girth * neck;
    [
        plan.height(front_y) + lift,
        (front_z + slope + 2.6 * t.chin_projection * chin) * (1.0 + (girth - 1.0)),
        side_x * width,
        plan.height(side_y) + lift,
        side_z,
        plan.height(back_y) + lift,
        back_z * length * girth,
        front_full + 0.012 * t.jaw_width * jaw,
        back_full,
    ]
}
