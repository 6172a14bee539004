//! Hairs: chains of needle-like Gaussians.

use glam::Vec3;

use super::Dressing;
use super::Splat;
use super::light::{Exposure, HAIR_LIGHTS, tone_mapped};
use super::surface::rotation_along;

/// One hair, or a wisp drawn as one.
pub(super) struct Strand<'a> {
    /// From root to tip, at least two points.
    pub points: &'a [Vec3],
    /// Standard deviation of the cross-section at the root, metres; the tip tapers to `taper` of it.
    pub width: f32,
    pub taper: f32,
    pub opacity: f32,
    /// Linear sRGB reflectance at the root and at the tip.
    pub albedo: [Vec3; 2],
    /// Strength of the highlight along the hair.
    pub gloss: f32,
    /// Outward direction, for hair that lies on the head; zero for free-standing hair.
    pub outward: Vec3,
}

/// Adds a strand bound to `triangle`.
pub(super) fn add_strand(dressing: &mut Dressing, triangle: u32, strand: &Strand, exposure: &Exposure) {
    let segments = strand.points.len().saturating_sub(1);
    for (i, ends) in strand.points.windows(2).enumerate() {
        let along = ends[1] - ends[0];
        let s = (i as f32 + 0.5) / segments as f32;
        let root = if strand.outward == Vec3::ZERO { 1.0 } else { 0.4 + 0.6 * (s * 5.0).min(1.0) };
        let width = strand.width * root * (1.0 + (strand.taper - 1.0) * s);
        let color = hair_color(strand, along.normalize_or(Vec3::Y), s, exposure);
        // Segments overlap by half, which hides the joints.
        let scale = Vec3::new(along.length() * 0.42, width, width);
        let splat = Splat {
            position: (ends[0] + ends[1]) * 0.5,
            scale,
            rotation: rotation_along(along, Vec3::Z),
            opacity: strand.opacity * (1.0 - 0.35 * s * s) * (0.4 + 0.6 * root),
            color,
        };
        dressing.add(triangle, splat);
    }
}

/// Kajiya and Kay, *Rendering Fur with Three Dimensional Textures* (1989), seen from the front.
fn hair_color(strand: &Strand, tangent: Vec3, s: f32, exposure: &Exposure) -> Vec3 {
    let albedo = strand.albedo[0].lerp(strand.albedo[1], s);
    let lights = &HAIR_LIGHTS;
    let mut light = lights.ambient * exposure.sky;
    let mut shine = 0.0;
    for (direction, color, seen) in
        [(lights.key, lights.key_color, exposure.key), (lights.fill, lights.fill_color, exposure.fill)]
    {
        let toward = direction.normalize();
        let cosine = tangent.dot(toward);
        let sine = (1.0 - cosine * cosine).max(0.0).sqrt();
        // The far side of the head is shadowed by the hair around it.
        let facing = if strand.outward == Vec3::ZERO {
            1.0
        } else {
            (strand.outward.dot(toward) * 0.75 + 0.35).clamp(0.0, 1.0)
        };
        light += color * (sine * seen * facing);
        let half = (toward + Vec3::Z).normalize();
        let along = tangent.dot(half);
        shine += libm::powf((1.0 - along * along).max(0.0), 40.0) * seen * facing * color.y;
    }
    tone_mapped(albedo * light * 1.25 + (albedo * 0.6 + 0.04) * (shine * strand.gloss))
}
