//! Skin: a layer that closes the surface, a finer one with colour and relief, and on top specks and stubble.

use glam::{Quat, Vec3};

use super::Dressing;
use super::Splat;
use super::complexion::Complexion;
use super::specks::{self, Specks};
use super::strand::{Strand, add_strand};
use super::surface::SurfacePoint;
use crate::{Look, Region};

const MM: f32 = 1e-3;

/// Every region covered with skin, including lips.
pub(super) const SKIN: [Region; 6] =
    [Region::Skin, Region::Scalp, Region::Lips, Region::Brow, Region::LidMargin, Region::Neck];

/// Covers the head with skin.
pub(super) fn dress_skin(dressing: &mut Dressing) {
    let complexion = Complexion::new(dressing);
    let face = dressing.surface.triangles_of(&[Region::Skin, Region::Brow]);
    let specks = Specks::new(dressing, &complexion, &face);
    // Each layer has its own random stream, so they can be generated in parallel.
    let here = &*dressing;
    let (fine, (closing, pores)) = rayon::join(
        || fine_layer(here, &complexion, &specks),
        || (closing_layer(here, &complexion), specks::pores(here, &complexion, &face)),
    );
    for (triangle, splat) in closing.into_iter().chain(fine).chain(pores).chain(specks.splats()) {
        dressing.add(triangle, splat);
    }
    if dressing.appearance.stubble > 0.0 {
        stubble(dressing, &complexion);
    }
}

/// Opaque Gaussians slightly below the surface: nothing shines through when the skin stretches.
fn closing_layer(dressing: &Dressing, complexion: &Complexion) -> Vec<(u32, Splat)> {
    let surface = dressing.surface;
    let spacing = |point: &SurfacePoint| complexion.closing_spacing(point);
    let mut stream = dressing.stream("closing layer");
    let mut points = surface.scatter(&surface.triangles_of(&SKIN), spacing, &mut stream);
    points.retain(|point| !complexion.is_rim(point));
    let splat = |point: SurfacePoint| {
        let sigma = spacing(&point) * 0.8;
        let color = complexion.color(&point, &dressing.exposure(&point), &mut stream, false);
        let position = point.position - point.normal * (0.35 * spacing(&point));
        (point.triangle, flat(position, point.normal, sigma, 0.1 * sigma, color, 0.99))
    };
    points.into_iter().map(splat).collect()
}

fn fine_layer(dressing: &Dressing, complexion: &Complexion, specks: &Specks) -> Vec<(u32, Splat)> {
    let surface = dressing.surface;
    let spacing = |point: &SurfacePoint| complexion.spacing(point);
    let mut stream = dressing.stream("fine layer");
    let points = surface.scatter(&surface.triangles_of(&SKIN), spacing, &mut stream);
    let splat = |point: SurfacePoint| {
        let sigma = spacing(&point) * 0.66;
        let color = complexion.color(&point, &dressing.exposure(&point), &mut stream, true);
        let color = color * specks.tint(point.position);
        let position = complexion.position(&point);
        (point.triangle, flat(position, point.normal, sigma, sigma * 0.15, color, 0.97))
    };
    points.into_iter().map(splat).collect()
}

fn stubble(dressing: &mut Dressing, complexion: &Complexion) {
    let surface = dressing.surface;
    let size = surface.size;
    let grown = dressing.appearance.stubble;
    let mut stream = dressing.stream("stubble");
    let skin = surface.triangles_of(&[Region::Skin, Region::Neck]);
    let spacing = |point: &SurfacePoint| if complexion.beard(point) > 0.02 { 1.15 * MM * size } else { 0.0 };
    for root in surface.scatter(&skin, spacing, &mut stream) {
        if stream.unit() > complexion.beard(&root) * 1.2 {
            continue;
        }
        let down = -Vec3::Y - root.normal * root.normal.dot(-Vec3::Y);
        let jitter = Vec3::new(stream.normal(), stream.normal(), stream.normal()) * 0.25;
        let direction = (down + root.normal * 0.7 + jitter).normalize_or(root.normal);
        let length = (0.5 + 1.3 * grown) * stream.uniform(0.6, 1.2) * MM * size;
        let (width, opacity) = if dressing.look == Look::First { (0.055, 0.62) } else { (0.075, 0.8) };
        let base = root.position + root.normal * (0.08 * MM * size);
        let albedo = dressing.appearance.brows * stream.uniform(0.7, 1.6);
        let strand = Strand {
            points: &[base, base + direction * length],
            width: width * MM * size,
            taper: 1.0,
            opacity,
            albedo: [albedo, albedo],
            gloss: 0.1,
            outward: Vec3::ZERO,
        };
        add_strand(dressing, root.triangle, &strand, &dressing.exposure(&root));
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
