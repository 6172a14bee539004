//! Adam over the poses of a head: where the tracking was inexact, pictures correct it.

use glam::{DVec3, Vec3};
use serde::{Deserialize, Serialize};
use srflow_files::FileError;

use super::adam::{BETA_1, BETA_2, Moments, unbiased};
use super::checkpoint::{Checkpoint, Lists};
use srflow_head::{HeadGradient, HeadModel, JointRole, PoseParameters, rotation_of_axis_angle};

/// How far one step moves a pose. The defaults are those of GaussianAvatars (`flame_expr_lr`, `flame_pose_lr`, `flame_trans_lr` in
/// `arguments/__init__.py`).
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct PoseRates {
    /// Of the weights of expressions.
    pub expressions: f64,
    /// Of the rotations of all joints, radians.
    pub joints: f64,
    /// Metres.
    pub translation: f64,
}

impl Default for PoseRates {
    fn default() -> Self {
        Self { expressions: 1e-3, joints: 1e-5, translation: 1e-6 }
    }
}

/// Adam over poses, with the constants of [`GaussianAdam`](super::GaussianAdam). Each timestep has moments and a count of steps of
/// its own, and moves when it is drawn. The reference moves all timesteps at each iteration, by the momentum of earlier ones.
#[derive(Debug, Clone)]
pub struct PoseAdam {
    rates: PoseRates,
    timesteps: Vec<Timestep>,
}

#[derive(Debug, Clone)]
struct Timestep {
    steps: i32,
    /// In the order of [`values`].
    moments: Moments,
}

const EPSILON: f64 = 1e-15;

// Names of lists in checkpoints.
const POSES: &str = "poses";
const MEANS: &str = "pose_means";
const SQUARES: &str = "pose_squares";
const STEPS: &str = "pose_steps";

impl PoseAdam {
    /// The state before the first step, for these poses.
    pub fn new(poses: &[PoseParameters], rates: PoseRates) -> Self {
        let timestep = |pose: &PoseParameters| Timestep {
            steps: 0,
            moments: Moments::new(values(&mut pose.clone(), &rates).len()),
        };
        Self { rates, timesteps: poses.iter().map(timestep).collect() }
    }

    /// Every list of a checkpoint, by name, with those of the `poses`.
    pub(super) fn lists(&self, poses: &[PoseParameters]) -> Lists {
        let all = |list: fn(&Timestep) -> &[f32]| self.timesteps.iter().flat_map(list).copied().collect();
        let mut numbers = Vec::new();
        for pose in poses {
            numbers.extend(values(&mut pose.clone(), &self.rates).into_iter().map(|(value, _)| *value));
        }
        let steps = self.timesteps.iter().map(|timestep| timestep.steps as f32).collect();
        vec![
            (POSES, numbers),
            (MEANS, all(|timestep| &timestep.moments.first)),
            (SQUARES, all(|timestep| &timestep.moments.second)),
            (STEPS, steps),
        ]
    }

    /// Replaces `poses` and the state of each by those of a checkpoint.
    ///
    /// # Errors
    /// When a list is missing or has another length.
    pub(super) fn load(
        &mut self,
        poses: &mut [PoseParameters],
        checkpoint: &mut Checkpoint,
    ) -> Result<(), FileError> {
        let len = Some(self.timesteps.iter().map(|timestep| timestep.moments.first.len()).sum());
        let (numbers, means) = (checkpoint.list(POSES, len)?, checkpoint.list(MEANS, len)?);
        let squares = checkpoint.list(SQUARES, len)?;
        let steps = checkpoint.counts(STEPS, Some(poses.len()))?;
        let mut start = 0;
        for ((timestep, pose), steps) in self.timesteps.iter_mut().zip(poses).zip(steps) {
            let range = start..start + timestep.moments.first.len();
            start = range.end;
            timestep.steps = steps as i32;
            timestep.moments.first.copy_from_slice(&means[range.clone()]);
            timestep.moments.second.copy_from_slice(&squares[range.clone()]);
            for ((value, _), number) in values(pose, &self.rates).into_iter().zip(&numbers[range]) {
                *value = *number;
            }
        }
        Ok(())
    }

    /// Moves the pose of timestep number `timestep` by one step against `gradient`, the gradient at that pose.
    ///
    /// Panics when the timestep does not exist.
    pub fn step(
        &mut self,
        model: &HeadModel,
        timestep: usize,
        pose: &mut PoseParameters,
        gradient: &HeadGradient,
    ) {
        let slopes = slopes(model, pose, gradient);
        self.timesteps[timestep].step(&self.rates, pose, &slopes);
    }

    /// The step of the reference: as [`PoseAdam::step`], and every other timestep moves on by its momentum.
    pub fn step_all(
        &mut self,
        model: &HeadModel,
        timestep: usize,
        poses: &mut [PoseParameters],
        gradient: &HeadGradient,
    ) {
        for (number, (state, pose)) in self.timesteps.iter_mut().zip(poses).enumerate() {
            let slopes = if number == timestep {
                slopes(model, pose, gradient)
            } else {
                vec![0.0; state.moments.first.len()]
            };
            state.step(&self.rates, pose, &slopes);
        }
    }
}

impl Timestep {
    fn step(&mut self, rates: &PoseRates, pose: &mut PoseParameters, slopes: &[f64]) {
        self.steps += 1;
        let [mean, square] = [BETA_1, BETA_2].map(|beta| unbiased(beta, self.steps));
        let moments = self.moments.first.iter_mut().zip(&mut self.moments.second);
        for (((value, rate), (first, second)), slope) in
            values(pose, rates).into_iter().zip(moments).zip(slopes)
        {
            let moment =
                |before: f32, beta: f64, new: f64| (beta * f64::from(before) + (1.0 - beta) * new) as f32;
            *first = moment(*first, BETA_1, *slope);
            *second = moment(*second, BETA_2, slope * slope);
            let change =
                rate * f64::from(*first) * mean / (libm::sqrt(f64::from(*second) * square) + EPSILON);
            *value = (f64::from(*value) - change) as f32;
        }
    }
}

/// All numbers of a pose with their rates.
fn values<'a>(pose: &'a mut PoseParameters, rates: &PoseRates) -> Vec<(&'a mut f32, f64)> {
    let PoseParameters { expr, rotation, neck, jaw, eyes, other_joints, translation, dynamic_offset: _ } =
        pose;
    let joints = [rotation, neck, jaw].into_iter().chain(eyes).chain(other_joints);
    let of = |vector: &'a mut Vec3, rate: f64| vector.as_mut().iter_mut().map(move |value| (value, rate));
    let expressions = expr.iter_mut().map(|weight| (weight, rates.expressions));
    expressions
        .chain(joints.flat_map(|joint| of(joint, rates.joints)))
        .chain(of(translation, rates.translation))
        .collect()
}

/// The gradient of each of the [`values`].
fn slopes(model: &HeadModel, pose: &PoseParameters, gradient: &HeadGradient) -> Vec<f64> {
    let of_joint = |joint: usize, axis_angle: Vec3| {
        let turn = gradient.joints.get(joint).copied().unwrap_or_default();
        rotation_of_axis_angle(axis_angle.as_dvec3()).transpose() * turn
    };
    let of_role =
        |role, axis_angle| model.joint(role).map_or(DVec3::ZERO, |joint| of_joint(joint, axis_angle));
    let joints = [
        of_role(JointRole::Root, pose.rotation),
        of_role(JointRole::Neck, pose.neck),
        of_role(JointRole::Jaw, pose.jaw),
        of_role(JointRole::LeftEye, pose.eyes[0]),
        of_role(JointRole::RightEye, pose.eyes[1]),
    ];
    let mut others = (0..model.joints.len()).filter(|&joint| model.joints[joint].role.is_none());
    let others = pose
        .other_joints
        .iter()
        .map(|&axis_angle| others.next().map_or(DVec3::ZERO, |joint| of_joint(joint, axis_angle)));
    let expressions =
        (0..pose.expr.len()).map(|number| gradient.expressions.get(number).copied().unwrap_or(0.0));
    let vectors = joints.into_iter().chain(others).chain([gradient.translation]);
    expressions.chain(vectors.flat_map(|vector| vector.to_array())).collect()
}

#[cfg(test)]
mod tests {
    use srflow_core::random::Key;

    use super::*;

    /// A pose of the built-in head with everything away from zero.
    fn pose(model: &HeadModel) -> PoseParameters {
        let mut stream = Key::new(6).stream("pose");
        let mut vector = || 0.3 * Vec3::new(stream.normal(), stream.normal(), stream.normal());
        PoseParameters {
            rotation: vector(),
            neck: vector(),
            jaw: vector(),
            eyes: [vector(), vector()],
            translation: vector(),
            expr: model.expressions.iter().map(|_| vector().x).collect(),
            ..PoseParameters::default()
        }
    }

    /// A scalar that depends on every vertex, and its gradient.
    fn scalar(model: &HeadModel, pose: &PoseParameters) -> (f64, HeadGradient) {
        let shaped = model.shaped(&[]);
        let mut stream = Key::new(7).stream("weights");
        let mut weight = || Vec3::new(stream.normal(), stream.normal(), stream.normal());
        let weights: Vec<Vec3> = model.template.iter().map(|_| weight()).collect();
        let (pose, mut vertices) = (pose.pose(model), Vec::new());
        model.vertices(&shaped, &pose, &mut vertices);
        let sum = vertices.iter().zip(&weights).map(|(v, w)| v.as_dvec3().dot(w.as_dvec3())).sum();
        (sum, model.backward(&[], &shaped, &pose, &weights))
    }

    #[test]
    fn slopes_are_central_differences_of_each_value() {
        let model = HeadModel::builtin(1);
        let start = pose(&model);
        let found = slopes(&model, &start, &scalar(&model, &start).1);
        let rates = PoseRates::default();
        let count = values(&mut start.clone(), &rates).len();
        assert_eq!(found.len(), count);
        let scale = found.iter().map(|slope| slope.abs()).fold(0.0, f64::max);
        // All joints and the translation, and some of the expressions.
        for number in (0..count).filter(|&number| number % 7 == 0 || number + 18 >= count) {
            let at = |step: f32| {
                let mut moved = start.clone();
                *values(&mut moved, &rates)[number].0 += step;
                scalar(&model, &moved).0
            };
            let difference = (at(1e-2) - at(-1e-2)) / 2e-2;
            let error = (found[number] - difference).abs();
            assert!(error < 2e-3 * scale, "{number} of {count}: {}, {difference}", found[number]);
        }
    }

    #[test]
    fn steps_go_downhill_at_their_rates_and_only_where_drawn() {
        let model = HeadModel::builtin(1);
        let mut poses = vec![pose(&model); 3];
        let before = poses.clone();
        let rates = PoseRates::default();
        let mut adam = PoseAdam::new(&poses, rates);
        let (value, gradient) = scalar(&model, &poses[1]);
        adam.step(&model, 1, &mut poses[1], &gradient);
        assert!(scalar(&model, &poses[1]).0 < value);
        // The first step of Adam is as long as the rate.
        let moved = (poses[1].expr[0] - before[1].expr[0]).abs();
        assert!((f64::from(moved) - 1e-3).abs() < 1e-6, "{moved}");
        assert!((poses[1].jaw - before[1].jaw).abs().max_element() < 1.1e-5);
        assert_eq!((&poses[0], &poses[2]), (&before[0], &before[2]));

        let after = poses.clone();
        adam.step(&model, 2, &mut poses[2], &gradient);
        assert_eq!(poses[1], after[1], "without momentum where it is not drawn");
        adam.step_all(&model, 2, &mut poses, &gradient);
        assert_ne!(poses[1], after[1], "the reference moves on by momentum");
        assert_eq!(poses[0], before[0]);
    }
}
