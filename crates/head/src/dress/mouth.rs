//! Teeth, gums, tongue and the dark interior of the mouth.

use glam::Vec3;

use super::light::{Exposure, Material};
use super::skin::flat;
use super::surface::{Surface, SurfacePoint};
use super::{Dressing, smoothstep};
use crate::{Look, Region};

const MM: f32 = 1e-3;

/// Dresses the inside of the mouth. It is closed at rest, so its light is not baked but decreases with the distance behind the
/// lips.
pub(super) fn dress_mouth(dressing: &mut Dressing) {
    teeth(dressing);
    inside(dressing);
}

/// Light that enters through the open mouth.
fn exposure_behind(dressing: &Dressing, p: Vec3) -> Exposure {
    let lips = (dressing.surface.landmarks[62] + dressing.surface.landmarks[66]) * 0.5;
    let depth = ((lips.z - p.z) / dressing.surface.size).max(0.0);
    let seen = 1.0 - smoothstep((depth - 2.0 * MM) / (34.0 * MM));
    Exposure { sky: 0.06 + 0.74 * seen, key: 0.65 * seen * seen, fill: 0.6 * seen }
}

fn teeth(dressing: &mut Dressing) {
    let surface = dressing.surface;
    let mut stream = dressing.stream("teeth");
    let lips = (surface.landmarks[62] + surface.landmarks[66]) * 0.5;
    let throat = lips - Vec3::Z * (0.045 * surface.size);
    let mut triangles = surface.triangles_of(&[Region::Teeth]);
    // The sides towards the tongue are not visible.
    // Least cosine between their normal and the way out of the mouth; millimetres between Gaussians in front; their size.
    let (least, dense, spread) = match dressing.look {
        Look::First => (-0.45, 0.62, 0.72),
        Look::Second => (0.0, 0.4, 0.95),
    };
    triangles.retain(|&t| {
        let frame = surface.frames[t as usize];
        let normal = frame.rotation * Vec3::Y;
        let outward = ((frame.origin - throat) * Vec3::new(1.0, 0.0, 1.0)).normalize_or(Vec3::Z);
        normal.dot(outward) > least
    });
    let gaps = (dressing.look >= Look::Second).then(|| gaps(surface));
    let spacing = |point: &SurfacePoint| {
        let depth = ((lips.z - point.position.z) / surface.size).max(0.0);
        (dense + 1.1 * smoothstep((depth - 10.0 * MM) / (25.0 * MM))) * MM * surface.size
    };
    for point in surface.scatter(&triangles, spacing, &mut stream) {
        let ivory = Vec3::new(0.70, 0.64, 0.54) * (1.0 + stream.uniform(-0.03, 0.03));
        let material = Material { albedo: ivory, wrap: Vec3::splat(0.3), sheen: 0.12, gloss: 40.0 };
        let mut color =
            dressing.studio().shade(&material, point.normal, &exposure_behind(dressing, point.position));
        if let Some(gaps) = &gaps {
            color *= Vec3::ONE - Vec3::new(0.6, 0.7, 0.75) * surface.value(gaps, &point);
        }
        let sigma = spacing(&point) * spread;
        dressing.add(point.triangle, flat(point.position, point.normal, sigma, sigma * 0.2, color, 0.98));
    }
}

/// How much of a gap each vertex is in, `0..=1`: where the surface around it rises on all sides, as between two teeth and at the gum.
fn gaps(surface: &Surface) -> Vec<f32> {
    let mut rises = vec![(0.0_f32, 0.0_f32); surface.vertices.len()];
    for t in surface.triangles_of(&[Region::Teeth]) {
        let corners = surface.model.triangles[t as usize].map(|v| v as usize);
        for (i, a) in corners.into_iter().enumerate() {
            for b in [corners[(i + 1) % 3], corners[(i + 2) % 3]] {
                let way = (surface.vertices[b] - surface.vertices[a]).normalize_or_zero();
                rises[a].0 += way.dot(surface.normals[a]);
                rises[a].1 += 1.0;
            }
        }
    }
    rises.into_iter().map(|(rise, count)| smoothstep((rise / count.max(1.0) - 0.01) / 0.07)).collect()
}

fn inside(dressing: &mut Dressing) {
    let surface = dressing.surface;
    let mut stream = dressing.stream("mouth");
    let spacing = 1.9 * MM * surface.size;
    for point in surface.scatter(&surface.triangles_of(&[Region::MouthInside]), |_| spacing, &mut stream) {
        let flesh = Vec3::new(0.42, 0.13, 0.12) * (1.0 + stream.uniform(-0.1, 0.1));
        let material = Material { albedo: flesh, wrap: Vec3::new(0.4, 0.2, 0.2), sheen: 0.05, gloss: 25.0 };
        let color =
            dressing.studio().shade(&material, point.normal, &exposure_behind(dressing, point.position));
        dressing
            .add(point.triangle, flat(point.position, point.normal, spacing * 0.75, 0.2 * MM, color, 0.985));
    }
}
