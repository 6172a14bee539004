//! Action units of heads whose expressions do not name them, such as the principal components of FLAME and GNM: least squares to what
//! the action units of the built-in head do to the whole face.

mod carry;
mod surface;
mod warp;

use std::collections::HashSet;

use glam::{DVec3, Vec3};
use rayon::prelude::*;

use self::carry::{Carried, CarriedUnit, SKIN, landmarks};
use crate::{ActionUnit, HeadModel, HeadPose, Look, Offsets, Region, Shape, Side};
use srflow_core::dense::{self, dot};

/// Deviation of what an expression need not explain at one landmark, metres, against weights of deviation 1: components are scaled
/// to the deviations of people.
const NOISE: f64 = 0.5e-3;

/// How much the surface counts in all, and how much each of the 68 landmarks: together the surface counts twice as much. Landmarks are
/// on the lips and lids, which are small.
const SURFACE: f64 = 68.0;
const LANDMARK: f64 = 0.5;

/// Models have hundreds; files may claim more.
const MOST_EXPRESSIONS: usize = 1024;

/// A unit is left out if more than this share of its motion remains.
const MOST_LEFT: f64 = 0.8;

/// Distance between a vertex and the carried surface at which it moves 1/e as far, in distances between the eyes: of skin, where heads
/// differ, and of what lies on it, such as brows, but not hair.
const SKIN_REACH: f64 = 0.24;
const ABOVE_REACH: f64 = 0.06;

/// Displacements that are too small to matter, metres.
const NEGLIGIBLE: f32 = 1e-6;

/// Most passes over the weights, and the change of a weight that ends them.
const PASSES: usize = 300;
const SMALL: f64 = 1e-6;

/// How well a model shows an action unit of the built-in head.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct UnitQuality {
    /// Number in FACS.
    pub number: u8,
    pub side: Side,
    /// Motion of the built-in head's unit at full intensity on the model: root of the mean square over the skin, metres.
    pub motion: f64,
    /// What the model's own unit leaves of it: length of the difference relative to the length, over the skin by area, and over the
    /// 68 landmarks. 0 is the same motion, and 1 as good as none. `None` if the model does not have the unit.
    pub left: Option<Left>,
}

/// Shares of a motion that remain.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Left {
    pub skin: f64,
    pub landmarks: f64,
    /// Cosine between the displacements of the 68 landmarks: 1 where the motions differ in strength alone.
    pub cosine: f64,
}

/// Compares the action units of `model` with those of the average built-in head, which are carried onto its neutral surface by a smooth
/// map between the 68 landmarks. Empty for a model without landmarks.
pub fn unit_qualities(model: &HeadModel, look: Look) -> Vec<UnitQuality> {
    let Some(carried) = Carried::onto(model, look) else { return Vec::new() };
    let shaped = model.shaped(&[]);
    let vertices = |pose: &HeadPose| {
        let mut vertices = Vec::new();
        model.vertices(&shaped, pose, &mut vertices);
        vertices
    };
    let rest = vertices(&HeadPose::default());
    let left = |unit: &CarriedUnit| {
        let moved = vertices(&model.pose_of_action_units(&[(unit.number, unit.side, 1.0)]).ok()?);
        let moved: Vec<Vec3> = moved.iter().zip(&rest).map(|(moved, rest)| *moved - *rest).collect();
        let skin = carried.samples.iter().map(|(vertex, _)| moved[*vertex as usize].as_dvec3());
        Some(carried.left(unit, skin, landmarks(model, &moved).into_iter()))
    };
    let quality = |unit: &CarriedUnit| UnitQuality {
        number: unit.number,
        side: unit.side,
        motion: carried.length(unit.surface.iter().copied()),
        left: left(unit),
    };
    carried.units.iter().map(quality).collect()
}

/// The action units that the expressions of `model` can show, but for `known` ones; none for a model without landmarks.
///
/// The displacements d of the skin and of the 68 landmarks by each unit of the average built-in head, carried onto the model by
/// [`Carried::onto`], are approximated by B w with the displacements B by each expression: the w that minimizes the mean of
/// |B w - d|^2 over the skin times 68, and half the sum over the landmarks, both relative to the square of half a millimetre, plus
/// |w|^2. Weights of expressions that are not components are from 0 to 1.
///
/// A unit of which more than 80 % would remain is left out. The result is the same for any number of threads.
pub(crate) fn fitted_units(model: &HeadModel, known: &[u8], look: Look) -> Vec<ActionUnit> {
    if model.expressions.is_empty() || model.expressions.len() > MOST_EXPRESSIONS {
        return Vec::new();
    }
    let Some(carried) = Carried::onto(model, look) else { return Vec::new() };
    let Some(basis) = Basis::new(model, &carried) else { return Vec::new() };
    let fit = |unit: &CarriedUnit| {
        let (weights, left) = basis.fit(&carried.row(&unit.surface, &unit.landmarks));
        let weights = weights.into_iter().map(|weight| weight as f32).enumerate();
        let expressions: Vec<(usize, f32)> = weights.filter(|(_, weight)| *weight != 0.0).collect();
        let is_finite = expressions.iter().all(|(_, weight)| weight.is_finite());
        let unit = ActionUnit { number: unit.number, side: unit.side, expressions, joints: Vec::new() };
        (is_finite && left <= MOST_LEFT).then_some(unit)
    };
    carried.units.par_iter().filter(|unit| !known.contains(&unit.number)).filter_map(fit).collect()
}

/// Gives a model without expressions, such as a scan, those of the average built-in head: one for each action unit, carried onto its skin
/// and what lies on it, such as brows. Does nothing to a model without landmarks.
pub(crate) fn add_carried_units(model: &mut HeadModel, look: Look) {
    let Some(skin) = Carried::onto_all(model, look, &SKIN) else { return };
    let of_skin: HashSet<u32> = skin.samples.iter().map(|(vertex, _)| *vertex).collect();
    let above = Carried::onto_all(model, look, &[Region::Clear]);
    for (index, &CarriedUnit { number, side, .. }) in skin.units.iter().enumerate() {
        let offsets = |part: &Carried, reach: f64| -> Vec<(u32, Vec3)> {
            let samples = part.samples.iter().zip(&part.distances).zip(&part.units[index].surface);
            let offsets = samples.map(|(((vertex, _), distance), moved)| {
                let apart = distance / reach;
                (*vertex, (*moved * libm::exp(-apart * apart)).as_vec3())
            });
            offsets.filter(|(_, offset)| offset.is_finite() && offset.length() > NEGLIGIBLE).collect()
        };
        let mut moved = offsets(&skin, SKIN_REACH);
        let above = above.iter().flat_map(|above| offsets(above, ABOVE_REACH));
        moved.extend(above.filter(|(vertex, _)| !of_skin.contains(vertex)));
        let expressions = vec![(model.expressions.len(), 1.0)];
        let half = match side {
            Side::Both => "",
            Side::Left => "_L",
            Side::Right => "_R",
        };
        model.expressions.push(Shape::linear(format!("AU{number:02}{half}"), Offsets::Sparse(moved)));
        model.action_units.push(ActionUnit { number, side, expressions, joints: Vec::new() });
    }
}

impl Carried {
    /// Displacements of the samples and the landmarks as one row of numbers, such that the sum of squares is what is minimized.
    fn row(&self, surface: &[DVec3], landmarks: &[DVec3]) -> Vec<f64> {
        let on_surface = self.samples.iter().map(|(_, share)| (SURFACE * share).sqrt() / NOISE);
        let weights = on_surface.chain(landmarks.iter().map(|_| LANDMARK.sqrt() / NOISE));
        let displacements = surface.iter().chain(landmarks);
        displacements.zip(weights).flat_map(|(moved, weight)| (*moved * weight).to_array()).collect()
    }

    /// Root of the mean square of displacements of the samples.
    fn length(&self, surface: impl Iterator<Item = DVec3>) -> f64 {
        let squares =
            self.samples.iter().zip(surface).map(|((_, share), moved)| share * moved.length_squared());
        squares.sum::<f64>().sqrt()
    }

    /// What remains of `unit` where the model moves by these displacements.
    fn left(
        &self,
        unit: &CarriedUnit,
        skin: impl Iterator<Item = DVec3>,
        landmarks: impl Iterator<Item = DVec3>,
    ) -> Left {
        let off = self.length(skin.zip(&unit.surface).map(|(moved, wanted)| moved - *wanted));
        let [mut off_landmarks, mut moved_by, mut wanted_by, mut along] = [0.0; 4];
        for (moved, wanted) in landmarks.zip(&unit.landmarks) {
            off_landmarks += (moved - *wanted).length_squared();
            moved_by += moved.length_squared();
            wanted_by += wanted.length_squared();
            along += moved.dot(*wanted);
        }
        Left {
            skin: off / self.length(unit.surface.iter().copied()),
            landmarks: (off_landmarks / wanted_by).sqrt(),
            cosine: along / (moved_by * wanted_by).sqrt().max(f64::MIN_POSITIVE),
        }
    }
}

/// The displacements by each expression.
struct Basis {
    /// One row per expression, as [`Carried::row`] makes it.
    rows: Vec<Vec<f64>>,
    /// B^T B + 1, row by row.
    normal: Vec<f64>,
    /// Its inverse; `None` for weights from 0 to 1.
    inverse: Option<Vec<f64>>,
}

impl Basis {
    /// `None` if the displacements are too large to compute with.
    fn new(model: &HeadModel, carried: &Carried) -> Option<Self> {
        let row = |expression: &crate::Shape| {
            let mut dense = vec![Vec3::ZERO; model.template.len()];
            expression.offsets.iter().for_each(|(vertex, offset)| dense[vertex as usize] += offset);
            let surface: Vec<DVec3> =
                carried.samples.iter().map(|(vertex, _)| dense[*vertex as usize].as_dvec3()).collect();
            carried.row(&surface, &landmarks(model, &dense))
        };
        let rows: Vec<Vec<f64>> = model.expressions.par_iter().map(row).collect();
        let count = rows.len();
        let lower: Vec<Vec<f64>> = (0..count)
            .into_par_iter()
            .map(|i| rows[..=i].iter().map(|other| dot(&rows[i], other)).collect())
            .collect();
        let mut normal = vec![0.0; count * count];
        for (i, row) in lower.iter().enumerate() {
            for (j, &value) in row.iter().enumerate() {
                normal[i * count + j] = value;
                normal[j * count + i] = value;
            }
            normal[i * count + i] += 1.0;
        }
        let inverse = match model.expressions_are_components {
            true => Some(dense::inverse(normal.clone(), count)?),
            false => None,
        };
        Some(Self { rows, normal, inverse })
    }

    /// The weights for displacements as a row, and the share of its length that remains.
    fn fit(&self, target: &[f64]) -> (Vec<f64>, f64) {
        let count = self.rows.len();
        let right: Vec<f64> = self.rows.iter().map(|row| dot(row, target)).collect();
        let weights = match &self.inverse {
            Some(inverse) => inverse.chunks_exact(count).map(|row| dot(row, &right)).collect(),
            None => self.bounded(&right),
        };
        // |B w - d|^2 = w (N - 1) w - 2 w B^T d + d^2.
        let through = self.normal.chunks_exact(count).map(|row| dot(row, &weights));
        let squares = through.zip(&weights).map(|(through, weight)| (through - weight) * weight).sum::<f64>();
        let length = dot(target, target);
        let left = (squares - 2.0 * dot(&weights, &right) + length).max(0.0);
        (weights, (left / length).sqrt())
    }

    /// The minimum with weights from 0 to 1, weight by weight.
    fn bounded(&self, right: &[f64]) -> Vec<f64> {
        let count = right.len();
        let mut weights = vec![0.0; count];
        for _ in 0..PASSES {
            let mut largest = 0.0_f64;
            for i in 0..count {
                let row = &self.normal[i * count..(i + 1) * count];
                let next = (weights[i] - (dot(row, &weights) - right[i]) / row[i]).clamp(0.0, 1.0);
                largest = largest.max((next - weights[i]).abs());
                weights[i] = next;
            }
            if largest < SMALL {
                break;
            }
        }
        weights
    }
}

#[cfg(test)]
mod tests;
