//! Gaussians in the colours that come with a mesh, on all of it.

use glam::Vec3;
use rayon::prelude::*;
use srflow_core::random::Key;

use super::Splat;
use super::skin::flat;
use super::surface::{Surface, SurfacePoint};
use crate::{HeadModel, Region, ShapedHead};

/// Distance between Gaussians of the face, metres.
const SPACING: f32 = 0.55e-3;

/// Around the middle of the eyes, metres, Gaussians are that dense; beyond, their distance grows in proportion.
const FACE: f32 = 0.15;

/// About as many Gaussians as dress a built-in head.
const MOST: f32 = 500_000.0;

/// Discs of diameter 1 on a unit of area, when no more fit.
const DENSITY: f32 = 0.7;

/// Distance of the Gaussians below the others, relative to that of those.
const BELOW: f32 = 2.2;

/// Alpha below which nothing is seen.
const INVISIBLE: f32 = 0.05;

/// The Gaussians, with the triangles that carry them.
pub(super) fn painted(model: &HeadModel, shaped: &ShapedHead, seed: u64) -> Vec<(u32, Splat)> {
    let Some(colors) = &model.colors else { return Vec::new() };
    let surface = Surface::new(model, shaped);
    let triangles: Vec<u32> = (0..model.triangles.len() as u32)
        .filter(|t| model.regions[*t as usize] != Region::Clear || colors.has_texture(*t))
        .collect();
    let eyes = model.eye_centres(shaped).map(|[left, right]| (left + right) * 0.5);
    let face = |p: Vec3| eyes.map_or(1.0, |eyes| (p.distance(eyes) / FACE).max(1.0));
    let expected: f32 = triangles
        .iter()
        .map(|t| {
            let [a, b, c] = surface.corners(*t);
            let spacing = SPACING * face((a + b + c) / 3.0);
            DENSITY * 0.5 * (b - a).cross(c - a).length() / (spacing * spacing)
        })
        .sum();
    let spacing = SPACING * (expected / MOST).sqrt().max(1.0);
    let spacing = |point: &SurfacePoint| spacing * face(point.position);
    let layer = |purpose: &str, apart: f32| {
        let spacing = |point: &SurfacePoint| apart * spacing(point);
        let points = surface.scatter(&triangles, spacing, &mut Key::new(seed).stream(purpose));
        points.into_par_iter().map(|point| (point, spacing(&point))).collect::<Vec<_>>()
    };
    let (below, above) = rayon::join(|| layer("painted below", BELOW), || layer("painted", 1.0));
    let color = |point: &SurfacePoint, reach: f32| {
        let vertices = model.triangles[point.triangle as usize];
        colors.mean(point.triangle, vertices, model.texture.as_ref(), around(&surface, point, reach))
    };
    // Nothing shines through where the surface stretches.
    let below = below.into_par_iter().filter_map(|(point, spacing)| {
        let color = color(&point, 0.8 * spacing);
        let sigma = 0.8 * spacing;
        let position = point.position - point.normal * (0.35 * spacing);
        (color.w >= 0.99).then(|| {
            (point.triangle, flat(position, point.normal, sigma, 0.1 * sigma, color.truncate(), 0.99))
        })
    });
    let above = above.into_par_iter().filter_map(|(point, spacing)| {
        let sigma = 0.66 * spacing;
        let color = color(&point, sigma);
        (color.w >= INVISIBLE).then(|| {
            let opacity = 0.97 * color.w;
            (
                point.triangle,
                flat(point.position, point.normal, sigma, 0.15 * sigma, color.truncate(), opacity),
            )
        })
    });
    below.chain(above).collect()
}

/// The point and six around it, at most `reach` away, on its triangle.
fn around<'a>(surface: &'a Surface, point: &'a SurfacePoint, reach: f32) -> impl Iterator<Item = Vec3> + 'a {
    let [a, b, c] = surface.corners(point.triangle);
    let edges = [b - a, c - b, a - c].map(|edge| edge.length().max(f32::MIN_POSITIVE));
    let steps = [
        Vec3::new(-1.0, 1.0, 0.0) / edges[0],
        Vec3::new(0.0, -1.0, 1.0) / edges[1],
        Vec3::new(1.0, 0.0, -1.0) / edges[2],
    ];
    let steps = steps.into_iter().flat_map(|step| [step, -step]);
    std::iter::once(Vec3::ZERO).chain(steps).map(move |step| {
        let weights = (point.weights + step * reach).max(Vec3::ZERO);
        weights / weights.element_sum()
    })
}
