//! Residuals, their derivatives, and Levenberg-Marquardt over a window of timesteps.

use std::ops::Range;

use glam::{DMat3, DQuat, DVec2, DVec3};
use rayon::prelude::*;

use super::arrow::{Block, Step, System};
use super::detectors::Detector;
use super::initial::candidates;
use super::landmarks::{CONTOUR, landmarks_in};
use super::pictures::Pictures;
use super::priors::ranges;
use super::{FitOptions, LandmarkView};
use crate::capture::LANDMARK_COUNT;
use srflow_head::{HeadModel, HeadPoints, HeadState, JointRole, ShapedHead};
use srflow_splat::Camera;

/// The noise is not estimated below this, in pixels: no detector is more precise.
pub(super) const LEAST_NOISE: f64 = 0.25;

/// Errors of detectors change with pose and expression, but hardly from one timestep to the next: all timesteps together tell as much
/// about what they share as so many independent ones.
const INDEPENDENT: usize = 8;

/// When a search for parameters ends, and how far its steps go.
pub(super) struct Search {
    /// Steps, at most.
    pub steps: usize,
    /// A step of less gain, as a share of the cost, is the last one.
    pub least_gain: f64,
    /// How many times as far as the normal equations say, as long as that lowers the cost.
    pub stride: f64,
}

const TO_LANDMARKS: Search = Search { steps: 40, least_gain: 1e-6, stride: 1.0 };

/// Timesteps that are linearised at once: each takes about a megabyte.
const AT_ONCE: usize = 32;

/// Between which [`Problem::offset_factor`] is learned.
const OFFSET_FACTORS: [f64; 2] = [0.07, 3.3];

/// Landmarks of the outer corners of the eyes.
pub(super) const EYE_CORNERS: [usize; 2] = [36, 45];

const RIGHT_EYE: [usize; 6] = [36, 37, 38, 39, 40, 41];
const LEFT_EYE: [usize; 6] = [42, 43, 44, 45, 46, 47];
/// Of a distance between the pupils that is stated or held, metres.
const EYE_DISTANCE_DEVIATION: f64 = 0.0005;

pub(super) struct Problem<'a> {
    pub model: &'a HeadModel,
    pub points: HeadPoints,
    pub options: &'a FitOptions,
    /// Numbers of the timesteps, ascending.
    pub timesteps: Vec<u32>,
    /// The views of each timestep.
    pub views: Vec<Vec<&'a LandmarkView>>,
    /// Fitted shapes of the identity basis: the first ones.
    pub identities: usize,
    /// Fitted shapes of the expression basis: the first ones.
    pub expressions: usize,
    /// Fitted joints: the root, then those of roles.
    pub joints: Vec<usize>,
    /// Weights that each fitted expression is meant for.
    pub ranges: Vec<Option<[f64; 2]>>,
    /// How many times less precise each landmark is than the best ones.
    pub factors: Vec<f64>,
    pub detector: Detector,
    /// How many times larger than expected their deviations are.
    offset_factor: f64,
    /// Between the outer corners of the eyes, which is the size of the head, and between the pupils.
    pub corners: DistanceAtRest,
    pupils: DistanceAtRest,
}

/// What is solved for: parameters of some timesteps, the others held.
#[derive(Debug, Clone)]
pub(super) struct Window {
    pub range: Range<usize>,
    pub identity: bool,
    /// Rotation of the root and translation alone.
    pub rigid: bool,
    /// A timestep outside that the window's one timestep is next to.
    neighbour: Option<usize>,
}

impl Window {
    pub fn one(timestep: usize) -> Self {
        Self { range: timestep..timestep + 1, identity: false, rigid: false, neighbour: None }
    }

    pub fn all(count: usize) -> Self {
        Self { range: 0..count, identity: false, rigid: false, neighbour: None }
    }

    pub fn with_identity(self) -> Self {
        Self { identity: true, ..self }
    }

    /// How many times more certain all these timesteps would make what they share than [`INDEPENDENT`] do. The priors of that are
    /// narrower by it.
    pub fn certainty(&self) -> f64 {
        (self.range.len() as f64 / INDEPENDENT as f64).max(1.0).sqrt()
    }

    fn rigid(self) -> Self {
        Self { rigid: true, ..self }
    }

    fn beside(self, neighbour: usize) -> Self {
        Self { neighbour: Some(neighbour), ..self }
    }
}

/// What is fitted: the head at some timesteps, and where its landmarks are.
#[derive(Debug, Clone)]
pub(super) struct Heads {
    /// The first of the timesteps.
    pub first: usize,
    pub states: Vec<HeadState>,
    /// From each of the model's landmarks to the detector's, in the axes of the head at rest and in [`Problem::size`]s of it.
    /// In metres, they would be more probable the smaller the head.
    pub offsets: Vec<DVec3>,
}

impl Heads {
    pub fn state(&self, timestep: usize) -> &HeadState {
        &self.states[timestep - self.first]
    }

    fn state_mut(&mut self, timestep: usize) -> &mut HeadState {
        &mut self.states[timestep - self.first]
    }
}

/// Where a point is in a picture, and how that changes with its position in the world.
pub(super) struct Projection {
    pub pixel: DVec2,
    pub across: DVec3,
    pub down: DVec3,
}

impl Projection {
    /// `None` behind the camera.
    pub fn of(camera: &Camera, position: DVec3) -> Option<Self> {
        let point = camera.camera_from_world.transform_point3(position);
        let world_from_camera = DMat3::from_mat4(camera.camera_from_world).transpose();
        let Camera { fx, fy, cx, cy, .. } = *camera;
        let across = DVec3::new(fx, 0.0, -fx * point.x / point.z) / point.z;
        let down = DVec3::new(0.0, fy, -fy * point.y / point.z) / point.z;
        (point.z > 0.0).then(|| Self {
            pixel: DVec2::new(fx * point.x / point.z + cx, fy * point.y / point.z + cy),
            across: world_from_camera * across,
            down: world_from_camera * down,
        })
    }
}

/// A sum of squares and its linearisation.
pub(super) struct Terms {
    pub cost: f64,
    /// Shared parameters, then the timestep's own; n x n, only the lower triangle before [`Problem::linearise`] has split it.
    pub hessian: Vec<f64>,
    pub gradient: Vec<f64>,
}

impl<'a> Problem<'a> {
    pub fn new(model: &'a HeadModel, views: &'a [LandmarkView], options: &'a FitOptions) -> Self {
        let mut timesteps: Vec<u32> = views.iter().map(|view| view.timestep).collect();
        timesteps.sort_unstable();
        timesteps.dedup();
        let of = |timestep: &u32| {
            let mut of: Vec<_> = views.iter().filter(|view| view.timestep == *timestep).collect();
            of.sort_by_key(|view| view.camera_index);
            of
        };
        let expressions = model.expressions.len().min(options.expressions);
        let roles = [JointRole::Neck, JointRole::Jaw, JointRole::LeftEye, JointRole::RightEye];
        let joints =
            std::iter::once(0).chain(roles.into_iter().filter_map(|role| model.joint(role))).collect();
        let points = HeadPoints::on_triangles(model, &model.landmarks[..LANDMARK_COUNT]);
        let identities = model.identities.len().min(options.identities);
        let rest = rest(model, identities, expressions);
        let [right, left] = EYE_CORNERS;
        Self {
            corners: DistanceAtRest::between(&points, &rest, &[right], &[left]),
            pupils: DistanceAtRest::between(&points, &rest, &RIGHT_EYE, &LEFT_EYE),
            model,
            points,
            options,
            views: timesteps.iter().map(of).collect(),
            timesteps,
            identities,
            expressions,
            joints,
            ranges: ranges(model, expressions),
            factors: (0..LANDMARK_COUNT).map(|l| if l < CONTOUR { options.contour } else { 1.0 }).collect(),
            detector: Detector::Dlib,
            offset_factor: 1.0,
        }
    }

    pub fn role(&self, joint: usize) -> JointRole {
        self.model.joints[joint].role.unwrap_or(JointRole::Root)
    }

    /// Number of parameters that all timesteps share: identity, and the offsets of landmarks.
    pub fn shared(&self) -> usize {
        self.identities + 3 * LANDMARK_COUNT
    }

    /// Number of parameters of one timestep: expressions, three per joint, translation.
    pub fn own(&self) -> usize {
        self.expressions + 3 * self.joints.len() + 3
    }

    /// Columns of [`HeadPoints::derivatives`] of a timestep's own parameters.
    pub fn own_columns(&self) -> Vec<usize> {
        let (identities, expressions) = (self.model.identities.len(), self.model.expressions.len());
        let of_joints = identities + expressions;
        let of_joint = |joint: usize| (0..3).map(move |axis| of_joints + 3 * joint + axis);
        (identities..identities + self.expressions)
            .chain(self.joints.iter().flat_map(|joint| of_joint(*joint)))
            .chain(of_joint(self.model.joints.len()))
            .collect()
    }

    /// How far the offsets are from where they are expected, and the deviation of that, along each axis.
    fn unexpected(&self, heads: &Heads) -> impl Iterator<Item = (f64, f64)> {
        heads.offsets.iter().zip(self.expected_offsets()).flat_map(|(offset, expected)| {
            let deviation = expected.deviation * self.offset_factor;
            (*offset - expected.mean).to_array().into_iter().zip(deviation.to_array())
        })
    }

    /// Size of the head, metres, and how it grows with each identity weight.
    pub fn size(&self, state: &HeadState) -> (f64, Vec<f64>) {
        self.corners.of(&state.identity)
    }

    /// Distance between the pupils, metres.
    pub fn eye_distance(&self, state: &HeadState) -> f64 {
        self.pupils.of(&state.identity).0
    }

    /// Pixels between the outer corners of the eyes in each view, as from the front, where a head that is turned away shows less.
    pub fn corner_pixels(&self, state: &HeadState, views: &[&LandmarkView]) -> Vec<Option<f64>> {
        let (corner, size) = (self.points.positions(state)[EYE_CORNERS[0]], self.size(state).0);
        let in_view = |view: &&LandmarkView| Some(view.camera.fx * size / view.camera.project(corner)?.1);
        views.iter().map(in_view).collect()
    }

    /// The head at rest with the identity of all timesteps.
    pub fn shaped(&self, heads: &Heads) -> ShapedHead {
        let identity = heads.states.first().map_or(&[][..], |state| &state.identity);
        self.model.shaped(&identity.iter().map(|weight| *weight as f32).collect::<Vec<f32>>())
    }

    /// The mean head at rest, at all timesteps.
    pub fn heads(&self) -> Heads {
        Heads {
            first: 0,
            states: vec![rest(self.model, self.identities, self.expressions); self.timesteps.len()],
            offsets: self.expected_offsets().iter().map(|offset| offset.mean).collect(),
        }
    }

    /// The timestep to begin with: the first one with nearly as many landmarks as the best one.
    pub fn first_timestep(&self) -> usize {
        let counts: Vec<usize> = self.views.iter().map(|views| landmarks_in(views)).collect();
        let most = counts.iter().copied().max().unwrap_or(0);
        counts.iter().position(|count| 10 * count >= 8 * most).unwrap_or(0)
    }

    /// `state` with the pose that fits the landmarks of a timestep best; `None` when no candidate is in front of the cameras.
    pub fn posed(&self, timestep: usize, state: &HeadState, offsets: &[DVec3]) -> Option<HeadState> {
        let mut best: Option<(f64, HeadState)> = None;
        let window = Window::one(timestep).rigid();
        for candidate in candidates(&self.points, &self.views[timestep], state) {
            let mut heads = Heads { first: timestep, states: vec![candidate], offsets: offsets.to_vec() };
            let Some(noise) = self.noise(&heads, &window) else { continue };
            let least = self.least_noise(&heads, &window);
            self.anneal_with(&mut heads, &window, noise, least);
            let Some(noise) = self.noise(&heads, &window) else { continue };
            if best.as_ref().is_none_or(|(least, _)| noise < *least) {
                best = heads.states.pop().map(|state| (noise, state));
            }
        }
        best.map(|(_, state)| state)
    }

    /// Solves for the window's parameters, first with the noise that the residuals have, then with less and less: a loss that
    /// forgives far landmarks would otherwise keep them far. Returns the noise at the end, pixels.
    pub fn anneal(&self, heads: &mut Heads, window: &Window) -> f64 {
        let least = self.least_noise(heads, window);
        let noise = self.noise(heads, window).unwrap_or(least);
        self.anneal_with(heads, window, noise, least)
    }

    fn anneal_with(&self, heads: &mut Heads, window: &Window, mut noise: f64, least: f64) -> f64 {
        const ROUNDS: usize = 8;
        let least = self.options.noise.unwrap_or(least);
        noise = noise.max(least);
        for _ in 0..ROUNDS {
            self.optimise(heads, window, noise, None, &TO_LANDMARKS);
            let now = match self.options.noise {
                Some(known) if noise <= known => break,
                _ => self.noise(heads, window).unwrap_or(least).max(least),
            };
            if now > 0.9 * noise && self.options.noise.is_none() {
                break;
            }
            // Known noise is reached, however much the fit deviates.
            noise = if now > 0.9 * noise { least } else { now };
        }
        noise
    }

    /// Fits one timestep next to a fitted one. When most landmarks are far from the fit, it starts again from their pose.
    pub fn track(&self, heads: &mut Heads, timestep: usize, neighbour: usize, noise: f64) {
        *heads.state_mut(timestep) = heads.state(neighbour).clone();
        if landmarks_in(&self.views[timestep]) == 0 {
            return;
        }
        let window = Window::one(timestep).beside(neighbour);
        let fitted = |heads: &mut Heads| {
            let now = self.noise(heads, &window).unwrap_or(noise);
            self.anneal_with(heads, &window, now.max(noise), noise)
        };
        let reached = fitted(heads);
        if reached < 3.0 * noise {
            return;
        }
        let Some(posed) = self.posed(timestep, heads.state(neighbour), &heads.offsets) else { return };
        let tracked = std::mem::replace(heads.state_mut(timestep), posed);
        if fitted(heads) >= reached {
            *heads.state_mut(timestep) = tracked;
        }
    }

    /// Learns how much further from the model's the detector's landmarks are than expected, by the evidence (MacKay 1992, "Bayesian
    /// interpolation", equation 4.9): their sum of squares over how many of them the landmarks determine.
    pub fn weigh_offsets(&mut self, heads: &Heads, window: &Window, noise: f64) {
        let (system, _) = self.linearise(heads, window, noise, None);
        let Some(step) = system.solve(0.0) else { return };
        let certainty = window.certainty();
        let shared = self.shared();
        let (mut squares, mut determined) = (0.0, 0.0);
        for (i, (offset, deviation)) in (self.identities..).zip(self.unexpected(heads)) {
            let before = (deviation / certainty).powi(2);
            determined += 1.0 - (step.shared_covariance[i * shared + i] / before).min(1.0);
            squares += (offset / deviation).powi(2);
        }
        let [least, most] = OFFSET_FACTORS;
        if determined > 1.0 {
            let learned = certainty * (squares / determined).sqrt() * self.offset_factor;
            self.offset_factor = learned.clamp(least, most);
        }
    }

    /// Levenberg-Marquardt. `noise` is that of the landmarks.
    pub fn optimise(
        &self,
        heads: &mut Heads,
        window: &Window,
        noise: f64,
        pictures: Option<&Pictures>,
        search: &Search,
    ) {
        const TRIALS: usize = 40;
        let (mut damping, mut stride, mut steps) = (1e-3, search.stride, 0);
        let (mut system, mut cost) = self.linearise(heads, window, noise, pictures);
        for _ in 0..TRIALS {
            let step = system.solve(damping).map(|step| step.times(stride));
            let moved = step.map(|step| self.moved(heads, window, &step));
            let lower = moved.and_then(|moved| {
                let (next, lower) = self.linearise(&moved, window, noise, pictures);
                (lower < cost).then_some((moved, next, lower))
            });
            let Some((moved, next, lower)) = lower else {
                if stride > 1.0 {
                    stride = 1.0;
                    continue;
                }
                damping *= 8.0;
                if damping > 1e8 {
                    break;
                }
                continue;
            };
            *heads = moved;
            let gain = (cost - lower) / cost;
            (system, cost) = (next, lower);
            damping = (damping / 8.0_f64).max(1e-9);
            steps += 1;
            if gain < search.least_gain || steps == search.steps {
                break;
            }
        }
    }

    /// The normal equations of a window, and the cost.
    pub fn linearise(
        &self,
        heads: &Heads,
        window: &Window,
        noise: f64,
        pictures: Option<&Pictures>,
    ) -> (System, f64) {
        let shared = if window.identity { self.shared() } else { 0 };
        let own: Vec<usize> = if window.rigid { self.rigid_parameters() } else { (0..self.own()).collect() };
        let state = |timestep: usize| heads.state(timestep);
        let terms = |timestep: usize| {
            let mut terms = self.data(heads, timestep, window, noise);
            if let Some(pictures) = pictures {
                pictures.add(self, heads, timestep, window, &mut terms);
            }
            let inside = |other: &usize| window.range.contains(other);
            let before = timestep.checked_sub(1).filter(inside);
            let after = Some(timestep + 1).filter(inside);
            // Pairs inside the window are counted once in the cost, with the later of the two.
            let neighbours = [(before, 1.0), (after, 0.0), (window.neighbour, 1.0)];
            let neighbours = neighbours.into_iter().filter_map(|(at, counted)| Some((state(at?), counted)));
            self.add_priors(state(timestep), neighbours, &mut terms);
            terms
        };
        let (size, _) = self.size(state(window.range.start));
        let mut system = System {
            shared: vec![0.0; shared * shared],
            shared_gradient: vec![0.0; shared],
            blocks: Vec::with_capacity(window.range.len()),
            coupling: own.iter().map(|i| self.coupling(size, *i)).collect(),
        };
        let mut cost = 0.0;
        let n = self.shared() + self.own();
        let timesteps: Vec<usize> = window.range.clone().collect();
        for timesteps in timesteps.chunks(AT_ONCE) {
            let terms: Vec<Terms> = timesteps.par_iter().map(|timestep| terms(*timestep)).collect();
            for Terms { cost: of_timestep, hessian, gradient } in terms {
                cost += of_timestep;
                let entry = |i: usize, j: usize| hessian[i.max(j) * n + i.min(j)];
                for (i, (sum, value)) in system.shared_gradient.iter_mut().zip(&gradient).enumerate() {
                    *sum += value;
                    for j in 0..shared {
                        system.shared[i * shared + j] += entry(i, j);
                    }
                }
                let place = |i: &usize| self.shared() + *i;
                let own = || own.iter().map(place);
                system.blocks.push(Block {
                    hessian: own()
                        .flat_map(|i| own().map(move |j| (i, j)))
                        .map(|(i, j)| entry(i, j))
                        .collect(),
                    cross: own()
                        .flat_map(|i| (0..shared).map(move |j| (i, j)))
                        .map(|(i, j)| entry(i, j))
                        .collect(),
                    gradient: own().map(|i| gradient[i]).collect(),
                });
            }
        }
        if let Some(state) = heads.states.first().filter(|_| window.identity) {
            let certainty = window.certainty();
            // Shadows and folds are at the same places in all pictures: together they tell as much about the identity as one. The
            // landmarks count as little then, and have had their say.
            let of_identity = if pictures.is_some() { (window.range.len() as f64).sqrt() } else { certainty };
            let identity = self.options.priors.identity / of_identity;
            let weights = state.identity.iter().map(|weight| (*weight, identity));
            let offsets = self.unexpected(heads).map(|(offset, deviation)| (offset, deviation / certainty));
            for (i, (value, deviation)) in weights.chain(offsets).enumerate() {
                let precision = deviation.powi(-2);
                cost += value * value * precision;
                system.shared_gradient[i] += value * precision;
                system.shared[i * shared + i] += precision;
            }
            let held = || pictures.and_then(|pictures| pictures.eye_distance);
            if let Some(distance) = self.options.eye_distance.or_else(held) {
                let (found, slopes) = self.pupils.of(&state.identity);
                let precision = (certainty / EYE_DISTANCE_DEVIATION).powi(2);
                cost += (found - distance).powi(2) * precision;
                for (i, slope) in slopes.iter().enumerate() {
                    system.shared_gradient[i] += (found - distance) * slope * precision;
                    for (j, other) in slopes.iter().enumerate() {
                        system.shared[i * shared + j] += slope * other * precision;
                    }
                }
            }
        }
        (system, cost)
    }

    /// Root and translation among the parameters of a timestep.
    fn rigid_parameters(&self) -> Vec<usize> {
        let (root, translation) = (self.expressions, self.own() - 3);
        (root..root + 3).chain(translation..translation + 3).collect()
    }

    /// The heads after a step.
    pub fn moved(&self, heads: &Heads, window: &Window, step: &Step) -> Heads {
        let own: Vec<usize> = if window.rigid { self.rigid_parameters() } else { (0..self.own()).collect() };
        let mut moved = heads.clone();
        for (timestep, step_of) in window.range.clone().zip(&step.own) {
            let state = moved.state_mut(timestep);
            let mut full = vec![0.0; self.own()];
            own.iter().zip(step_of).for_each(|(i, value)| full[*i] = *value);
            for (weight, value) in state.expressions.iter_mut().zip(&full) {
                *weight += value;
            }
            let (vectors, _) = full[self.expressions..].as_chunks::<3>();
            for (&joint, turn) in self.joints.iter().zip(vectors) {
                let turned = DQuat::from_scaled_axis(DVec3::from_array(*turn)) * state.joint(joint);
                *state.joint_mut(joint) = turned.normalize();
            }
            state.translation += vectors.last().map_or(DVec3::ZERO, |v| DVec3::from_array(*v));
        }
        if window.identity {
            for state in &mut moved.states {
                for (weight, value) in state.identity.iter_mut().zip(&step.shared) {
                    *weight += value;
                }
            }
            let (offsets, _) = step.shared[self.identities..].as_chunks::<3>();
            for (offset, change) in moved.offsets.iter_mut().zip(offsets) {
                *offset += DVec3::from_array(*change);
            }
        }
        moved
    }
}

/// The mean head at rest, with this many weights.
fn rest(model: &HeadModel, identities: usize, expressions: usize) -> HeadState {
    HeadState {
        identity: vec![0.0; identities],
        expressions: vec![0.0; expressions],
        joints: vec![DQuat::IDENTITY; model.joints.len()],
        translation: DVec3::ZERO,
    }
}

/// A distance between two places on the head at rest, as a vector from one to the other.
pub(super) struct DistanceAtRest {
    /// Of the mean head.
    pub mean: DVec3,
    /// What each identity weight adds.
    shapes: Vec<DVec3>,
}

impl DistanceAtRest {
    /// Between the means of some landmarks.
    fn between(points: &HeadPoints, rest: &HeadState, from: &[usize], to: &[usize]) -> Self {
        let (columns, identities, rest) = (points.columns(), rest.identity.len(), points.derivatives(rest));
        let apart = |value: &dyn Fn(usize) -> DVec3| {
            let mean = |of: &[usize]| of.iter().map(|l| value(*l)).sum::<DVec3>() / of.len() as f64;
            mean(to) - mean(from)
        };
        Self {
            mean: apart(&|landmark| rest.positions[landmark]),
            shapes: (0..identities).map(|i| apart(&|l| rest.values[l * columns + i])).collect(),
        }
    }

    /// Its length, and how that grows with each identity weight.
    fn of(&self, identity: &[f64]) -> (f64, Vec<f64>) {
        let weighted = self.shapes.iter().zip(identity).map(|(shape, weight)| *shape * *weight);
        let apart = self.mean + weighted.sum::<DVec3>();
        let along = apart.normalize_or_zero();
        (apart.length(), self.shapes.iter().map(|shape| shape.dot(along)).collect())
    }
}
