//! Skin: a layer that closes the surface, a finer one that carries colour and relief, and on it pores, freckles, moles
//! and stubble.

use glam::{Quat, Vec3};

use super::Dressing;
use super::complexion::Complexion;
use super::strand::{Strand, add_strand};
use super::surface::SurfacePoint;
use crate::Region;
use crate::binding::Splat;

const MM: f32 = 1e-3;

/// Everything that is covered with skin, lips included.
pub(super) const SKIN: [Region; 6] =
    [Region::Skin, Region::Scalp, Region::Lips, Region::Brow, Region::LidMargin, Region::Neck];

/// Covers the head with skin.
pub(super) fn dress_skin(dressing: &mut Dressing) {
    let complexion = Complexion::new(dressing);
    close_surface(dressing, &complexion);
    fine_layer(dressing, &complexion);
    let face = dressing.surface.triangles_of(&[Region::Skin, Region::Brow]);
    pores(dressing, &complexion, &face);
    if dressing.appearance.freckles > 0.0 {
        freckles(dressing, &complexion, &face);
    }
    moles(dressing, &complexion, &face);
    if dressing.appearance.stubble > 0.0 {
        stubble(dressing, &complexion);
    }
}

/// Opaque Gaussians a little under the surface: nothing shines through when the skin stretches.
fn close_surface(dressing: &mut Dressing, complexion: &Complexion) {
    let surface = dressing.surface;
    let spacing = |point: &SurfacePoint| (complexion.spacing(point) * 2.0).max(1.2 * MM * surface.size);
    let mut stream = dressing.stream("closing layer");
    for point in surface.scatter(&surface.triangles_of(&SKIN), spacing, &mut stream) {
        if complexion.is_rim(&point) {
            continue;
        }
        let sigma = spacing(&point) * 0.8;
        let color = complexion.color(&point, &dressing.exposure(&point), &mut stream, false);
        let position = point.position - point.normal * (0.35 * spacing(&point));
        dressing.add(point.triangle, flat(position, point.normal, sigma, 0.1 * sigma, color, 0.99));
    }
}

fn fine_layer(dressing: &mut Dressing, complexion: &Complexion) {
    let surface = dressing.surface;
    let spacing = |point: &SurfacePoint| complexion.spacing(point);
    let mut stream = dressing.stream("fine layer");
    for point in surface.scatter(&surface.triangles_of(&SKIN), spacing, &mut stream) {
        let sigma = spacing(&point) * 0.66;
        let color = complexion.color(&point, &dressing.exposure(&point), &mut stream, true);
        let position = complexion.position(&point);
        dressing.add(point.triangle, flat(position, point.normal, sigma, sigma * 0.15, color, 0.97));
    }
}

fn pores(dressing: &mut Dressing, complexion: &Complexion, face: &[u32]) {
    let surface = dressing.surface;
    let size = surface.size;
    let mut stream = dressing.stream("pores");
    for point in surface.scatter(face, |_| 1.3 * MM * size, &mut stream) {
        if stream.unit() > complexion.pores(point.position) {
            continue;
        }
        let lit = complexion.color(&point, &dressing.exposure(&point), &mut stream, true);
        let color = lit * Vec3::new(0.80, 0.72, 0.70);
        let sigma = stream.uniform(0.11, 0.19) * MM * size;
        let position = point.position + point.normal * (0.12 * MM * size);
        dressing.add(point.triangle, flat(position, point.normal, sigma, sigma * 0.2, color, 0.38));
    }
}

fn freckles(dressing: &mut Dressing, complexion: &Complexion, face: &[u32]) {
    let surface = dressing.surface;
    let size = surface.size;
    let mut stream = dressing.stream("freckles");
    for point in surface.scatter(face, |_| 2.3 * MM * size, &mut stream) {
        let likely = complexion.sun(point.position) * dressing.appearance.freckles;
        if stream.unit() > likely || complexion.lip(&point) > -2.0 * MM {
            continue;
        }
        let lit = complexion.color(&point, &dressing.exposure(&point), &mut stream, false);
        let color = lit * Vec3::new(0.78, 0.62, 0.52);
        let sigma = stream.uniform(0.3, 0.75) * MM * size;
        let position = point.position + point.normal * (0.14 * MM * size);
        let opacity = stream.uniform(0.18, 0.5);
        dressing.add(point.triangle, flat(position, point.normal, sigma, sigma * 0.1, color, opacity));
    }
}

fn moles(dressing: &mut Dressing, complexion: &Complexion, face: &[u32]) {
    let surface = dressing.surface;
    let size = surface.size;
    let mut stream = dressing.stream("moles");
    for point in surface.scatter(face, |_| 16.0 * MM * size, &mut stream) {
        if stream.unit() > 0.07 || complexion.lip(&point) > -3.0 * MM {
            continue;
        }
        let lit = complexion.color(&point, &dressing.exposure(&point), &mut stream, false);
        let sigma = stream.uniform(0.35, 0.8) * MM * size;
        let position = point.position + point.normal * (0.25 * MM * size);
        let color = lit * Vec3::new(0.48, 0.36, 0.31);
        dressing.add(point.triangle, flat(position, point.normal, sigma, sigma * 0.5, color, 0.75));
    }
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
        let base = root.position + root.normal * (0.08 * MM * size);
        let albedo = dressing.appearance.brows * stream.uniform(0.7, 1.6);
        let strand = Strand {
            points: &[base, base + direction * length],
            width: 0.055 * MM * size,
            taper: 1.0,
            opacity: 0.62,
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
