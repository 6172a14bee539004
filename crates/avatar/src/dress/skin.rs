//! Skin: a layer that closes the surface, a finer one that carries colour and relief, and pores, freckles and stubble.

use glam::{Quat, Vec3};
use srflow_field::random::Stream;

use super::Dressing;
use super::light::{Exposure, Material, shade};
use super::noise::Noise;
use super::surface::SurfacePoint;
use crate::Region;
use crate::binding::Splat;

/// Everything that is covered with skin, lips included.
pub(super) const SKIN: [Region; 6] =
    [Region::Skin, Region::Scalp, Region::Lips, Region::Brow, Region::LidMargin, Region::Neck];

/// Millimetres.
const MM: f32 = 1e-3;

/// Covers the head with skin.
pub(super) fn dress_skin(dressing: &mut Dressing) {
    let painter = Painter::new(dressing);
    close_surface(dressing, &painter);
    fine_layer(dressing, &painter);
}

/// Opaque Gaussians a little under the surface: nothing shines through when the skin stretches.
fn close_surface(dressing: &mut Dressing, painter: &Painter) {
    let surface = dressing.surface;
    let spacing = |point: &SurfacePoint| (painter.spacing(point) * 2.1).max(1.3 * MM * surface.size);
    let mut stream = dressing.stream("closing layer");
    let mut triangles = surface.triangles_of(&SKIN);
    triangles.extend(surface.triangles_of(&[Region::InnerLid]));
    for point in surface.scatter(&triangles, spacing, &mut stream) {
        let sigma = spacing(&point) * 0.62;
        let color = painter.color(&point, dressing.exposure(&point), &mut stream, false);
        let position = point.position - point.normal * (0.3 * spacing(&point));
        dressing.add(point.triangle, flat(position, point.normal, sigma, 0.1 * sigma, color, 0.99));
    }
}

fn fine_layer(dressing: &mut Dressing, painter: &Painter) {
    let surface = dressing.surface;
    let spacing = |point: &SurfacePoint| painter.spacing(point);
    let mut stream = dressing.stream("fine layer");
    let triangles = surface.triangles_of(&SKIN);
    for point in surface.scatter(&triangles, spacing, &mut stream) {
        let sigma = spacing(&point) * 0.62;
        let color = painter.color(&point, dressing.exposure(&point), &mut stream, true);
        dressing.add(point.triangle, flat(point.position, point.normal, sigma, sigma * 0.15, color, 0.97));
    }
}

/// A flat Gaussian on the surface.
pub(super) fn flat(
    position: Vec3,
    normal: Vec3,
    sigma: f32,
    thickness: f32,
    color: Vec3,
    opacity: f32,
) -> Splat {
    Splat {
        position,
        scale: Vec3::new(sigma, sigma, thickness),
        rotation: Quat::from_rotation_arc(Vec3::Z, normal),
        opacity,
        color,
    }
}

/// Knows the colour of every place of the skin.
struct Painter<'a> {
    dressing_landmarks: &'a [Vec3],
    appearance: super::Appearance,
    size: f32,
    lips: Vec<f32>,
    scalp: Vec<f32>,
    blotches: Noise,
    relief: Noise,
    surface: &'a super::Surface<'a>,
}

impl<'a> Painter<'a> {
    fn new(dressing: &Dressing<'a>) -> Self {
        let surface = dressing.surface;
        let mut stream = dressing.stream("skin");
        Self {
            dressing_landmarks: &surface.landmarks,
            appearance: dressing.appearance.clone(),
            size: surface.size,
            lips: surface.signed_distance(&[Region::Lips], 0.02),
            scalp: surface.signed_distance(&[Region::Scalp], 0.03),
            blotches: Noise::new(stream.bits()),
            relief: Noise::new(stream.bits()),
            surface,
        }
    }

    fn spacing(&self, point: &SurfacePoint) -> f32 {
        let _ = self.dressing_landmarks;
        let front = point.normal.z > -0.2 && point.position.z > self.surface.landmarks[0].z;
        let region = self.surface.model.regions[point.triangle as usize];
        let mm = match region {
            Region::Lips | Region::LidMargin => 0.5,
            Region::Skin | Region::Brow if front => 0.8,
            Region::Skin => 1.4,
            Region::Neck => 1.9,
            _ => 2.4,
        };
        mm * MM * self.size
    }

    fn color(&self, point: &SurfacePoint, exposure: Exposure, stream: &mut Stream, fine: bool) -> Vec3 {
        let p = point.position / self.size;
        let a = &self.appearance;
        let lips = self.surface.value(&self.lips, point) / self.size;
        let _scalp = self.surface.value(&self.scalp, point);
        let mut albedo = a.skin * (1.0 + 0.05 * self.blotches.fractal(p * 60.0, 4));
        let lip = ((lips + 0.0008) / 0.0016).clamp(0.0, 1.0);
        albedo = albedo.lerp(a.lips, lip);
        if fine {
            albedo *= 1.0 + stream.uniform(-0.03, 0.03);
        }
        let bump = |q: Vec3| self.relief.fractal(q * 900.0, 2);
        let d = 3e-4;
        let gradient = Vec3::new(
            bump(p + Vec3::X * d) - bump(p - Vec3::X * d),
            bump(p + Vec3::Y * d) - bump(p - Vec3::Y * d),
            bump(p + Vec3::Z * d) - bump(p - Vec3::Z * d),
        );
        let tangent = gradient - point.normal * point.normal.dot(gradient);
        let normal =
            if fine { (point.normal - tangent * 0.12).normalize_or(point.normal) } else { point.normal };
        let material = Material { albedo, wrap: Vec3::new(0.35, 0.15, 0.08), sheen: 0.05, gloss: 14.0 };
        shade(&material, normal, &exposure)
    }
}
