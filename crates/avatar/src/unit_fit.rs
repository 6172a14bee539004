//! Action units of heads whose expressions have no meaning of their own, such as the principal components of FLAME and GNM: least
//! squares to what the action units of the built-in head do to the landmarks.

use glam::{DVec3, Vec3};

use crate::fit::dense;
use crate::{ActionUnit, HeadModel, HeadPose, Offsets};

/// Landmarks that correspond between heads.
const LANDMARKS: usize = 68;

/// Deviation of the landmarks that an expression need not explain, metres, against weights of deviation 1: components are scaled to
/// the deviations of people.
const NOISE: f64 = 0.5e-3;

/// Models have hundreds; files may claim more.
const MOST_EXPRESSIONS: usize = 4096;

/// A unit is left out if more than this share of its motion remains.
const MOST_LEFT: f64 = 0.7;

/// An action unit in terms of a model's expressions, and how well they show it.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct FittedUnit {
    pub unit: ActionUnit,
    /// Length of the landmarks' displacements that remain, relative to those of the built-in head.
    pub left: f64,
}

/// The action units that the expressions of `model` can show, but for `known` ones; none for a model without landmarks.
///
/// The displacement d of the 68 landmarks by each unit of the average built-in head, scaled by the distance between the eyes, is
/// approximated by B w with the displacements B of the landmarks by each expression: the w that minimizes
/// |B w - d|^2 / noise^2 + |w|^2. Parts of the face without landmarks, the cheeks above all, move as the expressions have it.
pub(crate) fn fitted_units(model: &HeadModel, known: &[u8]) -> Vec<FittedUnit> {
    let reference = HeadModel::sculpted_average();
    let (Some(there), Some(here)) = (eye_distance(&reference), eye_distance(model)) else {
        return Vec::new();
    };
    let rest = landmarks(&reference, &HeadPose::default());
    let too_many = model.expressions.len() > MOST_EXPRESSIONS;
    if model.landmarks.len() < LANDMARKS || rest.len() < LANDMARKS || there <= 0.0 || too_many {
        return Vec::new();
    }
    let scale = here / there;
    let basis = Basis::new(model);
    let fit = |unit: &ActionUnit| {
        let pose = reference.pose_of_action_units(&[(unit.number, unit.side, 1.0)]).ok()?;
        let moved = landmarks(&reference, &pose);
        let target: Vec<f64> =
            moved.iter().zip(&rest).flat_map(|(moved, rest)| ((*moved - *rest) * scale).to_array()).collect();
        let (weights, left) = basis.fit(&target)?;
        let expressions = weights.into_iter().enumerate().filter(|(_, weight)| *weight != 0.0).collect();
        let unit = ActionUnit { number: unit.number, side: unit.side, expressions, joints: Vec::new() };
        (left <= MOST_LEFT).then_some(FittedUnit { unit, left })
    };
    let units = reference.action_units.iter().filter(|unit| !known.contains(&unit.number));
    units.filter_map(fit).collect()
}

/// The first landmarks of a posed model.
fn landmarks(model: &HeadModel, pose: &HeadPose) -> Vec<DVec3> {
    let mut vertices = Vec::new();
    model.vertices(&model.shaped(&[]), pose, &mut vertices);
    model.landmarks_on(&vertices).take(LANDMARKS).map(Vec3::as_dvec3).collect()
}

fn eye_distance(model: &HeadModel) -> Option<f64> {
    let [left, right] = model.eye_centres(&model.shaped(&[]))?;
    Some(f64::from(left.distance(right)))
}

/// The landmarks' displacements by each expression.
struct Basis {
    /// One row of 204 numbers per expression.
    rows: Vec<Vec<f64>>,
    /// (B B^T + noise^2)^-1, row by row; `None` if it has none.
    inverse: Option<Vec<f64>>,
}

impl Basis {
    fn new(model: &HeadModel) -> Self {
        let corners: Vec<([u32; 3], Vec3)> = model.landmarks[..LANDMARKS]
            .iter()
            .map(|(triangle, weights)| (model.triangles[*triangle as usize], *weights))
            .collect();
        let rows: Vec<Vec<f64>> = model
            .expressions
            .iter()
            .map(|expression| {
                let mut dense = vec![Vec3::ZERO; model.template.len()];
                match &expression.offsets {
                    Offsets::Dense(offsets) => dense.clone_from(offsets),
                    sparse => sparse.iter().for_each(|(vertex, offset)| dense[vertex as usize] += offset),
                }
                let moved = corners.iter().map(|(corners, weights)| {
                    let [a, b, c] = corners.map(|corner| dense[corner as usize].as_dvec3());
                    let weights = weights.as_dvec3();
                    a * weights.x + b * weights.y + c * weights.z
                });
                moved.flat_map(|moved| moved.to_array()).collect()
            })
            .collect();
        const SIZE: usize = 3 * LANDMARKS;
        let mut normal = vec![0.0; SIZE * SIZE];
        for row in &rows {
            for (i, a) in row.iter().enumerate().filter(|(_, a)| **a != 0.0) {
                for (sum, b) in normal[i * SIZE..(i + 1) * SIZE].iter_mut().zip(row) {
                    *sum += a * b;
                }
            }
        }
        (0..SIZE).for_each(|i| normal[i * SIZE + i] += NOISE * NOISE);
        Self { rows, inverse: dense::inverse(normal, SIZE) }
    }

    /// The weights for a displacement of the landmarks, and the share of it that remains: w = B^T (B B^T + noise^2)^-1 d.
    fn fit(&self, target: &[f64]) -> Option<(Vec<f32>, f64)> {
        let length = target.iter().map(|value| value * value).sum::<f64>().sqrt();
        let dot = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
        let rows = self.inverse.as_ref()?.chunks_exact(target.len());
        let dual: Vec<f64> = rows.map(|row| dot(row, target)).collect();
        let weights: Vec<f64> = self.rows.iter().map(|row| dot(row, &dual)).collect();
        // d - B w = noise^2 (B B^T + noise^2)^-1 d.
        let left = NOISE * NOISE * dual.iter().map(|value| value * value).sum::<f64>().sqrt() / length;
        let weights: Vec<f32> = weights.into_iter().map(|weight| weight as f32).collect();
        let is_finite = left.is_finite() && weights.iter().all(|weight| weight.is_finite());
        is_finite.then_some((weights, left))
    }
}

#[cfg(test)]
mod tests {
    use srflow_field::random::Key;

    use super::*;
    use crate::{HeadSource, Side};

    /// The built-in head with its expressions mixed, so that none means anything: as many as units, of deviation 1.
    fn mixed() -> HeadModel {
        let model = HeadModel::builtin(4);
        let mut stream = Key::new(8).stream("mixture");
        let count = model.expressions.len();
        let expressions = (0..count).map(|number| {
            let mut offsets = vec![Vec3::ZERO; model.template.len()];
            for expression in &model.expressions {
                let weight = stream.normal() / (count as f32).sqrt();
                expression
                    .offsets
                    .iter()
                    .for_each(|(vertex, offset)| offsets[vertex as usize] += offset * weight);
            }
            crate::Shape::linear(format!("component{number:03}"), Offsets::Dense(offsets))
        });
        HeadModel { expressions: expressions.collect(), action_units: Vec::new(), ..model.clone() }
    }

    #[test]
    fn units_are_found_in_expressions_without_meaning() {
        let mut model = mixed();
        let fitted = fitted_units(&model, &[26]);
        let worst = fitted.iter().map(|unit| unit.left).fold(0.0, f64::max);
        // All of the reference but the known one; its face has other proportions, and its lids move on an arc.
        let all = HeadModel::builtin(4).action_units.len() - 1;
        assert!(fitted.len() == all && worst < 0.4, "{} units, worst {worst}", fitted.len());
        let mean = fitted.iter().map(|unit| unit.left).sum::<f64>() / fitted.len() as f64;
        assert!(mean < 0.3, "{mean} of the motion remains on average");
        assert!(fitted.iter().all(|unit| unit.unit.number != 26), "a known unit is not fitted");

        model.action_units = fitted.into_iter().map(|fitted| fitted.unit).collect();
        model.validate().unwrap();
        let own = HeadModel::builtin(4);
        let rest = landmarks(&own, &HeadPose::default());
        for (number, side, landmark) in
            [(12, Side::Left, 54), (12, Side::Right, 48), (1, Side::Left, 22), (45, Side::Left, 44)]
        {
            let moved = |model: &HeadModel| {
                let pose = model.pose_of_action_units(&[(number, side, 1.0)]).unwrap();
                landmarks(model, &pose)[landmark] - rest[landmark]
            };
            let (found, expected) = (moved(&model), moved(&own));
            assert!(found.distance(expected) < 0.45 * expected.length(), "AU{number}: {found} {expected}");
        }
    }

    #[test]
    fn heads_without_landmarks_or_expressions_have_no_units() {
        let model = HeadModel::builtin(1);
        assert!(fitted_units(&HeadModel { landmarks: Vec::new(), ..model.clone() }, &[]).is_empty());
        assert!(fitted_units(&HeadModel { expressions: Vec::new(), ..model }, &[]).is_empty());
    }

    /// How well the expressions of another head show the units; the numbers are in docs/avatars.md.
    #[test]
    fn units_are_found_in_ict_facekit() {
        let folder = std::path::Path::new("../../../shared/data/ict-facekit/FaceXModel");
        if !folder.is_dir() {
            eprintln!("skipped: no ICT-FaceKit at {}", folder.display());
            return;
        }
        let mut model = HeadSource::ict(folder).model(1).unwrap();
        let fitted = fitted_units(&model, &[]);
        for FittedUnit { unit, left } in &fitted {
            eprintln!("AU{} {:?}: {:.0} % remain", unit.number, unit.side, 100.0 * left);
        }
        let mean = fitted.iter().map(|unit| unit.left).sum::<f64>() / fitted.len() as f64;
        eprintln!("{} units, {:.0} % remain on average", fitted.len(), 100.0 * mean);
        model.action_units = fitted.into_iter().map(|fitted| fitted.unit).collect();
        let rest = landmarks(&model, &HeadPose::default());
        // Corner of the mouth up, inner brow up, upper lid down.
        for (number, landmark, up) in [(12, 54, 1.0), (1, 22, 1.0), (45, 44, -1.0), (15, 54, -1.0)] {
            let pose = model.pose_of_action_units(&[(number, Side::Left, 1.0)]).unwrap();
            let moved = landmarks(&model, &pose)[landmark] - rest[landmark];
            assert!(moved.y * up > 1e-3, "AU{number} moves landmark {landmark} by {moved}");
        }
    }
}
