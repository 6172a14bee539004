//! Dressing a head model with Gaussians: skin, eyes, mouth, brows, lashes and hair.

mod appearance;
mod brows;
mod complexion;
mod eyes;
mod folds;
mod hair;
mod hair_shadow;
mod lashes;
mod light;
mod mouth;
mod noise;
mod occlusion;
mod painted;
mod shading;
mod skin;
mod specks;
mod strand;
mod surface;

use glam::{Quat, Vec3};
use srflow_core::random::{Key, Stream};

use crate::model_source::landmark_file;
use crate::{HeadError, HeadModel, Look, Region, ShapedHead};
use appearance::Appearance;
pub use folds::Crease;
use hair_shadow::HairShadow;
use light::{Exposure, Studio};
pub use shading::{Shading, ShadingFacts, ShadingTables};
pub(crate) use surface::cell_of;
use surface::{Surface, SurfacePoint};

/// One Gaussian in world units.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Splat {
    pub position: Vec3,
    pub scale: Vec3,
    pub rotation: Quat,
    pub opacity: f32,
    /// sRGB, `0..=1`.
    pub color: Vec3,
}

/// The Gaussians of a head at rest.
#[derive(Debug, Clone)]
pub struct Dress {
    /// Each with the number of the triangle that carries it.
    pub splats: Vec<(u32, Splat)>,
    /// How their colours change as the head moves; `None` where they do not.
    pub shading: Option<Shading>,
}

/// The Gaussians that dress the head of `shaped` as the person of `seed`, or those or the colours that come with the model. The model
/// must be valid.
///
/// # Errors
/// [`HeadError::Landmarks`] when the model has neither colours nor 68 landmarks.
pub fn dress(model: &HeadModel, shaped: &ShapedHead, seed: u64, look: Look) -> Result<Dress, HeadError> {
    if !model.carried.is_empty() {
        let first = model.triangles.len() - model.carried.len();
        let splats = (first as u32..).zip(model.carried.iter().copied()).collect();
        return Ok(Dress { splats, shading: None });
    }
    if look != Look::First && model.colors.is_some() {
        return Ok(Dress { splats: painted::painted(model, shaped, seed), shading: None });
    }
    if model.landmarks.len() < 68 {
        let (name, found) = (model.name.clone(), model.landmarks.len());
        return Err(HeadError::Landmarks { file: landmark_file(&name), model: name, found });
    }
    let surface = Surface::new(model, shaped);
    let unsmoothed = light::bake(Studio::of(look), &surface, surface.vertices, &surface.normals, |_| true);
    let mut exposures = unsmoothed.clone();
    surface.smooth(&mut exposures);
    let mut dressing = Dressing {
        surface: &surface,
        appearance: Appearance::of(seed, look),
        exposures,
        unsmoothed,
        look,
        seed,
        lit: 0,
        splats: Vec::new(),
    };
    if look == Look::First {
        dress_face(&mut dressing);
        hair::dress_hair(&mut dressing);
        return Ok(Dress { splats: dressing.splats, shading: None });
    }
    // Hair first: it shades the face.
    hair::dress_hair(&mut dressing);
    let hair = std::mem::take(&mut dressing.splats);
    dressing.shade_by(&hair);
    dress_face(&mut dressing);
    let shading = Shading::new(&dressing, shaped);
    dressing.splats.extend(hair);
    Ok(Dress { splats: dressing.splats, shading: Some(shading) })
}

/// Dresses all but the hair: skin and eyes first.
fn dress_face(dressing: &mut Dressing) {
    skin::dress_skin(dressing);
    eyes::dress_eyes(dressing);
    dressing.lit = dressing.splats.len();
    mouth::dress_mouth(dressing);
    brows::dress_brows(dressing);
    lashes::dress_lashes(dressing);
}

/// A head while it is being dressed.
struct Dressing<'a> {
    surface: &'a Surface<'a>,
    appearance: Appearance,
    /// Exposure of the vertices at rest, and the same before it is smoothed.
    exposures: Vec<Exposure>,
    unsmoothed: Vec<Exposure>,
    look: Look,
    seed: u64,
    splats: Vec<(u32, Splat)>,
    /// Number of Gaussians of skin and eyes, the first ones.
    lit: usize,
}

impl Dressing<'_> {
    /// Takes the light away that `hair` keeps from the face.
    fn shade_by(&mut self, hair: &[(u32, Splat)]) {
        let shadow = HairShadow::new(hair, self.surface.size);
        let is_skin = self.surface.corners_of(&skin::SKIN);
        let light = light::through_hair(
            self.studio(),
            self.surface,
            |p, direction| shadow.light(p, direction),
            |v| is_skin[v],
        );
        for (exposure, light) in self.exposures.iter_mut().zip(light) {
            *exposure = exposure.times(light);
        }
    }

    fn studio(&self) -> &'static Studio {
        Studio::of(self.look)
    }

    fn stream(&self, purpose: &str) -> Stream {
        Key::new(self.seed).stream(purpose)
    }

    fn exposure(&self, point: &SurfacePoint) -> Exposure {
        self.surface.value(&self.exposures, point)
    }

    fn add(&mut self, triangle: u32, splat: Splat) {
        self.splats.push((triangle, splat));
    }
}

/// 0 up to 0, 1 from 1 on, smooth between.
fn smoothstep(t: f32) -> f32 {
    let t = t.clamp(0.0, 1.0);
    t * t * (3.0 - 2.0 * t)
}

/// The curve through `points` at `t`, from 0 at the first point to 1 at the last.
fn catmull_rom(points: &[Vec3], t: f32) -> Vec3 {
    let last = points.len() - 1;
    let at = t.clamp(0.0, 1.0) * last as f32;
    let i = (at as usize).min(last - 1);
    let t = at - i as f32;
    let (p1, p2) = (points[i], points[i + 1]);
    let p0 = if i > 0 { points[i - 1] } else { p1 * 2.0 - p2 };
    let p3 = if i + 2 <= last { points[i + 2] } else { p2 * 2.0 - p1 };
    let (a, b) = (p2 - p0, p0 * 2.0 - p1 * 5.0 + p2 * 4.0 - p3);
    (p1 * 2.0 + a * t + b * (t * t) + (p1 * 3.0 - p0 - p2 * 3.0 + p3) * (t * t * t)) * 0.5
}

/// Triangles of these regions whose centroid is within `reach` of `p`.
fn near_triangles(surface: &Surface, regions: &[Region], p: Vec3, reach: f32) -> Vec<u32> {
    let mut triangles = surface.triangles_of(regions);
    triangles.retain(|&t| surface.frames[t as usize].origin.distance(p) < reach);
    triangles
}

/// The point of `triangles` nearest to `p`.
fn nearest_point(surface: &Surface, triangles: &[u32], p: Vec3) -> Option<SurfacePoint> {
    let mut nearest = None;
    let mut least = f32::INFINITY;
    for &t in triangles {
        // No point of a triangle is nearer than its centroid by more than its radius; a little more, for rounding.
        let reach = least.sqrt() * 1.001 + surface.radii[t as usize] * 1.001;
        if surface.frames[t as usize].origin.distance_squared(p) > reach * reach {
            continue;
        }
        let [a, b, c] = surface.corners(t);
        let weights = nearest_weights([a, b, c], p);
        let distance = (a * weights.x + b * weights.y + c * weights.z).distance_squared(p);
        if distance < least {
            (nearest, least) = (Some((t, weights)), distance);
        }
    }
    nearest.map(|(t, weights)| surface.point(t, weights))
}

/// Barycentric coordinates of the point of a triangle nearest to `p` (Ericson, *Real-Time Collision Detection*, 5.1.5).
pub(crate) fn nearest_weights([a, b, c]: [Vec3; 3], p: Vec3) -> Vec3 {
    let (ab, ac) = (b - a, c - a);
    let (d1, d2) = (ab.dot(p - a), ac.dot(p - a));
    let (d3, d4) = (ab.dot(p - b), ac.dot(p - b));
    let (d5, d6) = (ab.dot(p - c), ac.dot(p - c));
    if d1 <= 0.0 && d2 <= 0.0 {
        return Vec3::X;
    }
    if d3 >= 0.0 && d4 <= d3 {
        return Vec3::Y;
    }
    if d6 >= 0.0 && d5 <= d6 {
        return Vec3::Z;
    }
    let (va, vb, vc) = (d3 * d6 - d5 * d4, d5 * d2 - d1 * d6, d1 * d4 - d3 * d2);
    if vc <= 0.0 && d1 >= 0.0 && d3 <= 0.0 {
        let v = d1 / (d1 - d3).max(f32::MIN_POSITIVE);
        return Vec3::new(1.0 - v, v, 0.0);
    }
    if vb <= 0.0 && d2 >= 0.0 && d6 <= 0.0 {
        let w = d2 / (d2 - d6).max(f32::MIN_POSITIVE);
        return Vec3::new(1.0 - w, 0.0, w);
    }
    if va <= 0.0 && d4 - d3 >= 0.0 && d5 - d6 >= 0.0 {
        let w = (d4 - d3) / ((d4 - d3) + (d5 - d6)).max(f32::MIN_POSITIVE);
        return Vec3::new(0.0, 1.0 - w, w);
    }
    let scale = (va + vb + vc).max(f32::MIN_POSITIVE).recip();
    Vec3::new(1.0 - (vb + vc) * scale, vb * scale, vc * scale)
}
