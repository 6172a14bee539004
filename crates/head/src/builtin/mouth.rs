use glam::{Vec2, Vec3};

use super::curves::{Spline, bell, curve, dome, lerp, smoothstep};
use super::half::{Half, Mark, Part};
use super::identity::Plan;
use crate::Region;

/// Height of the vermilion of each lip in the average face, across which the grid's rows are placed.
pub(super) const CANON_LIP: f32 = 8.0;

/// The relief of the lips, and how the skin around adapts to them.
#[derive(Debug)]
pub(super) struct Lips {
    upper: Spline<1>,
    lower: Spline<1>,
}

impl Lips {
    pub(super) fn new() -> Self {
        // Profile depth over fractions of the lip's height: from the line between the lips to beyond the vermilion.
        let upper = curve(&[
            (0.0, -2.6),
            (0.12, -0.6),
            (0.28, 1.0),
            (0.5, 2.0),
            (0.75, 2.0),
            (1.0, 1.9),
            (1.25, 1.0),
            (1.7, 0.2),
            (2.4, 0.0),
            (3.0, 0.0),
        ]);
        let lower = curve(&[
            (0.0, -2.6),
            (0.10, -0.4),
            (0.25, 1.5),
            (0.5, 2.7),
            (0.75, 2.3),
            (1.0, 1.0),
            (1.3, -0.2),
            (1.8, -0.5),
            (2.5, 0.0),
            (3.0, 0.0),
        ]);
        Self { upper, lower }
    }

    /// Shapes skin at `p`, `over` millimetres above the line between the lips, into lips.
    pub(super) fn relief(&self, plan: &Plan, p: Vec3, over: f32) -> Vec3 {
        let along = p.x / plan.mouth_half_width;
        if along > 1.7 || over.abs() > 30.0 {
            return Vec3::ZERO;
        }
        let share = over.abs() / lip_height(plan, p.x, over >= 0.0);
        let profile = if over >= 0.0 { &self.upper } else { &self.lower }.at(share)[0];
        let full = libm::sqrtf((1.0 - along * along).max(0.0));
        let rounding = lerp(full, bell(along / 1.25), 0.5);
        let at = Vec2::new(p.x, p.y);
        let mut z = profile * rounding * if over >= 0.0 { 0.85 } else { 1.0 };
        // The corner is pulled in, with a soft bulge of muscle next to it.
        let corner = Vec2::new(plan.mouth_half_width, slit(plan, plan.mouth_half_width));
        z -= 2.0 * dome(at, corner, Vec2::new(7.0, 6.0));
        z += 0.9 * dome(at, corner + Vec2::new(7.0, -1.0), Vec2::new(8.0, 12.0));
        // Philtrum.
        let top = plan.nose_base - 1.0;
        let lip = plan.mouth + lip_height(plan, 0.0, true);
        let between = smoothstep(lip - 1.5, lip + 2.0, p.y) * (1.0 - smoothstep(top - 5.0, top + 1.0, p.y));
        z += between * (0.7 * bell((p.x - 5.2) / 4.0) - 1.2 * bell(p.x / 5.0));
        Vec3::new(0.0, 0.0, z)
    }
}

/// Height of the line between the lips at `x`.
pub(super) fn slit(plan: &Plan, x: f32) -> f32 {
    let along = x / plan.mouth_half_width;
    plan.mouth - 0.5 * bell(along / 0.35) + 0.4 * bell((along - 0.45) / 0.5)
        - 0.6 * smoothstep(0.6, 1.1, along)
}

/// Height of the vermilion of the upper or lower lip at `x`.
pub(super) fn lip_height(plan: &Plan, x: f32, upper: bool) -> f32 {
    let along = (x / plan.mouth_half_width).min(1.0);
    let taper = 1.0 - along * along * along;
    if upper {
        let bow = 0.9 * bell((x - 6.0) / 6.0) - 0.9 * bell(x / 5.5);
        (plan.lip_heights[0] + bow) * libm::powf(1.0 - along, 0.75).max(0.0) * (1.0 + 0.9 * along) + 0.9
    } else {
        (plan.lip_heights[1] * libm::powf(taper, 0.8)).max(0.0) + 0.9
    }
}

/// Height on this person of skin `over` millimetres above the line between the lips in the average face.
pub(super) fn lip_row(plan: &Plan, x: f32, over: f32) -> f32 {
    let height = lip_height(plan, x, over >= 0.0);
    let distance = over.abs();
    let beyond = smoothstep(plan.mouth_half_width, plan.mouth_half_width + 9.0, x);
    let height = lerp(height, CANON_LIP, beyond);
    let scaled = if distance <= CANON_LIP {
        distance * height / CANON_LIP
    } else {
        let rest = 1.0 - smoothstep(0.0, 1.0, (distance - CANON_LIP) / 20.0);
        distance + (height - CANON_LIP) * rest
    };
    let follow = 1.0 - smoothstep(0.0, 24.0, distance);
    let line = slit(plan, x.min(plan.mouth_half_width * 1.2)) - plan.mouth;
    plan.mouth + line * follow + if over >= 0.0 { scaled } else { -scaled }
}

/// Rows of the lining from the line between the lips to the back of the mouth.
pub(super) const LINING_ROWS: usize = 9;

/// Backward and upward offset and widening of each row behind the lips.
const LINING: [(f32, f32, f32); LINING_ROWS] = [
    (-1.5, 0.1, 1.0),
    (-3.2, 0.7, 1.0),
    (-4.8, 2.6, 1.02),
    (-5.4, 7.0, 1.04),
    (-6.5, 13.0, 1.06),
    (-16.0, 15.0, 1.10),
    (-32.0, 14.0, 1.12),
    (-48.0, 9.0, 1.05),
    (-58.0, 0.0, 0.9),
];

/// Position of row `row` (1 to [`LINING_ROWS`]) of the lining behind `edge`, a point of the line between the lips.
pub(super) fn lining(plan: &Plan, edge: Vec3, row: usize, upper: bool) -> Vec3 {
    let (back, up, wide) = LINING[row - 1];
    let along = (edge.x / plan.mouth_half_width).min(1.0);
    let opening = 1.0 - along * along * along * along;
    let up = if upper { up } else { -up };
    Vec3::new(edge.x * wide, edge.y + up * opening, edge.z + back)
}

pub(super) fn add_tongue(half: &mut Half, plan: &Plan, lips: f32) {
    let center = Vec3::new(0.0, plan.mouth - 10.0, lips - 39.0);
    let mark = Mark::of(Part::Tongue);
    super::blob::add_straddling(half, center, Vec3::new(19.0, 8.0, 26.0), 12, mark, Region::MouthInside);
}
