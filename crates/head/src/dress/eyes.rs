//! Eyeballs: sclera, iris and pupil, the highlight on the cornea, and the wet lining of the lids.

use std::f32::consts::TAU;

use glam::Vec3;
use srflow_core::random::Stream;

use super::light::{Exposure, Material};
use super::noise::Noise;
use super::skin::flat;
use super::surface::SurfacePoint;
use super::{Dressing, smoothstep};
use crate::{Look, Region};

const MM: f32 = 1e-3;
/// An adult's iris, metres.
const IRIS_RADIUS: f32 = 5.9 * MM;
/// Radius of curvature of the cornea as a mirror, metres.
const CORNEA_RADIUS: f32 = 7.8 * MM;
/// Ratio of pupil to iris.
const PUPIL: f32 = 0.34;

/// Dresses both eyes and the lining of their lids.
pub(super) fn dress_eyes(dressing: &mut Dressing) {
    for side in 0..2 {
        let eye = Eye::new(dressing, side);
        eyeball(dressing, &eye);
        highlight(dressing, &eye);
    }
    lid_lining(dressing);
}

struct Eye {
    /// 0 for the left eye, 1 for the right.
    side: usize,
    centre: Vec3,
    iris_radius: f32,
    fibres: Noise,
    veins: Noise,
    triangles: Vec<u32>,
}

impl Eye {
    fn new(dressing: &Dressing, side: usize) -> Self {
        let surface = dressing.surface;
        let centre = surface.eyes[side];
        let mut stream = dressing.stream("eyes");
        let eyeball = &surface.model.eyeballs[side];
        let mut triangles = surface.triangles_of(&[Region::Eyeball]);
        triangles.retain(|&t| {
            surface.model.triangles[t as usize].iter().all(|v| eyeball.binary_search(v).is_ok())
        });
        // The back of the eyeball is never visible.
        triangles.retain(|&t| (surface.frames[t as usize].origin - centre).normalize_or(Vec3::Z).z > -0.25);
        let (fibres, veins) = (Noise::new(stream.bits()), Noise::new(stream.bits()));
        Self { side, centre, iris_radius: IRIS_RADIUS * surface.size, fibres, veins, triangles }
    }

    /// Distance from the gaze axis in iris radii; beyond the equator it stays large.
    fn rho(&self, p: Vec3) -> f32 {
        let d = p - self.centre;
        if d.z > 0.0 { d.truncate().length() / self.iris_radius } else { 9.0 }
    }
}

fn eyeball(dressing: &mut Dressing, eye: &Eye) {
    let mut stream = dressing.stream(["left eyeball", "right eyeball"][eye.side]);
    let size = dressing.surface.size;
    let spacing = |point: &SurfacePoint| {
        let rho = eye.rho(point.position);
        (if rho < 1.25 { 0.23 } else { 0.23 + 0.4 * smoothstep((rho - 1.25) / 0.6) }) * MM * size
    };
    for point in dressing.surface.scatter(&eye.triangles, spacing, &mut stream) {
        let color = eyeball_color(dressing, eye, &point, &mut stream);
        let sigma = spacing(&point) * 0.68;
        dressing.add(point.triangle, flat(point.position, point.normal, sigma, sigma * 0.15, color, 0.985));
    }
    // A few large ones behind, so that nothing shines through between the fine ones.
    let coarse = |_: &SurfacePoint| 1.6 * MM * size;
    for point in dressing.surface.scatter(&eye.triangles, coarse, &mut stream) {
        let color = eyeball_color(dressing, eye, &point, &mut stream) * 0.8;
        let inside = point.position - point.normal * (0.6 * MM * size);
        dressing.add(point.triangle, flat(inside, point.normal, 1.2 * MM * size, 0.2 * MM, color, 0.99));
    }
}

fn eyeball_color(dressing: &Dressing, eye: &Eye, point: &SurfacePoint, stream: &mut Stream) -> Vec3 {
    let rho = eye.rho(point.position);
    let d = point.position - eye.centre;
    let iris = iris_albedo(dressing, eye, d, rho);
    let sclera = sclera_albedo(eye, d, rho, stream) * if dressing.look == Look::First { 1.0 } else { 0.84 };
    let white = smoothstep((rho - 0.94) / 0.16);
    let albedo = iris.lerp(sclera, white);
    let seen = dressing.exposure(point);
    let exposure = if dressing.look == Look::First {
        // The baked shadow of the lids counts half: the eye will rotate under it.
        Exposure { sky: 0.30 + 0.62 * seen.sky, key: 0.25 + 0.60 * seen.key, fill: 0.35 + 0.55 * seen.fill }
    } else {
        Exposure { sky: 0.12 + 0.76 * seen.sky, key: 0.10 + 0.74 * seen.key, fill: 0.20 + 0.68 * seen.fill }
    };
    let round = d.normalize_or(Vec3::Z);
    let wrap = Vec3::splat(0.35);
    dressing.studio().shade(&Material { albedo, wrap, sheen: 0.0, gloss: 1.0 }, round, &exposure)
}

fn iris_albedo(dressing: &Dressing, eye: &Eye, d: Vec3, rho: f32) -> Vec3 {
    let a = &dressing.appearance;
    let around = d.truncate().normalize_or_zero();
    // Constant along the radius except for a slow drift: fibres run outward from the pupil.
    let fibre = |frequency: f32, drift: f32| {
        eye.fibres.at(Vec3::new(around.x * frequency, around.y * frequency, rho * drift))
    };
    let streaks = 0.55 * fibre(9.0, 1.5) + 0.45 * fibre(24.0, 3.0);
    let collarette = 0.55 + 0.06 * fibre(5.0, 1.0);
    let base = a.iris_inner.lerp(a.iris, smoothstep((rho - collarette + 0.12) / 0.24));
    // Light that the cornea focuses on the side away from the soft box.
    let gathered = 1.0 + 0.55 * around.dot(glam::Vec2::new(0.55, -0.83)) * rho.min(1.0);
    let ring = 1.0 - 0.72 * smoothstep((rho - 0.80) / 0.20);
    let albedo = base * ((1.0 + 0.62 * streaks) * gathered * ring * 1.25).max(0.08);
    let pupil_edge = PUPIL + 0.015 * fibre(12.0, 0.0);
    Vec3::splat(0.006).lerp(albedo, smoothstep((rho - pupil_edge + 0.03) / 0.06))
}

fn sclera_albedo(eye: &Eye, d: Vec3, rho: f32, stream: &mut Stream) -> Vec3 {
    let outward = smoothstep((rho - 1.1) / 1.1);
    let white = Vec3::new(0.74, 0.70, 0.66).lerp(Vec3::new(0.66, 0.50, 0.45), outward * 0.75);
    let q = d / MM;
    let warp = Vec3::new(eye.veins.at(q * 0.7), eye.veins.at(q * 0.7 + 9.0), eye.veins.at(q * 0.7 + 19.0));
    // Veins run from the corners to the iris: zero crossings of stretched noise.
    let ridge = eye.veins.at(Vec3::new(q.x * 0.22, q.y * 0.9, q.z * 0.3) + warp * 0.8).abs();
    let vein = (1.0 - ridge / 0.06).max(0.0) * (0.15 + 0.5 * outward);
    white.lerp(Vec3::new(0.55, 0.20, 0.17), vein) * (1.0 + stream.uniform(-0.02, 0.02))
}

/// The reflection of the soft box in the cornea, and faintly that of the fill light.
fn highlight(dressing: &mut Dressing, eye: &Eye) {
    let size = dressing.surface.size;
    let Some(&front) = eye.triangles.iter().max_by(|&&a, &&b| {
        let z = |t: u32| dressing.surface.frames[t as usize].origin.z;
        z(a).total_cmp(&z(b))
    }) else {
        return;
    };
    let apex = dressing.surface.frames[front as usize].origin.z;
    let radius = CORNEA_RADIUS * size;
    let mirror = |half_x: f32, half_y: f32| {
        let depth = radius - (radius * radius * (1.0 - half_x * half_x - half_y * half_y).max(0.0)).sqrt();
        Vec3::new(
            eye.centre.x + half_x * radius,
            eye.centre.y + half_y * radius,
            apex - depth + 0.35 * MM * size,
        )
    };
    // A square window with nine panes.
    for i in 0..9 {
        let (column, row) = ((i % 3) as f32 - 1.0, (i / 3) as f32 - 1.0);
        let position = mirror(-0.25 + column * 0.05, 0.19 + row * 0.055);
        let splat = flat(position, Vec3::Z, 0.24 * MM * size, 0.02 * MM, Vec3::new(1.0, 0.99, 0.97), 0.62);
        dressing.add(front, splat);
    }
    for i in 0..5 {
        let position = mirror(0.40, -0.06 + i as f32 * 0.045);
        dressing.add(front, flat(position, Vec3::Z, 0.28 * MM * size, 0.02 * MM, Vec3::splat(0.85), 0.10));
    }
}

/// The pink inside of the lids where it is visible, and the tear line where the lower lid meets the eye.
fn lid_lining(dressing: &mut Dressing) {
    let surface = dressing.surface;
    let size = surface.size;
    let mut stream = dressing.stream("lid lining");
    let mut triangles = surface.triangles_of(&[Region::InnerLid]);
    triangles.retain(|&t| {
        let p = surface.frames[t as usize].origin;
        surface.eyes.iter().any(|&eye| (p - eye).normalize_or_zero().z > 0.2)
    });
    let pink = dressing.appearance.skin.lerp(Vec3::new(0.60, 0.27, 0.23), 0.6);
    for point in surface.scatter(&triangles, |_| 0.55 * MM * size, &mut stream) {
        let seen = dressing.exposure(&point);
        let exposure = Exposure { sky: 0.25 + 0.6 * seen.sky, key: 0.15 + 0.6 * seen.key, fill: seen.fill };
        let albedo = pink * (1.0 + stream.uniform(-0.06, 0.06));
        let material = Material { albedo, wrap: Vec3::new(0.4, 0.2, 0.15), sheen: 0.10, gloss: 30.0 };
        let color = dressing.studio().shade(&material, point.normal, &exposure);
        dressing.add(
            point.triangle,
            flat(point.position, point.normal, 0.38 * MM * size, 0.05 * MM, color, 0.97),
        );
    }
    tear_lines(dressing, &mut stream);
}

fn tear_lines(dressing: &mut Dressing, stream: &mut Stream) {
    let surface = dressing.surface;
    let size = surface.size;
    for (side, corners) in [(1, [36, 41, 40, 39]), (0, [45, 46, 47, 42])] {
        let eye = surface.eyes[side];
        let lids = super::near_triangles(
            surface,
            &[Region::LidMargin, Region::InnerLid, Region::Skin],
            eye,
            0.024 * size,
        );
        let curve = corners.map(|i| surface.landmarks[i]);
        const STEPS: usize = 60;
        for step in 0..STEPS {
            let t = 0.08 + 0.84 * (step as f32 + stream.unit()) / STEPS as f32;
            let on_lid = super::catmull_rom(&curve, t);
            let Some(lid) = super::nearest_point(surface, &lids, on_lid) else { continue };
            let on_lid = lid.position;
            let inward = (eye - on_lid).normalize_or_zero();
            let position = on_lid + inward * (0.15 * MM * size) + Vec3::Y * (0.35 * MM * size);
            let along =
                super::catmull_rom(&curve, (t + 0.02).min(1.0)) - super::catmull_rom(&curve, t - 0.02);
            let glint: f32 = 0.5 + 0.5 * libm::sinf(t * TAU * 1.5 + stream.unit());
            let (opacity, color) = match dressing.look {
                Look::First => (0.18 + 0.35 * glint, Vec3::new(0.97, 0.93, 0.91)),
                Look::Second => (0.1 + 0.32 * glint, Vec3::new(0.82, 0.74, 0.72)),
            };
            let splat = super::Splat {
                position,
                scale: Vec3::new(0.42, 0.11, 0.11) * (MM * size),
                rotation: super::surface::rotation_along(along, Vec3::Z),
                opacity,
                color,
            };
            dressing.add(lid.triangle, splat);
        }
    }
}
