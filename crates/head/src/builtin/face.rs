//! The soft and bony relief of the face between its openings.

use glam::{Vec2, Vec3};

use super::curves::{bell, curve, smoothstep, twin_dome};
use super::identity::Plan;

/// Shapes skin at `p` (left half, in front): brow ridge, orbit, cheekbone, cheek, nasolabial fold, chin.
pub(super) fn relief(plan: &Plan, p: Vec3) -> Vec3 {
    let t = &plan.traits;
    let at = Vec2::new(p.x, p.y);
    let h = |canon: f32| plan.height(canon);
    let spot = |x: f32, y: f32, rx: f32, ry: f32| twin_dome(at, Vec2::new(x, y), Vec2::new(rx, ry));
    let mut push = Vec3::ZERO;
    let eye = plan.eye;

    // Frontal eminences, brow ridge over the orbit and the smooth glabella between.
    push.z += 1.5 * spot(28.0, 82.0, 30.0, 26.0);
    let arch = eye.y + 19.0 - 0.006 * (p.x - 26.0) * (p.x - 26.0);
    let along = smoothstep(2.0, 16.0, p.x) * (1.0 - smoothstep(42.0, 60.0, p.x));
    push.z += (2.0 + 1.1 * t.brow_ridge) * bell((p.y - arch) / 11.0) * along;
    push.z += (0.8 + 0.6 * t.brow_ridge) * spot(0.0, eye.y + 18.0, 16.0, 12.0);

    // The middle of the face is recessed between brow and upper jaw; the orbits are deepest next to the nasal root.
    push.z -= 7.0 * spot(0.0, eye.y - 8.0, 48.0, 32.0);
    push.z -= (9.0 + t.eye_depth) * spot(eye.x - 4.0, eye.y + 2.5, 28.0, 19.5);
    push.z -= 7.0 * spot(16.0, eye.y, 12.0, 15.0);
    push.z -= 2.6 * spot(21.0, eye.y - 9.0, 14.0, 12.0);
    push.z -= 1.8 * spot(21.0, eye.y + 10.0, 14.0, 8.0);
    push.z += 1.5 * spot(52.0, eye.y + 10.0, 12.0, 16.0);

    // Temple, then the cheekbone towards the ear.
    push += Vec3::new(-2.5, 0.0, -0.8) * spot(66.0, eye.y + 20.0, 16.0, 26.0);
    let cheekbone = 3.6 + 1.3 * t.cheekbones;
    push += Vec3::new(0.35, 0.0, 0.9) * cheekbone * spot(42.0, 2.0, 27.0, 23.0);
    push += Vec3::new(0.9, 0.0, 0.3) * (1.0 + 0.5 * t.cheekbones) * spot(60.0, 2.0, 24.0, 26.0);

    // Front of the cheek beside nose and mouth, and the hollow under the cheekbone.
    push.z += (1.2 + 0.6 * t.cheek_fullness) * spot(31.0, h(-14.0), 20.0, 20.0);
    push += Vec3::new(0.6, 0.0, 0.6) * (-1.6 + 2.2 * t.cheek_fullness) * spot(48.0, h(-36.0), 26.0, 34.0);

    // Nasolabial fold from the wing of the nose to the corner of the mouth.
    let fold = fold_distance(plan, at);
    push.z += (0.6 * bell((fold - 7.0) / 9.0) - 0.6 * bell(fold / 6.5)) * fold_strength(plan, at.y);

    // Chin: boss, the groove above it, and the flat of the jaw on either side.
    let boss = h(-74.0);
    push.z += (3.2 + 0.9 * t.chin_projection) * spot(0.0, boss, 21.0 + 2.0 * t.chin_width, 15.0);
    push.z += (0.8 + 0.6 * t.chin_width) * spot(12.0, boss - 4.0, 15.0, 12.0);
    push.z -= 1.6 * spot(0.0, h(-59.0), 20.0, 8.0);
    push.z -= 1.0 * spot(24.0, h(-66.0), 13.0, 15.0);
    push
}

/// Distance of `at` outward from the nasolabial fold, millimetres.
pub(super) fn fold_distance(plan: &Plan, at: Vec2) -> f32 {
    let line = curve(&[
        (plan.mouth - 14.0, 33.5),
        (plan.mouth, 32.0),
        (plan.mouth + 10.0, 28.0),
        (plan.nose_base, 23.0),
        (plan.nose_base + 10.0, 19.0),
    ]);
    at.x - line.at(at.y)[0]
}

fn fold_strength(plan: &Plan, y: f32) -> f32 {
    smoothstep(plan.mouth - 12.0, plan.mouth + 8.0, y)
        * (1.0 - smoothstep(plan.nose_base + 4.0, plan.nose_base + 14.0, y))
}
