//! Residuals, their derivatives, and Levenberg-Marquardt over a window of timesteps.

use std::ops::Range;

use glam::{DMat3, DQuat, DVec2, DVec3};
use rayon::prelude::*;

use super::arrow::{Block, Step, System};
use super::initial::candidates;
use super::{FitOptions, LandmarkView};
use crate::capture::LANDMARK_COUNT;
use srflow_core::median;
use srflow_head::{HeadModel, HeadPoints, HeadState, JointRole, rotation_of_axis_angle};

/// Standard deviations of normal distributions: of parameters about rest, and of their change from one timestep to the next that
/// has a picture (`*_change`).
///
/// VHAP's weights (`vhap/config/base.py`, `nersemble.py`) belong to distances in normalised device coordinates that are averaged over
/// landmarks. Here landmarks have a noise in pixels, so each prior is a width in the parameter's own unit; they keep the order
/// of VHAP's weights: eyes are freer than neck and jaw, and the jaw may change faster than neck, rotation and translation.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Priors {
    /// Of an identity weight; 1 where the basis is in standard deviations, as in FLAME, GNM and ICT-FaceKit.
    pub identity: f64,
    /// Of an expression weight. An expression with a range, that is one which an action unit is made of, has half of its range
    /// instead, and resists leaving it.
    pub expression: f64,
    /// Of the neck's rotation about each axis, radians.
    pub neck: f64,
    /// Of the jaw's opening, radians. Sideways and twisted it has a fifth of this, and it resists closing beyond rest.
    pub jaw: f64,
    /// Of each eyeball's rotation, radians.
    pub eyes: f64,
    /// Metres.
    pub translation_change: f64,
    /// Of the whole head, radians.
    pub rotation_change: f64,
    /// Radians.
    pub neck_change: f64,
    /// Radians.
    pub jaw_change: f64,
    /// Radians.
    pub eyes_change: f64,
    pub expression_change: f64,
}

impl Default for Priors {
    fn default() -> Self {
        Self {
            identity: 1.0,
            expression: 1.0,
            neck: 0.2,
            jaw: 0.2,
            eyes: 0.4,
            translation_change: 0.01,
            rotation_change: 0.05,
            neck_change: 0.05,
            jaw_change: 0.2,
            eyes_change: 0.4,
            expression_change: 0.3,
        }
    }
}

/// Weights beyond the range of an expression, and a jaw closed beyond rest, have this standard deviation.
const BEYOND: f64 = 0.05;

/// The noise is not estimated below this, in pixels: no detector is more precise.
const LEAST_NOISE: f64 = 0.25;

/// The first landmark that is not of the jaw's contour.
const CONTOUR: usize = 17;

/// For two normally distributed coordinates, the median distance in standard deviations.
const MEDIAN_DISTANCE: f64 = 1.177_41;

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
    ranges: Vec<Option<[f64; 2]>>,
    /// How many times less precise each landmark is than the best ones.
    factors: Vec<f64>,
    /// One over the variance of the change between timesteps, for each parameter of a timestep.
    coupling: Vec<f64>,
}

/// What is solved for: parameters of some timesteps, the others held.
#[derive(Debug, Clone)]
pub(super) struct Window {
    range: Range<usize>,
    identity: bool,
    /// Rotation of the root and translation alone.
    rigid: bool,
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

    fn rigid(self) -> Self {
        Self { rigid: true, ..self }
    }

    fn beside(self, neighbour: usize) -> Self {
        Self { neighbour: Some(neighbour), ..self }
    }
}

/// One landmark in one view.
pub(super) struct Residual {
    pub landmark: usize,
    /// Index into the views of the timestep.
    pub view: usize,
    /// Projected minus detected, pixels; `None` behind the camera.
    pub pixels: Option<DVec2>,
}

/// A sum of squares and its linearisation.
struct Terms {
    cost: f64,
    /// Identity, then the timestep's own parameters; n x n, only the lower triangle before [`Problem::linearise`] has split it.
    hessian: Vec<f64>,
    gradient: Vec<f64>,
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
        let mut problem = Self {
            model,
            points: HeadPoints::on_triangles(model, &model.landmarks[..LANDMARK_COUNT]),
            options,
            views: timesteps.iter().map(of).collect(),
            timesteps,
            identities: model.identities.len().min(options.identities),
            expressions,
            joints,
            ranges: ranges(model, expressions),
            factors: (0..LANDMARK_COUNT).map(|l| if l < CONTOUR { options.contour } else { 1.0 }).collect(),
            coupling: Vec::new(),
        };
        problem.coupling = problem.couplings();
        problem
    }

    fn couplings(&self) -> Vec<f64> {
        let priors = &self.options.priors;
        let mut deviations = vec![priors.expression_change; self.expressions];
        for &joint in &self.joints {
            let deviation = match self.role(joint) {
                JointRole::Root => priors.rotation_change,
                JointRole::Neck => priors.neck_change,
                JointRole::Jaw => priors.jaw_change,
                JointRole::LeftEye | JointRole::RightEye => priors.eyes_change,
            };
            deviations.extend([deviation; 3]);
        }
        deviations.extend([priors.translation_change; 3]);
        deviations.iter().map(|deviation| deviation.powi(-2)).collect()
    }

    pub fn role(&self, joint: usize) -> JointRole {
        self.model.joints[joint].role.unwrap_or(JointRole::Root)
    }

    /// Number of parameters of one timestep: expressions, three per joint, translation.
    pub fn own(&self) -> usize {
        self.expressions + 3 * self.joints.len() + 3
    }

    /// Columns of [`HeadPoints::derivatives`]: identity, then the timestep's own.
    pub fn columns(&self) -> Vec<usize> {
        let (identities, expressions) = (self.model.identities.len(), self.model.expressions.len());
        let of_joints = identities + expressions;
        let joints =
            self.joints.iter().flat_map(|joint| (0..3).map(move |axis| of_joints + 3 * joint + axis));
        (0..self.identities)
            .chain((0..self.expressions).map(|e| identities + e))
            .chain(joints)
            .chain((0..3).map(|axis| of_joints + 3 * self.model.joints.len() + axis))
            .collect()
    }

    /// The mean head at rest.
    pub fn rest(&self) -> HeadState {
        HeadState {
            identity: vec![0.0; self.identities],
            expressions: vec![0.0; self.expressions],
            joints: vec![DQuat::IDENTITY; self.model.joints.len()],
            translation: DVec3::ZERO,
        }
    }

    /// The timestep to begin with: the first one with nearly as many landmarks as the best one.
    pub fn first_timestep(&self) -> usize {
        let counts: Vec<usize> = self.views.iter().map(|views| landmarks_in(views)).collect();
        let most = counts.iter().copied().max().unwrap_or(0);
        counts.iter().position(|count| 10 * count >= 8 * most).unwrap_or(0)
    }

    /// `state` with the pose that fits the landmarks of a timestep best; `None` when no candidate is in front of the cameras.
    pub fn posed(&self, timestep: usize, state: &HeadState) -> Option<HeadState> {
        let mut best: Option<(f64, HeadState)> = None;
        for candidate in candidates(&self.points, &self.views[timestep], state) {
            let mut states = vec![candidate];
            let noise = self.anneal_from(&mut states, timestep, &Window::one(timestep).rigid());
            let Some(noise) = noise else { continue };
            if best.as_ref().is_none_or(|(least, _)| noise < *least) {
                best = states.pop().map(|state| (noise, state));
            }
        }
        best.map(|(_, state)| state)
    }

    fn anneal_from(&self, states: &mut [HeadState], first: usize, window: &Window) -> Option<f64> {
        let noise = self.noise(states, first, window)?;
        Some(self.anneal_with(states, first, window, noise, LEAST_NOISE))
    }

    /// Solves for the window's parameters, first with the noise that the residuals have, then with less and less: a loss that
    /// forgives far landmarks would otherwise keep them far. Returns the noise at the end, pixels.
    pub fn anneal(&self, states: &mut [HeadState], window: &Window) -> f64 {
        let noise = self.noise(states, 0, window).unwrap_or(LEAST_NOISE);
        self.anneal_with(states, 0, window, noise, LEAST_NOISE)
    }

    /// As [`Problem::anneal`], for states of the timesteps from `first` on.
    fn anneal_with(
        &self,
        states: &mut [HeadState],
        first: usize,
        window: &Window,
        mut noise: f64,
        least: f64,
    ) -> f64 {
        const ROUNDS: usize = 8;
        let least = self.options.noise.unwrap_or(least);
        noise = noise.max(least);
        for _ in 0..ROUNDS {
            self.optimise(states, first, window, noise);
            let now = match self.options.noise {
                Some(known) if noise <= known => break,
                _ => self.noise(states, first, window).unwrap_or(least).max(least),
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
    pub fn track(&self, states: &mut [HeadState], timestep: usize, neighbour: usize, noise: f64) {
        if landmarks_in(&self.views[timestep]) == 0 {
            return;
        }
        let window = Window::one(timestep).beside(neighbour);
        let fitted = |states: &mut [HeadState]| {
            let now = self.noise(states, 0, &window).unwrap_or(noise);
            self.anneal_with(states, 0, &window, now.max(noise), noise)
        };
        let reached = fitted(states);
        if reached < 3.0 * noise {
            return;
        }
        let Some(posed) = self.posed(timestep, &states[neighbour]) else { return };
        let tracked = std::mem::replace(&mut states[timestep], posed);
        if fitted(states) >= reached {
            states[timestep] = tracked;
        }
    }

    /// Standard deviation of the landmarks' coordinates, in pixels, by the median of the residuals; `None` without landmarks.
    fn noise(&self, states: &[HeadState], first: usize, window: &Window) -> Option<f64> {
        let mut views = window.range.clone().flat_map(|timestep| &self.views[timestep]);
        let without_contour = views.any(|view| view.landmarks[CONTOUR..].iter().any(Option::is_some));
        let residuals = |timestep: usize| {
            let residuals = self.residuals(timestep, &states[timestep - first]);
            let norms = residuals
                .into_iter()
                .filter(|residual| !without_contour || residual.landmark >= CONTOUR)
                .map(|r| r.pixels.map_or(f64::INFINITY, |pixels| pixels.length()) / self.factor(r.landmark));
            norms.collect::<Vec<f64>>()
        };
        let norms: Vec<Vec<f64>> = window.range.clone().into_par_iter().map(residuals).collect();
        let norms = norms.concat();
        if norms.is_empty() {
            return None;
        }
        let noise = median(norms.iter().copied()) / MEDIAN_DISTANCE;
        // Parameters take up some of the noise; priors hold many of them, so that half of the residuals always count.
        let free = if window.rigid { 6 } else { self.own() };
        let free = (free * window.range.len() + if window.identity { self.identities } else { 0 }) as f64;
        let count = 2.0 * norms.len() as f64;
        noise.is_finite().then(|| noise * (count / (count - free).max(0.5 * count)).sqrt())
    }

    /// How many times less precise a landmark is than others.
    pub fn factor(&self, landmark: usize) -> f64 {
        self.factors[landmark]
    }

    /// Learns how precise each landmark is from its residuals: some are defined by less than a corner, and a detector may place
    /// them elsewhere than the model does.
    pub fn weigh_landmarks(&mut self, states: &[HeadState], noise: f64) {
        // With fewer residuals the median says little.
        const ENOUGH: usize = 8;
        const MOST: f64 = 8.0;
        let mut distances = vec![Vec::new(); LANDMARK_COUNT];
        for (timestep, state) in states.iter().enumerate() {
            for residual in self.residuals(timestep, state) {
                let distance = residual.pixels.map_or(f64::INFINITY, |pixels| pixels.length());
                distances[residual.landmark].push(distance);
            }
        }
        for (factor, distances) in self.factors.iter_mut().zip(distances) {
            if distances.len() >= ENOUGH {
                *factor = (median(distances.iter().copied()) / (MEDIAN_DISTANCE * noise)).clamp(1.0, MOST);
            }
        }
    }

    /// All detected landmarks of a timestep against those of `state`.
    pub fn residuals(&self, timestep: usize, state: &HeadState) -> Vec<Residual> {
        let positions = self.points.positions(state);
        let mut residuals = Vec::new();
        for (view, seen) in self.views[timestep].iter().enumerate() {
            for (landmark, pixel) in seen.landmarks.iter().enumerate() {
                if let Some([x, y]) = *pixel {
                    let projected = seen.camera.project(positions[landmark]);
                    let pixels =
                        projected.map(|(pixel, _)| pixel - DVec2::new(x, y)).filter(|r| r.is_finite());
                    residuals.push(Residual { landmark, view, pixels });
                }
            }
        }
        residuals
    }

    /// Levenberg-Marquardt. `states` are those of the timesteps from `first` on.
    fn optimise(&self, states: &mut [HeadState], first: usize, window: &Window, noise: f64) {
        const ITERATIONS: usize = 40;
        const ENOUGH: f64 = 1e-6;
        let mut damping = 1e-3;
        let (mut system, mut cost) = self.linearise(states, first, window, noise);
        for _ in 0..ITERATIONS {
            let moved = system.solve(damping).map(|step| self.moved(states, first, window, &step));
            let lower = moved.and_then(|moved| {
                let (next, lower) = self.linearise(&moved, first, window, noise);
                (lower < cost).then_some((moved, next, lower))
            });
            let Some((moved, next, lower)) = lower else {
                damping *= 8.0;
                if damping > 1e8 {
                    break;
                }
                continue;
            };
            states.clone_from_slice(&moved);
            let gain = (cost - lower) / cost;
            (system, cost) = (next, lower);
            damping = (damping / 8.0_f64).max(1e-9);
            if gain < ENOUGH {
                break;
            }
        }
    }

    /// The normal equations of a window, and the cost.
    pub fn linearise(
        &self,
        states: &[HeadState],
        first: usize,
        window: &Window,
        noise: f64,
    ) -> (System, f64) {
        let shared = if window.identity { self.identities } else { 0 };
        let own: Vec<usize> = if window.rigid { self.rigid_parameters() } else { (0..self.own()).collect() };
        let state = |timestep: usize| &states[timestep - first];
        let terms: Vec<Terms> = window
            .range
            .clone()
            .into_par_iter()
            .map(|timestep| {
                let mut terms = self.data(timestep, state(timestep), noise);
                self.own_priors(state(timestep), &mut terms);
                let inside = |other: &usize| window.range.contains(other);
                let before = timestep.checked_sub(1).filter(inside);
                let after = Some(timestep + 1).filter(inside);
                // Pairs inside the window are counted once in the cost, with the later of the two.
                for (other, counted) in [(before, 1.0), (after, 0.0), (window.neighbour, 1.0)] {
                    if let Some(other) = other {
                        self.smoothness(state(timestep), state(other), counted, &mut terms);
                    }
                }
                terms
            })
            .collect();

        let mut system = System {
            shared: vec![0.0; shared * shared],
            shared_gradient: vec![0.0; shared],
            blocks: Vec::with_capacity(terms.len()),
            coupling: own.iter().map(|i| self.coupling[*i]).collect(),
        };
        let mut cost = 0.0;
        let n = self.identities + self.own();
        for Terms { cost: of_timestep, hessian, gradient } in terms {
            cost += of_timestep;
            let entry = |i: usize, j: usize| hessian[i.max(j) * n + i.min(j)];
            for (i, (sum, value)) in system.shared_gradient.iter_mut().zip(&gradient).enumerate() {
                *sum += value;
                for j in 0..shared {
                    system.shared[i * shared + j] += entry(i, j);
                }
            }
            let place = |i: &usize| self.identities + *i;
            let own = || own.iter().map(place);
            system.blocks.push(Block {
                hessian: own().flat_map(|i| own().map(move |j| (i, j))).map(|(i, j)| entry(i, j)).collect(),
                cross: own()
                    .flat_map(|i| (0..shared).map(move |j| (i, j)))
                    .map(|(i, j)| entry(i, j))
                    .collect(),
                gradient: own().map(|i| gradient[i]).collect(),
            });
        }
        let precision = self.options.priors.identity.powi(-2);
        if let Some(state) = states.first() {
            for (i, weight) in state.identity.iter().enumerate().take(shared) {
                cost += weight * weight * precision;
                system.shared_gradient[i] += weight * precision;
                system.shared[i * shared + i] += precision;
            }
        }
        (system, cost)
    }

    /// Root and translation among the parameters of a timestep.
    fn rigid_parameters(&self) -> Vec<usize> {
        let (root, translation) = (self.expressions, self.own() - 3);
        (root..root + 3).chain(translation..translation + 3).collect()
    }

    /// The states after a step.
    fn moved(&self, states: &[HeadState], first: usize, window: &Window, step: &Step) -> Vec<HeadState> {
        let own: Vec<usize> = if window.rigid { self.rigid_parameters() } else { (0..self.own()).collect() };
        let mut moved = states.to_vec();
        for (timestep, step_of) in window.range.clone().zip(&step.own) {
            let state = &mut moved[timestep - first];
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
            for state in &mut moved {
                for (weight, value) in state.identity.iter_mut().zip(&step.shared) {
                    *weight += value;
                }
            }
        }
        moved
    }

    /// The landmarks of a timestep.
    fn data(&self, timestep: usize, state: &HeadState, noise: f64) -> Terms {
        let n = self.identities + self.own();
        let mut terms = Terms { cost: 0.0, hessian: vec![0.0; n * n], gradient: vec![0.0; n] };
        let views = &self.views[timestep];
        if landmarks_in(views) == 0 {
            return terms;
        }
        let limit = self.options.outlier * self.options.outlier;
        let all = self.points.columns();
        let derivatives = self.points.derivatives(state);
        let columns = self.columns();
        let mut along = vec![0.0; 3 * n];
        let mut pulled = vec![0.0; 3 * n];
        for (landmark, &position) in derivatives.positions.iter().enumerate() {
            // All views of a landmark share its derivatives in the world: they are summed first.
            let (mut information, mut gradient, mut seen) = (DMat3::ZERO, DVec3::ZERO, false);
            let precision = (noise * self.factor(landmark)).powi(-2);
            for view in views {
                let Some([x, y]) = view.landmarks[landmark] else { continue };
                let camera = &view.camera;
                let point = camera.camera_from_world.transform_point3(position);
                let pixel = DVec2::new(
                    camera.fx * point.x / point.z + camera.cx,
                    camera.fy * point.y / point.z + camera.cy,
                );
                let residual = pixel - DVec2::new(x, y);
                let square = residual.length_squared() * precision;
                if !(point.z > 0.0 && square.is_finite()) {
                    terms.cost += limit;
                    continue;
                }
                let softened = 1.0 + square / limit;
                terms.cost += square / softened;
                let weight = precision / (softened * softened);
                let across = DVec3::new(camera.fx, 0.0, -camera.fx * point.x / point.z) / point.z;
                let down = DVec3::new(0.0, camera.fy, -camera.fy * point.y / point.z) / point.z;
                let world_from_camera = DMat3::from_mat4(camera.camera_from_world).transpose();
                for (row, residual) in [(across, residual.x), (down, residual.y)] {
                    let row = world_from_camera * row;
                    information += DMat3::from_cols(row * row.x, row * row.y, row * row.z) * weight;
                    gradient += row * (weight * residual);
                }
                seen = true;
            }
            if !seen {
                continue;
            }
            let row = &derivatives.values[landmark * all..][..all];
            for (i, column) in columns.iter().enumerate() {
                let moves = row[*column];
                terms.gradient[i] += moves.dot(gradient);
                for (axis, (moves, pull)) in
                    moves.to_array().into_iter().zip((information * moves).to_array()).enumerate()
                {
                    along[axis * n + i] = moves;
                    pulled[axis * n + i] = pull;
                }
            }
            for (along, pulled) in along.chunks_exact(n).zip(pulled.chunks_exact(n)) {
                for (i, &weight) in along.iter().enumerate().filter(|(_, weight)| **weight != 0.0) {
                    for (sum, value) in terms.hessian[i * n..=i * n + i].iter_mut().zip(pulled) {
                        *sum += weight * value;
                    }
                }
            }
        }
        terms
    }

    /// Standard deviations of a fitted joint's rotation about each axis; `None` for the root.
    pub fn joint_deviations(&self, joint: usize) -> Option<DVec3> {
        let priors = &self.options.priors;
        match self.role(joint) {
            JointRole::Root => None,
            JointRole::Neck => Some(DVec3::splat(priors.neck)),
            JointRole::Jaw => Some(DVec3::new(1.0, 0.2, 0.2) * priors.jaw),
            JointRole::LeftEye | JointRole::RightEye => Some(DVec3::splat(priors.eyes)),
        }
    }

    /// Standard deviation of the weight of expression `number`.
    pub fn expression_deviation(&self, number: usize) -> f64 {
        self.ranges[number].map_or(self.options.priors.expression, |[low, high]| 0.5 * (high - low))
    }

    fn own_priors(&self, state: &HeadState, terms: &mut Terms) {
        let n = self.identities + self.own();
        for (number, &weight) in state.expressions.iter().enumerate().take(self.expressions) {
            let i = self.identities + number;
            let precision = self.expression_deviation(number).powi(-2);
            terms.add(n, i, weight, precision);
            if let Some([low, high]) = self.ranges[number] {
                let beyond = weight - weight.clamp(low, high);
                if beyond != 0.0 {
                    terms.add(n, i, beyond, BEYOND.powi(-2));
                }
            }
        }
        for (number, &joint) in self.joints.iter().enumerate() {
            let Some(deviations) = self.joint_deviations(joint) else { continue };
            let vector = state.joint(joint).to_scaled_axis();
            let mut precision = deviations.recip() * deviations.recip();
            let mut cost = (vector * vector).dot(precision);
            let mut pull = vector * precision;
            if self.role(joint) == JointRole::Jaw && vector.x < 0.0 {
                cost += (vector.x / BEYOND).powi(2);
                pull.x += vector.x / (BEYOND * BEYOND);
                precision.x += BEYOND.powi(-2);
            }
            // The vector changes by the inverse of that matrix times the small rotation that is solved for.
            let slope = rotation_of_axis_angle(vector).inverse();
            let gradient = slope.transpose() * pull;
            let hessian = slope.transpose() * DMat3::from_diagonal(precision) * slope;
            terms.cost += cost;
            let place = self.identities + self.expressions + 3 * number;
            for i in 0..3 {
                terms.gradient[place + i] += gradient[i];
                for j in 0..=i {
                    terms.hessian[(place + i) * n + place + j] += hessian.col(j)[i];
                }
            }
        }
    }

    /// The change between a timestep and a neighbour, whose cost is multiplied by `counted`.
    fn smoothness(&self, state: &HeadState, other: &HeadState, counted: f64, terms: &mut Terms) {
        let n = self.identities + self.own();
        let expressions = state.expressions.iter().zip(&other.expressions).map(|(a, b)| a - b);
        // To first order in the change between timesteps, its derivatives by both rotations are plus and minus the identity.
        let turned =
            |&joint: &usize| (state.joint(joint) * other.joint(joint).inverse()).to_scaled_axis().to_array();
        let joints = self.joints.iter().flat_map(turned);
        let moved = (state.translation - other.translation).to_array();
        let changes = expressions.take(self.expressions).chain(joints).chain(moved);
        for (i, (change, precision)) in changes.zip(&self.coupling).enumerate() {
            let place = self.identities + i;
            terms.cost += counted * change * change * precision;
            terms.gradient[place] += change * precision;
            terms.hessian[place * n + place] += precision;
        }
    }
}

impl Terms {
    /// Adds the square of `residual`, whose derivative by parameter `i` is 1, times `precision`.
    fn add(&mut self, n: usize, i: usize, residual: f64, precision: f64) {
        self.cost += residual * residual * precision;
        self.gradient[i] += residual * precision;
        self.hessian[i * n + i] += precision;
    }
}

/// Number of detected landmarks.
pub(super) fn landmarks_in(views: &[&LandmarkView]) -> usize {
    views.iter().map(|view| view.landmarks.iter().flatten().count()).sum()
}

/// The range of weights of each expression that an action unit is made of: from zero to its weight at full intensity. Components have none.
fn ranges(model: &HeadModel, count: usize) -> Vec<Option<[f64; 2]>> {
    let mut ranges: Vec<Option<[f64; 2]>> = vec![None; model.expressions.len()];
    let units = model.action_units.iter().filter(|_| !model.expressions_are_components);
    for &(expression, weight) in units.flat_map(|unit| &unit.expressions) {
        let [low, high] = ranges[expression].get_or_insert([0.0; 2]);
        (*low, *high) = (low.min(f64::from(weight)), high.max(f64::from(weight)));
    }
    ranges.truncate(count);
    // An action unit may list an expression with the weight zero.
    ranges.into_iter().map(|range| range.filter(|[low, high]| high > low)).collect()
}
