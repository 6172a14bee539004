//! Light on skin that moves: as surfaces turn and fold, they darken and brighten. Nothing of it is motion.

use glam::{Quat, Vec3};
use rayon::prelude::*;
use serde::Serialize;
use srflow_splat::{Gaussians, scale_colour};

use super::folds::{Crease, Intensity, Strengths, creases};
use super::light::{Exposure, Lit, OPAQUE, SkinLight, Studio, bake};
use super::surface::unit_normals;
use super::{Dressing, Splat};
use crate::{HeadModel, HeadPose, ShapedHead, Side, TriangleFrame};

/// How the colours of a head's Gaussians change as it moves in light that stands still. The head's shadows on itself are those at rest, and what
/// some action units change of them.
#[derive(Debug, Clone)]
pub struct Shading {
    studio: &'static Studio,
    /// Light that reaches each vertex at rest; `None` for those without a lit surface.
    lit: Vec<Option<Lit>>,
    exposures: Vec<Exposure>,
    shadows: Vec<Shadows>,
    /// The vertices on which shadows change.
    changing: Vec<u32>,
    /// Light on each vertex at rest.
    at_rest: Vec<Vec3>,
    /// Linear reflectance of the skin.
    albedo: Vec3,
    /// Place of each Gaussian that changes, the first ones, on its triangle, in barycentric coordinates.
    places: Vec<(u32, Vec3)>,
    creases: Vec<Crease>,
    strengths: Strengths,
    /// Rotation of each triangle at rest.
    rest: Vec<Quat>,
}

/// What an action unit changes of the exposure of the vertices of one half of the face.
#[derive(Debug, Clone)]
struct Shadows {
    intensity: Intensity,
    /// Vertices, and the change at full intensity.
    changes: Vec<(u32, Exposure)>,
}

/// Action units that change shadows.
const UNITS: [u8; 5] = [43, 4, 6, 9, 12];

/// Vertices that a unit moves less keep their exposure, metres.
const MOVED: f32 = 5e-4;

/// Least and greatest factor of light.
const FACTORS: (f32, f32) = (0.25, 6.0);

/// Gaussians whose colours are computed together.
const CHUNK: usize = 4096;

impl Shading {
    /// Of the Gaussians of a head that is dressed so far: skin, then eyes.
    pub(super) fn new(dressing: &Dressing, shaped: &ShapedHead) -> Self {
        let surface = dressing.surface;
        let studio = dressing.studio();
        let (creases, strengths) = creases(dressing, dressing.lit);
        let lit: Vec<Option<Lit>> = dressing
            .exposures
            .iter()
            .zip(surface.corners_of(&OPAQUE))
            .map(|(exposure, is_lit)| is_lit.then(|| Lit::of(studio, exposure)))
            .collect();
        let albedo = dressing.appearance.skin;
        let at_rest = lit
            .iter()
            .zip(&surface.normals)
            .map(|(lit, normal)| lit.map_or(Vec3::ONE, |lit| lit.on(*normal, albedo)))
            .collect();
        let place = |(triangle, splat): &(u32, Splat)| {
            (*triangle, super::nearest_weights(surface.corners(*triangle), splat.position))
        };
        let places = dressing.splats[..dressing.lit].iter().map(place).collect();
        let rest = surface.frames.iter().map(|frame| frame.rotation).collect();
        let shadows: Vec<Shadows> =
            UNITS.iter().filter_map(|&number| Shadows::of(dressing, shaped, number)).flatten().collect();
        let mut changing: Vec<u32> =
            shadows.iter().flat_map(|unit| unit.changes.iter().map(|c| c.0)).collect();
        changing.sort_unstable();
        changing.dedup();
        let exposures = dressing.exposures.clone();
        Self { studio, lit, exposures, shadows, changing, at_rest, albedo, places, creases, strengths, rest }
    }

    /// Light that reaches the vertices with these weights of expressions.
    fn lit(&self, expressions: &[f32]) -> std::borrow::Cow<'_, [Option<Lit>]> {
        let shown: Vec<(&Shadows, f32)> = self
            .shadows
            .iter()
            .map(|shadows| (shadows, shadows.intensity.at(expressions)))
            .filter(|(_, intensity)| *intensity != 0.0)
            .collect();
        if shown.is_empty() {
            return (&self.lit).into();
        }
        let mut exposures = self.exposures.clone();
        for (shadows, intensity) in shown {
            for &(vertex, change) in &shadows.changes {
                let exposure = &mut exposures[vertex as usize];
                *exposure = *exposure + change * intensity;
            }
        }
        let mut lit = self.lit.clone();
        for &vertex in &self.changing {
            let vertex = vertex as usize;
            lit[vertex] = lit[vertex].map(|_| Lit::of(self.studio, &exposures[vertex].clamped()));
        }
        lit.into()
    }

    /// The numbers behind [`Shading::shade`].
    pub fn tables(&self) -> ShadingTables<'_> {
        let parts = |exposure: &Exposure| Vec3::new(exposure.sky, exposure.key, exposure.fill);
        let exposures = self.exposures.iter().zip(&self.lit);
        let changes =
            |unit: &Shadows| unit.changes.iter().map(|(vertex, change)| (*vertex, parts(change))).collect();
        ShadingTables {
            facts: ShadingFacts {
                light: SkinLight::new(self.studio),
                albedo: self.albedo.to_array(),
                shadows: self.shadows.iter().map(|unit| &unit.intensity).collect(),
                folds: &self.strengths,
            },
            exposures: exposures.map(|(exposure, lit)| lit.map_or(Vec3::NAN, |_| parts(exposure))).collect(),
            shadows: self.shadows.iter().map(changes).collect(),
            places: self.places.iter().map(|place| place.1).collect(),
            creases: &self.creases,
        }
    }

    /// Shades the Gaussians of a head of `model` in `pose`, whose vertices and triangles are these.
    pub fn shade(
        &self,
        model: &HeadModel,
        pose: &HeadPose,
        vertices: &[Vec3],
        frames: &[TriangleFrame],
        gaussians: &mut Gaussians,
    ) {
        let normals = unit_normals(vertices, model);
        let lit = self.lit(&pose.expressions);
        let factors: Vec<Vec3> = (0..normals.len())
            .into_par_iter()
            .with_min_len(CHUNK)
            .map(|v| lit[v].map_or(Vec3::ONE, |lit| coded(lit.on(normals[v], self.albedo) / self.at_rest[v])))
            .collect();
        let strengths = self.strengths.at(&pose.expressions);
        let coefficients = gaussians.sh_len();
        let shaded = self.places.len().min(gaussians.len());
        let colours = &mut gaussians.sh[..shaded * coefficients];
        colours.par_chunks_mut(CHUNK * coefficients).zip(self.places.par_chunks(CHUNK)).enumerate().for_each(
            |(chunk, (colours, places))| {
                let first = chunk * CHUNK;
                let start = self.creases.partition_point(|crease| (crease.gaussian as usize) < first);
                let mut creases = self.creases[start..].iter().peekable();
                for (number, (colour, &(triangle, weights))) in
                    colours.chunks_mut(coefficients).zip(places).enumerate()
                {
                    let corners = model.triangles[triangle as usize].map(|v| v as usize);
                    let (mut slope, mut seen) = (Vec3::ZERO, 1.0);
                    while let Some(crease) =
                        creases.next_if(|crease| crease.gaussian as usize == first + number)
                    {
                        let strength = strengths[crease.fold as usize];
                        slope += crease.slope * strength;
                        seen *= 1.0 - crease.cavity * strength;
                    }
                    let mix = |of: &dyn Fn(usize) -> Vec3| {
                        of(corners[0]) * weights.x + of(corners[1]) * weights.y + of(corners[2]) * weights.z
                    };
                    let mut factor = mix(&|v| factors[v]);
                    if slope != Vec3::ZERO || seen < 1.0 {
                        let normal = mix(&|v| normals[v]).normalize_or(Vec3::Y);
                        let turned =
                            frames[triangle as usize].rotation * self.rest[triangle as usize].inverse();
                        let folded = (normal - turned * slope).normalize_or(normal);
                        let [a, b, c] = corners;
                        if let (Some(a), Some(b), Some(c)) = (lit[a], lit[b], lit[c]) {
                            let lit = Lit::mixed([a, b, c], weights);
                            let light = lit.on(folded, self.albedo) / lit.on(normal, self.albedo);
                            // Light in a groove was reflected by skin before, which absorbs blue.
                            let depth = 1.0 - seen;
                            let groove = Vec3::ONE - Vec3::new(0.8, 1.0, 1.1) * depth;
                            factor *= coded(light * groove);
                        }
                    }
                    // sRGB's curve is a power of the colour and 0.055.
                    scale_colour(colour, factor.to_array(), 0.555);
                }
            },
        );
    }
}

/// What [`Shading`] computes with, for programs that compute it themselves.
#[derive(Debug, Clone)]
pub struct ShadingTables<'a> {
    pub facts: ShadingFacts<'a>,
    /// Part of the sky, the soft box and the fill light that reaches each vertex at rest, 0 to 1; NaN for vertices that are not lit.
    pub exposures: Vec<Vec3>,
    /// What each of `facts.shadows` changes of the exposures at full intensity: vertices and changes.
    pub shadows: Vec<Vec<(u32, Vec3)>>,
    /// Place of each Gaussian that changes, the first ones, on its triangle, in barycentric coordinates.
    pub places: Vec<Vec3>,
    pub creases: &'a [Crease],
}

/// The part of [`ShadingTables`] that is a few numbers.
#[derive(Debug, Clone, Serialize)]
pub struct ShadingFacts<'a> {
    light: SkinLight,
    albedo: [f32; 3],
    /// Intensity of the units that change shadows, by unit, left before right.
    shadows: Vec<&'a Intensity>,
    folds: &'a Strengths,
}

impl Shadows {
    /// Of action unit `number`, on the left and the right half; `None` where the model lacks it.
    fn of(dressing: &Dressing, shaped: &ShapedHead, number: u8) -> Option<[Self; 2]> {
        let surface = dressing.surface;
        let model = surface.model;
        let half = |side| Intensity::of(model, number, side);
        let intensities = [half(Side::Left)?, half(Side::Right)?];
        let mut pose = model.pose_of_action_units(&[(number, Side::Both, 1.0)]).ok()?;
        pose.joints.clear();
        let mut vertices = Vec::new();
        model.vertices(shaped, &pose, &mut vertices);
        let normals = unit_normals(&vertices, model);
        let moved = |v: usize| vertices[v].distance(surface.vertices[v]) > MOVED * surface.size;
        let after = bake(dressing.studio(), surface, &vertices, &normals, moved);
        let change = |v: usize| match moved(v) {
            true => after[v] + dressing.unsmoothed[v] * -1.0,
            false => Exposure::default(),
        };
        let mut changes: Vec<Exposure> = (0..after.len()).map(change).collect();
        surface.smooth(&mut changes);
        let shown = |change: &Exposure| [change.sky, change.key, change.fill].iter().any(|c| c.abs() > 4e-3);
        let mut halves = intensities.map(|intensity| Self { intensity, changes: Vec::new() });
        for (vertex, change) in changes.into_iter().enumerate().filter(|(_, change)| shown(change)) {
            let right = surface.vertices[vertex].x < 0.0;
            halves[usize::from(right)].changes.push((vertex as u32, change));
        }
        Some(halves)
    }
}

/// The factor of an sRGB value and 0.055 for a factor of light.
fn coded(light: Vec3) -> Vec3 {
    let channel = |x: f32| libm::powf(x.clamp(FACTORS.0, FACTORS.1), 1.0 / 2.4);
    Vec3::new(channel(light.x), channel(light.y), channel(light.z))
}
