use glam::Vec3;

use super::curves::{ridge, smoothstep};
use super::identity::Plan;

/// Pushes the skin of the neck and shoulders over muscle, larynx and collarbone. `outward` is the skin's direction.
pub(super) fn relief(plan: &Plan, p: Vec3, outward: Vec3) -> Vec3 {
    let drop = plan.chin - super::identity::CANON[3];
    let at = |x: f32, y: f32, z: f32| Vec3::new(x, y + drop, z);
    let mut push = 0.0;
    // Sternocleidomastoid, from behind the ear to the breastbone.
    push += 3.2 * ridge(p, at(60.0, -48.0, -22.0), at(12.0, -178.0, 34.0), 19.0);
    // Hollow between it and the trapezius, over the collarbone.
    push -= 5.0 * ridge(p, at(56.0, -152.0, 2.0), at(72.0, -166.0, 0.0), 24.0);
    // Collarbone and the notch between the two.
    push += 3.5 * ridge(p, at(14.0, -186.0, 42.0), at(110.0, -176.0, 22.0), 13.0);
    push -= 4.0 * ridge(p, at(0.0, -182.0, 38.0), at(0.0, -188.0, 42.0), 12.0);
    // Larynx and windpipe.
    let larynx = 1.4 + 0.9 * plan.traits.neck_girth;
    push += larynx * ridge(p, at(0.0, -118.0, 40.0), at(0.0, -124.0, 40.0), 14.0);
    push += 1.0 * ridge(p, at(0.0, -120.0, 40.0), at(0.0, -176.0, 36.0), 16.0);
    outward * push * (1.0 - smoothstep(-60.0, -35.0, p.y - drop))
}
