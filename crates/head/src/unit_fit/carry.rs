//! The action units of the built-in head, carried onto the surface of another head.

use glam::{DVec3, Vec3};
use rayon::prelude::*;

use super::surface::Surface;
use super::warp::Warp;
use crate::{HeadModel, HeadPose, Look, Region, Side};

/// Landmarks that correspond between heads.
const LANDMARKS: usize = 68;

/// Vertices at which deformations are compared; of models with more, every second one or fewer.
const MOST_SAMPLES: usize = 3000;

/// Size of the cells in which nearest points are searched, and width of the map's kernel, in distances between the eyes.
const CELL: f64 = 0.1;
const KERNEL: f64 = 0.6;

/// Distance between a vertex and the carried surface at which the vertex counts 1/e, in distances between the eyes.
const GAP: f64 = 0.06;

/// Regions whose skin corresponds between heads.
pub(super) const SKIN: [Region; 6] =
    [Region::Skin, Region::Lips, Region::Brow, Region::LidMargin, Region::Scalp, Region::Neck];

/// Vertices of a model where the deformations of the built-in head are known.
pub(super) struct Carried {
    /// Vertices, in ascending order, and the share of the surface that each stands for; the shares sum to 1.
    pub samples: Vec<(u32, f64)>,
    /// Distance between each sample and the carried surface, relative to the distance between the eyes.
    pub distances: Vec<f64>,
    pub units: Vec<CarriedUnit>,
}

/// The deformation of one action unit, metres, in the model's neutral pose.
pub(super) struct CarriedUnit {
    pub number: u8,
    pub side: Side,
    /// Displacement of each sample.
    pub surface: Vec<DVec3>,
    /// Displacements of the 68 landmarks.
    pub landmarks: Vec<DVec3>,
}

impl Carried {
    /// The units of the average built-in head of a look on `model`; `None` for a model without landmarks, or one whose face is nowhere near.
    ///
    /// The 68 landmarks give a smooth map of the built-in head's space onto the model's. A point moves as the map moves it: from where
    /// the map puts the neutral point to where it puts the displaced one. A vertex of the model's skin takes the displacement of
    /// the nearest point of the mapped surface, and counts the less the further away that is.
    pub(super) fn onto(model: &HeadModel, look: Look) -> Option<Self> {
        Self::onto_regions(model, look, &SKIN, MOST_SAMPLES)
    }

    /// As [`Carried::onto`], on every vertex of these regions.
    pub(super) fn onto_all(model: &HeadModel, look: Look, regions: &[Region]) -> Option<Self> {
        Self::onto_regions(model, look, regions, usize::MAX)
    }

    fn onto_regions(model: &HeadModel, look: Look, regions: &[Region], most: usize) -> Option<Self> {
        let reference = HeadModel::sculpted_average(look);
        let (there, here) = (eye_distance(&reference)?, eye_distance(model)?);
        let neutral = vertices(model, &HeadPose::default());
        let rest = vertices(&reference, &HeadPose::default());
        let (to, from) = (landmarks(model, &neutral), landmarks(&reference, &rest));
        if to.len() < LANDMARKS || from.len() < LANDMARKS || there <= 0.0 || !(1e-4..1e3).contains(&here) {
            return None;
        }
        let warp = Warp::new(&from, &to, KERNEL * there)?;
        let map = |points: &[Vec3]| -> Vec<Vec3> {
            points.par_iter().map(|p| warp.at(p.as_dvec3()).as_vec3()).collect()
        };
        let mapped = map(&rest);
        if !mapped.iter().all(|p| p.is_finite()) {
            return None;
        }
        let triangles: Vec<[u32; 3]> = triangles_of(&reference, &SKIN).collect();
        let surface = Surface::new(&mapped, &triangles, (CELL * here) as f32);
        let candidates = candidates(model, &neutral, regions, most);
        let gap = GAP * here;
        let found: Vec<_> = candidates
            .par_iter()
            .filter_map(|&(vertex, area, normal)| {
                let nearest = surface.nearest(neutral[vertex as usize], normal)?;
                let apart = f64::from(nearest.distance) / gap;
                Some((vertex, area * libm::exp(-apart * apart), nearest))
            })
            .collect();
        let total: f64 = found.iter().map(|(_, weight, _)| weight).sum();
        if !(total > 0.0 && total.is_finite()) {
            return None;
        }
        let units = reference.action_units.par_iter().filter_map(|unit| {
            let pose = reference.pose_of_action_units(&[(unit.number, unit.side, 1.0)]).ok()?;
            let moved = vertices(&reference, &pose);
            let displacement = |v: u32| {
                let v = v as usize;
                let still = moved[v] == rest[v];
                if still { DVec3::ZERO } else { warp.at(moved[v].as_dvec3()) - mapped[v].as_dvec3() }
            };
            let surface = found.iter().map(|(.., nearest)| {
                let [a, b, c] = nearest.corners.map(displacement);
                let weights = nearest.weights.as_dvec3();
                a * weights.x + b * weights.y + c * weights.z
            });
            let at = landmarks(&reference, &moved);
            let landmarks = at.iter().zip(&from).map(|(moved, rest)| warp.at(*moved) - warp.at(*rest));
            Some(CarriedUnit {
                number: unit.number,
                side: unit.side,
                surface: surface.collect(),
                landmarks: landmarks.collect(),
            })
        });
        let units = units.collect();
        Some(Self {
            samples: found.iter().map(|(vertex, weight, _)| (*vertex, weight / total)).collect(),
            distances: found.iter().map(|(.., nearest)| f64::from(nearest.distance) / here).collect(),
            units,
        })
    }
}

/// Vertices of these regions with their areas and normals, at most `most` evenly from the list.
fn candidates(model: &HeadModel, neutral: &[Vec3], regions: &[Region], most: usize) -> Vec<(u32, f64, Vec3)> {
    let mut area = vec![0.0; neutral.len()];
    let mut normals = vec![Vec3::ZERO; neutral.len()];
    for triangle in triangles_of(model, regions) {
        let [a, b, c] = triangle.map(|v| neutral[v as usize]);
        let normal = (b - a).cross(c - a);
        for v in triangle {
            area[v as usize] += f64::from(normal.length()) / 6.0;
            normals[v as usize] += normal;
        }
    }
    let inside: Vec<usize> =
        (0..neutral.len()).filter(|v| area[*v] > 0.0 && normals[*v].is_finite()).collect();
    let step = inside.len().div_ceil(most).max(1);
    let sample = |v: usize| (v as u32, area[v], normals[v].normalize_or_zero());
    inside.into_iter().step_by(step).map(sample).collect()
}

fn triangles_of(model: &HeadModel, regions: &[Region]) -> impl Iterator<Item = [u32; 3]> {
    let triangles = model.triangles.iter().zip(&model.regions);
    triangles.filter(|(_, region)| regions.contains(region)).map(|(triangle, _)| *triangle)
}

fn vertices(model: &HeadModel, pose: &HeadPose) -> Vec<Vec3> {
    let mut vertices = Vec::new();
    model.vertices(&model.shaped(&[]), pose, &mut vertices);
    vertices
}

/// The landmarks that correspond between heads, of a model on these vertices.
pub(super) fn landmarks(model: &HeadModel, vertices: &[Vec3]) -> Vec<DVec3> {
    model.landmarks_on(vertices).take(LANDMARKS).map(Vec3::as_dvec3).collect()
}

fn eye_distance(model: &HeadModel) -> Option<f64> {
    let [left, right] = model.eye_centres(&model.shaped(&[]))?;
    Some(f64::from(left.distance(right)))
}
