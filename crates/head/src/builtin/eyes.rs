use glam::{Vec2, Vec3};

use super::curves::{bell, dome, lerp, smooth_max, smoothstep};
use super::half::{Half, Mark, Part};
use super::identity::Plan;
use crate::Region;

/// Thickness of the eyelid at its margin, and of the film between lid and eyeball.
const LID_THICKNESS: f32 = 1.45;
const FILM: f32 = 0.45;

/// Position from inner to outer canthus, 0 to 1.
pub(super) fn along_lid(plan: &Plan, x: f32) -> f32 {
    ((x - plan.inner_canthus.x) / (plan.outer_canthus.x - plan.inner_canthus.x)).clamp(0.0, 1.0)
}

/// Height of the margin of the upper or lower lid at `x`.
pub(super) fn margin(plan: &Plan, x: f32, upper: bool) -> f32 {
    let q = along_lid(plan, x);
    let line = lerp(plan.inner_canthus.y, plan.outer_canthus.y, q);
    let arch = |skew: f32, power: f32| {
        libm::powf(libm::sinf(std::f32::consts::PI * libm::powf(q, skew)).max(0.0), power)
    };
    if upper {
        line + plan.lid_heights[0] * arch(0.86, 0.85)
    } else {
        line - plan.lid_heights[1] * arch(1.25, 0.95)
    }
}

/// Height with open eyes of the skin that is `over` millimetres above the closed slit.
pub(super) fn opened_height(plan: &Plan, x: f32, over: f32, upper: bool) -> f32 {
    let far = if upper { 22.0 } else { 20.0 };
    let stay = 1.0 - smoothstep(0.0, 1.0, over.abs() / far);
    plan.eye.y + over + (margin(plan, x, upper) - plan.eye.y) * stay
}

/// Depth of the outer face of the lids where they touch the eyeball, continued straight beyond the eyeball.
fn lid_depth(plan: &Plan, at: Vec2, thickness: f32) -> f32 {
    const STRAIGHT_FROM: f32 = 0.80;
    let radius = plan.eye_radius + thickness;
    let q = at.distance(plan.eye.truncate()) / radius;
    let profile = |q: f32| libm::sqrtf(1.0 - q * q);
    let depth = if q < STRAIGHT_FROM {
        profile(q)
    } else {
        // Tangent to the eyeball on the temporal side, flatter towards the nose, where the canthus is farther forward.
        let tangent = STRAIGHT_FROM / profile(STRAIGHT_FROM);
        let slope = lerp(0.55 * tangent, tangent, smoothstep(-9.0, 9.0, at.x - plan.eye.x));
        profile(STRAIGHT_FROM) - (q - STRAIGHT_FROM) * slope
    };
    plan.eye.z + radius * depth
}

/// Fits the skin of the orbit to the eyeball: lids, crease and the fold above it.
pub(super) fn drape(plan: &Plan, p: Vec3) -> Vec3 {
    let at = Vec2::new(p.x, p.y);
    let reach = dome(at, plan.eye.truncate(), Vec2::new(27.0, 24.0));
    if reach == 0.0 {
        return p;
    }
    let q = along_lid(plan, p.x);
    let open = libm::sinf(std::f32::consts::PI * q).max(0.0);
    let over = p.y - margin(plan, p.x, true);
    let under = margin(plan, p.x, false) - p.y;
    let mut z = p.z;
    // The fold above the crease, then the lids, then the crease and the furrow of the lower lid.
    let crease = plan.crease * (0.45 + 0.55 * libm::sqrtf(open));
    let width = plan.outer_canthus.x - plan.inner_canthus.x;
    let across = (p.x - plan.inner_canthus.x) / width;
    let ends = smoothstep(-0.12, 0.15, across) * (1.0 - smoothstep(0.92, 1.22, across));
    // Next to their margins the lids touch the eyeball, independent of the face around.
    let outside = (plan.inner_canthus.x - p.x).max(p.x - plan.outer_canthus.x).max(0.0);
    let held = (1.0 - smoothstep(0.5, 6.5, over.max(under).max(0.0))) * (1.0 - smoothstep(0.0, 9.0, outside));
    if over > 0.0 {
        z += 1.6 * bell((over - crease - 3.2) / 5.0) * ends;
    }
    let lid = lid_depth(plan, at, LID_THICKNESS + 0.06 * over.max(under).max(0.0));
    z = smooth_max(z, lid, if over > 0.0 { 3.0 } else { lerp(3.0, 7.0, smoothstep(0.0, 4.0, under)) });
    z = lerp(z, lid, held);
    if over > 0.0 {
        z -= 1.1 * bell((over - crease) / 1.7) * ends;
    }
    if under > 0.0 {
        z -= 0.3 * bell((under - 8.0) / 4.5) * ends;
    }
    Vec3::new(p.x, p.y, lerp(p.z, z, smoothstep(0.0, 0.25, reach)))
}

/// Rotates `p` about the left eyeball's horizontal axis; positive raises points in front.
pub(super) fn rolled(plan: &Plan, p: Vec3, angle: f32) -> Vec3 {
    let (sin, cos) = (libm::sinf(angle), libm::cosf(angle));
    let d = p - plan.eye;
    plan.eye + Vec3::new(d.x, d.y * cos + d.z * sin, d.z * cos - d.y * sin)
}

/// Rows of the lining behind a lid margin.
pub(super) const LINING_ROWS: usize = 5;

/// Position of row `row` (1 to [`LINING_ROWS`]) of the lining behind the margin point `m`: over the lid's edge, then along
/// the eyeball under the lid.
pub(super) fn lining(plan: &Plan, m: Vec3, row: usize, upper: bool) -> Vec3 {
    let from_eye = m - plan.eye;
    let distance = from_eye.length();
    let inner = plan.eye_radius + FILM;
    let on_ball = |share: f32| plan.eye + from_eye * (lerp(distance, inner, share) / distance);
    // Beyond the side of the eyeball (at the canthi) the lining goes straight back instead.
    let beside = smoothstep(inner + 2.4, inner + 5.0, distance);
    let behind = |share: f32| m - Vec3::new(0.0, 0.0, 4.0 * share);
    let edge = |share: f32| on_ball(share).lerp(behind(share), beside);
    let up = if upper { 1.0 } else { -1.0 };
    match row {
        1 => edge(0.45),
        2 => edge(1.0),
        3 => rolled(plan, edge(1.0), up * 0.16),
        4 => rolled(plan, edge(1.0), up * 0.40),
        _ => rolled(plan, edge(1.0), up * 0.75),
    }
}

/// Adds the left eyeball: rings about +z, denser on the cornea, which bulges.
pub(super) fn add_eyeball(half: &mut Half, plan: &Plan) -> std::ops::Range<u32> {
    const AROUND: usize = 36;
    const ANGLES: [f32; 20] = [
        0.06, 0.12, 0.18, 0.24, 0.30, 0.36, 0.42, 0.47, 0.51, 0.56, 0.63, 0.74, 0.88, 1.05, 1.25, 1.50, 1.80,
        2.15, 2.50, 2.85,
    ];
    let radius = |angle: f32| plan.eye_radius + 0.6 * bell(angle / 0.62);
    let mark = Mark::of(Part::Eyeball);
    let first = half.vertex(plan.eye + Vec3::new(0.0, 0.0, radius(0.0)), mark);
    let mut rings: Vec<Vec<u32>> = vec![vec![first; AROUND + 1]];
    for angle in ANGLES {
        let (sin, cos) = (libm::sinf(angle), libm::cosf(angle));
        let mut ring: Vec<u32> = (0..AROUND)
            .map(|i| {
                let turn = std::f32::consts::TAU * i as f32 / AROUND as f32;
                let direction = Vec3::new(sin * libm::cosf(turn), sin * libm::sinf(turn), cos);
                half.vertex(plan.eye + direction * radius(angle), mark)
            })
            .collect();
        ring.push(ring[0]);
        rings.push(ring);
    }
    let last = half.vertex(plan.eye - Vec3::new(0.0, 0.0, plan.eye_radius), mark);
    rings.push(vec![last; AROUND + 1]);
    for pair in rings.windows(2) {
        half.strip(&pair[0], &pair[1], |_| Region::Eyeball);
    }
    first..last + 1
}

/// Adds the caruncle, the pink nodule in the inner corner.
pub(super) fn add_caruncle(half: &mut Half, plan: &Plan) {
    let middle = plan.inner_canthus.x + 2.6;
    let y = 0.5 * (margin(plan, middle, true) + margin(plan, middle, false));
    let at = Vec2::new(middle, y);
    let center = at.extend(lid_depth(plan, at, LID_THICKNESS) - 3.1);
    let first = half.points.len();
    super::blob::add(half, center, Vec3::new(2.6, 1.9, 2.2), 10, Mark::of(Part::LidLining), Region::InnerLid);
    // It touches the eyeball.
    for point in &mut half.points[first..] {
        let from_eye = *point - plan.eye;
        *point = plan.eye + from_eye * ((plan.eye_radius + 0.2) / from_eye.length()).max(1.0);
    }
}

/// The outer edge of a lid's margin at `x` and height `y`.
pub(super) fn margin_point(plan: &Plan, x: f32, y: f32) -> Vec3 {
    Vec3::new(x, y, lid_depth(plan, Vec2::new(x, y), LID_THICKNESS))
}
