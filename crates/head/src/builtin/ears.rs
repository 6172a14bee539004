use glam::{Vec2, Vec3};

use super::curves::{bell, curve, dome, smoothstep};
use super::half::{Half, Mark, Part};
use super::identity::Plan;
use crate::{Look, Region};

/// Directions around the ear.
const AROUND: usize = 48;

/// Rings of the front, as fractions of the outline, and of the back, with their distance behind the outline's plane.
const FRONT: [f32; 17] =
    [0.12, 0.22, 0.32, 0.40, 0.47, 0.53, 0.58, 0.63, 0.68, 0.73, 0.78, 0.83, 0.88, 0.92, 0.955, 0.985, 1.0];
const BACK: [(f32, f32); 7] =
    [(1.006, 0.7), (0.992, 1.7), (0.95, 3.2), (0.89, 4.8), (0.82, 7.2), (0.75, 11.5), (0.70, 18.0)];

/// Centre of the polar grid in the ear's plane, backward and upward from the tragus.
const MIDDLE: Vec2 = Vec2::new(13.0, 2.0);

/// Adds the left ear, whose tragus sits at `root` on the side of the head.
pub(super) fn add(half: &mut Half, plan: &Plan, root: Vec3) {
    let t = &plan.traits;
    let size = 1.0 + 0.045 * t.ear_size;
    let flare = (26.0 + 4.5 * t.ear_protrusion).to_radians();
    let lean = 0.16_f32;
    let back = Vec3::new(libm::sinf(flare), 0.0, -libm::cosf(flare));
    let upright = Vec3::new(0.05, 1.0, 0.0).normalize();
    // Tilted backward in its own plane.
    let up = (upright + back * lean).normalize();
    let back = (back - up * back.dot(up)).normalize();
    let out = back.cross(up);
    let place =
        |flat: Vec2, height: f32| root + (back * flat.x + up * flat.y + out * (height + lobule(flat))) * size;

    let mark = Mark::of(Part::Ear);
    let middle = half.vertex(place(MIDDLE, relief(MIDDLE, 0.0, 0.0, plan.look)), mark);
    let mut previous = vec![middle; AROUND + 1];
    let front = FRONT.iter().map(|&share| (share, None));
    for (share, behind) in front.chain(BACK.iter().map(|&(share, behind)| (share, Some(behind)))) {
        let mut ring: Vec<u32> = (0..AROUND)
            .map(|i| {
                let angle = std::f32::consts::TAU * i as f32 / AROUND as f32;
                let direction = Vec2::new(libm::cosf(angle), libm::sinf(angle));
                let flat = MIDDLE + direction * (outline(angle, plan.look) * share);
                let height = match behind {
                    None => relief(flat, share, angle, plan.look),
                    Some(behind) => rim(angle, 1.0) - behind,
                };
                half.vertex(place(flat, height), mark)
            })
            .collect();
        ring.push(ring[0]);
        half.strip(&previous, &ring, |_| Region::Skin);
        previous = ring;
    }
}

/// How far the lobule bends outward from the ear's plane.
fn lobule(flat: Vec2) -> f32 {
    4.2 * smoothstep(6.0, 26.0, -flat.y) * smoothstep(4.0, 18.0, flat.x)
}

/// Distance from the centre to the outline; the angle is measured from backward to upward.
fn outline(angle: f32, look: Look) -> f32 {
    // The lobule, which is narrow in the second look.
    let lowest = if look == Look::First { 31.0 } else { 27.5 };
    let [front, root, bottom, back] =
        if look == Look::First { [24.5, 30.4, 28.8, 25.2] } else { [21.5, 25.5, 26.2, 23.0] };
    let points = [
        (-58.0, 25.2),
        (-30.0, 20.8),
        (0.0, 20.5),
        (30.0, 23.5),
        (60.0, 29.0),
        (85.0, 33.0),
        (110.0, 32.5),
        (135.0, 25.0),
        (160.0, 18.0),
        (185.0, 15.5),
        (210.0, 16.0),
        (235.0, front),
        (252.0, root),
        (270.0, lowest),
        (286.0, bottom),
        (302.0, back),
        (330.0, 20.8),
        (360.0, 20.5),
        (390.0, 23.5),
    ];
    curve(&points.map(|(degrees, radius): (f32, f32)| (degrees.to_radians(), radius))).at(angle)[0]
}

/// How far the helix is rolled up at an angle: from the lobule along the back and over the top to the front.
fn helix(angle: f32) -> f32 {
    let degrees = angle.to_degrees();
    let turned = if degrees > 250.0 { degrees - 360.0 } else { degrees };
    smoothstep(-75.0, -20.0, turned) * (1.0 - smoothstep(140.0, 185.0, turned))
}

fn rim(angle: f32, share: f32) -> f32 {
    // In front, from the root of the helix to the lobule, the edge merges with the cheek.
    let degrees = angle.to_degrees();
    let rooted = smoothstep(150.0, 180.0, degrees) * (1.0 - smoothstep(248.0, 268.0, degrees));
    3.4 * bell((share - 0.93) / 0.16) * helix(angle) + 1.5 - 6.0 * rooted * smoothstep(0.72, 1.0, share)
}

/// Height of the ear's front above its plane.
fn relief(flat: Vec2, share: f32, angle: f32, look: Look) -> f32 {
    let spot = |b: f32, u: f32, rb: f32, ru: f32| dome(flat, Vec2::new(b, u), Vec2::new(rb, ru));
    let degrees = angle.to_degrees();
    let turned = if degrees > 250.0 { degrees - 360.0 } else { degrees };
    let antihelix = smoothstep(-85.0, -45.0, turned) * (1.0 - smoothstep(75.0, 125.0, turned));
    let mut height = rim(angle, share) * smoothstep(0.5, 0.9, share);
    let depth = if look == Look::First { 1.0 } else { 1.4 };
    height -= depth * 2.6 * bell((share - 0.77) / 0.15) * helix(angle);
    height += 4.2 * bell((share - 0.56) / 0.20) * antihelix;
    height -= depth * 7.5 * spot(10.5, -3.0, 12.0, 14.0);
    height -= depth * 3.5 * spot(9.0, 13.0, 9.0, 7.0);
    height += 6.5 * spot(-0.5, -3.0, 6.0, 7.0);
    height += 5.0 * spot(10.5, -15.5, 7.0, 5.0);
    height += 4.0 * spot(2.0, 6.0, 9.0, 3.8);
    height += 2.2 * spot(9.0, -24.0, 12.0, 9.0);
    height
}
