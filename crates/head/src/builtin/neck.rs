use glam::Vec3;

use super::curves::{ridge, smoothstep};
use super::identity::Plan;

/// Shapes the skin of the neck and shoulders over muscle, larynx and collarbone. `outward` is the skin's normal.
pub(super) fn relief(plan: &Plan, p: Vec3, outward: Vec3) -> Vec3 {
    let drop = plan.chin - super::identity::CANON[3];
    let at = |x: f32, y: f32, z: f32| Vec3::new(x, y + drop, z);
    let mut push = 0.0;
    let aside = smoothstep(0.0, 16.0, p.x);
    // Sternocleidomastoid, from behind the ear to the breastbone.
    push += 2.6 * ridge(p, at(50.0, -84.0, -20.0), at(14.0, -176.0, 34.0), 26.0) * aside;
    // Hollow between it and the trapezius, above the collarbone.
    push -= 5.0 * ridge(p, at(52.0, -152.0, 2.0), at(72.0, -166.0, 0.0), 28.0);
    // Collarbone and the notch between the two.
    push += 3.0 * ridge(p, at(18.0, -188.0, 42.0), at(110.0, -176.0, 22.0), 18.0) * aside;
    push -= 2.5 * ridge(p, at(0.0, -180.0, 38.0), at(0.0, -188.0, 42.0), 20.0);
    // Larynx and windpipe.
    let larynx = 1.6 + 1.0 * plan.traits.neck_girth;
    push += larynx * ridge(p, at(0.0, -116.0, 40.0), at(0.0, -126.0, 38.0), 18.0);
    push += 1.0 * ridge(p, at(0.0, -120.0, 40.0), at(0.0, -176.0, 36.0), 22.0);
    outward * push * (1.0 - smoothstep(-85.0, -45.0, p.y - drop))
}
