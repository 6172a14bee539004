use glam::Vec3;

use super::curves::Spline;
use super::identity::Plan;

/// The head without its features: a closed ring of skin at every station from the crown to the shoulders.
///
/// A ring is half an ellipse in front and half an ellipse behind, which meet at the sides.
#[derive(Debug)]
pub(super) struct Skull {
    rings: Spline<9>,
}

/// Front (y, z), side (x, y, z), back (y, z), fullness in front and behind, of each ring.
#[rustfmt::skip]
const RINGS: [[f32; 9]; 28] = [
    // front y, z      side x, y, z             back y, z         fullness
    [141.0,  -8.0,     0.1, 141.0,  -8.0,      141.0,  -8.0,      0.00, 0.00],
    [139.5,  18.0,    24.0, 139.5,  -9.0,      139.3, -36.0,      0.00, 0.00],
    [134.0,  40.0,    44.0, 134.0, -10.0,      133.5, -58.0,      0.01, 0.01],
    [124.0,  60.0,    59.5, 123.0, -11.0,      122.0, -76.0,      0.03, 0.02],
    [110.0,  77.0,    69.0, 108.0, -12.0,      106.0, -89.0,      0.04, 0.02],
    [ 94.0,  88.5,    74.0,  91.0, -13.0,       88.0, -96.5,      0.04, 0.02],
    [ 77.0,  94.8,    76.0,  73.0, -13.0,       70.0, -99.0,      0.04, 0.02],
    [ 61.0,  97.0,    75.8,  57.0, -12.0,       52.0, -97.5,      0.03, 0.02],
    [ 48.0,  97.3,    74.6,  44.0,  -9.0,       36.0, -93.5,      0.02, 0.02],
    [ 38.0,  92.5,    73.0,  34.0,  -6.0,       22.0, -88.5,      0.02, 0.02],
    [ 28.0,  87.5,    71.6,  25.0,  -3.0,       10.0, -83.5,      0.03, 0.02],
    [ 16.0,  87.0,    70.4,  13.0,   0.0,       -2.0, -79.0,      0.03, 0.02],
    [  2.0,  90.0,    69.2,   1.0,   2.0,      -16.0, -75.0,      0.02, 0.02],
    [-11.0,  94.0,    67.6, -10.0,   4.0,      -28.0, -72.0,      0.00, 0.01],
    [-21.0,  96.8,    65.6, -18.0,   6.0,      -37.0, -70.3,     -0.01, 0.01],
    [-32.0,  98.6,    63.2, -26.0,   7.0,      -46.0, -69.3,     -0.02, 0.00],
    [-43.0,  98.6,    60.6, -35.0,   7.0,      -55.0, -68.8,     -0.02, 0.00],
    [-55.0,  96.4,    57.8, -44.0,   6.0,      -63.0, -68.6,     -0.02, 0.00],
    [-68.0,  96.0,    55.2, -53.0,   3.0,      -71.0, -68.7,     -0.03, 0.00],
    [-80.0,  94.0,    53.2, -61.0,  -2.0,      -79.0, -69.2,     -0.04, 0.00],
    [-88.5,  85.5,    52.2, -68.0,  -8.0,      -87.0, -70.2,     -0.04, 0.00],
    [-93.5,  70.0,    52.2, -76.0, -14.0,      -96.0, -71.8,     -0.03, 0.00],
    [-99.0,  51.0,    52.8, -86.0, -19.0,     -106.0, -74.0,     -0.01, 0.00],
    [-115.0, 39.5,    54.0,-104.0, -24.0,     -120.0, -78.0,      0.00, 0.00],
    [-142.0, 33.5,    57.0,-126.0, -28.0,     -137.0, -84.5,      0.00, 0.00],
    [-170.0, 33.5,    74.0,-146.0, -32.0,     -158.0, -93.0,      0.00, 0.02],
    [-194.0, 44.0,   116.0,-170.0, -34.0,     -185.0,-101.0,      0.02, 0.04],
    [-222.0, 56.0,   158.0,-198.0, -34.0,     -215.0,-106.0,      0.04, 0.06],
];

/// Station after which the rings belong to the neck.
const NECK_START: usize = 21;

impl Skull {
    pub(super) fn new(plan: &Plan) -> Self {
        let rings: Vec<[f32; 9]> =
            RINGS.iter().enumerate().map(|(number, ring)| personal(plan, number, *ring)).collect();
        // Stations are spaced by the mean step of front and back, so that the splines run evenly.
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

    /// The station whose front lies at height `y`.
    pub(super) fn station(&self, y: f32) -> f32 {
        let (mut low, mut high) = (0.0, self.end());
        for _ in 0..40 {
            let middle = 0.5 * (low + high);
            if self.rings.at(middle)[0] > y { low = middle } else { high = middle }
        }
        0.5 * (low + high)
    }

    /// Station and azimuth of the skin that lies at `x` and `y` in front, found from a guess nearby (Newton).
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

/// One ring with a person's proportions.
fn personal(plan: &Plan, number: usize, ring: [f32; 9]) -> [f32; 9] {
    let t = &plan.traits;
    let [front_y, front_z, side_x, side_y, side_z, back_y, back_z, front_full, back_full] = ring;
    let crown = ((front_y - 60.0) / 80.0).clamp(0.0, 1.0);
    let cranium = ((side_y + 20.0) / 40.0).clamp(0.0, 1.0);
    let neck = ((number as f32 - NECK_START as f32 + 1.0) / 3.0).clamp(0.0, 1.0);
    let jaw = (1.0 - cranium) * (1.0 - neck);
    let lift = 3.5 * t.crown_height * crown * crown;
    let width = 1.0
        + 0.028 * t.head_width * (cranium + 0.5 * jaw)
        + 0.035 * t.jaw_width * jaw
        + 0.055 * t.neck_girth * neck;
    let slope = -3.0 * t.forehead_slope * (1.0 - ((front_y - 95.0) / 45.0).powi(2)).max(0.0);
    let chin = ((-50.0 - front_y) / 25.0).clamp(0.0, 1.0) * (1.0 - neck);
    let length = 1.0 + 0.028 * t.head_length;
    let girth = 1.0 + 0.05 * t.neck_girth * neck;
    [
        plan.height(front_y) + lift,
        (front_z + slope + 2.2 * t.chin_projection * chin) * (1.0 + (girth - 1.0)),
        side_x * width,
        plan.height(side_y) + lift,
        side_z,
        plan.height(back_y) + lift,
        back_z * length * girth,
        front_full + 0.012 * t.jaw_width * jaw,
        back_full,
    ]
}
