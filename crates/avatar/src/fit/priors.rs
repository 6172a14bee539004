//! The priors of a fit: residuals of parameters, and their derivatives.

use glam::{DMat3, DVec3};

use super::problem::{Problem, Terms};
use srflow_head::{HeadModel, HeadState, JointRole, rotation_of_axis_angle};

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
    /// Of where the detector puts a landmark on the head, from where the model has it, along each axis; in distances between the
    /// outer corners of the eyes. Detectors and models define landmarks differently, and without this the identity has to
    /// explain the difference. A first guess: it is learned from the landmarks.
    /// For MediaPipe, the table of [`Detector`](super::Detector) replaces it.
    pub landmark: f64,
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
            landmark: 0.015,
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

impl Problem<'_> {
    /// Standard deviation of the change of a parameter between timesteps, in the head's own unit.
    fn change_deviation(&self, own: usize) -> f64 {
        let priors = &self.options.priors;
        if own < self.expressions {
            return priors.expression_change;
        }
        match self.joints.get((own - self.expressions) / 3).map(|joint| self.role(*joint)) {
            Some(JointRole::Root) => priors.rotation_change,
            Some(JointRole::Neck) => priors.neck_change,
            Some(JointRole::Jaw) => priors.jaw_change,
            Some(JointRole::LeftEye | JointRole::RightEye) => priors.eyes_change,
            None => priors.translation_change,
        }
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

    /// Adds the priors of a timestep, and of its changes from neighbours, whose costs are multiplied by a number.
    pub fn add_priors<'s>(
        &self,
        state: &HeadState,
        neighbours: impl Iterator<Item = (&'s HeadState, f64)>,
        terms: &mut Terms,
    ) {
        let (size, slopes) = self.size(state);
        let unit = self.unit(size);
        let (shared, n) = (self.shared(), self.shared() + self.own());
        let mut sum =
            PriorSum { terms, shared, n, gradient: 0.0, hessian: 0.0, cross: vec![0.0; self.own()] };
        self.own_priors(state, unit, &mut sum);
        for (other, counted) in neighbours {
            self.smoothness(state, other, unit, counted, &mut sum);
        }
        sum.spread(slopes.iter().map(|slope| slope / size).collect());
    }

    /// How a parameter of a timestep is coupled to its neighbours', see [`System::coupling`](super::arrow::System), for a head of
    /// this size.
    pub fn coupling(&self, size: f64, own: usize) -> f64 {
        let unit = if self.grows(own) { self.unit(size) } else { 1.0 };
        (self.change_deviation(own) * unit).powi(-2)
    }

    fn own_priors(&self, state: &HeadState, unit: f64, sum: &mut PriorSum) {
        for (number, &weight) in state.expressions.iter().enumerate().take(self.expressions) {
            let weight = weight / unit;
            let mut add = |value: f64, deviation: f64| {
                sum.add(number, Residual { value, slope: unit.recip(), shrinks: weight }, deviation, 1.0);
            };
            add(weight, self.expression_deviation(number));
            if let Some([low, high]) = self.ranges[number] {
                let beyond = weight - weight.clamp(low, high);
                if beyond != 0.0 {
                    add(beyond, BEYOND);
                }
            }
        }
        let PriorSum { terms, shared, n, .. } = sum;
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
            let place = *shared + self.expressions + 3 * number;
            for i in 0..3 {
                terms.gradient[place + i] += gradient[i];
                for j in 0..=i {
                    terms.hessian[(place + i) * *n + place + j] += hessian.col(j)[i];
                }
            }
        }
    }

    /// The change between a timestep and a neighbour, whose cost is multiplied by `counted`.
    fn smoothness(&self, state: &HeadState, other: &HeadState, unit: f64, counted: f64, sum: &mut PriorSum) {
        let expressions = state.expressions.iter().zip(&other.expressions).map(|(a, b)| a - b);
        // To first order in the change between timesteps, its derivatives by both rotations are plus and minus the identity.
        let turned =
            |&joint: &usize| (state.joint(joint) * other.joint(joint).inverse()).to_scaled_axis().to_array();
        let joints = self.joints.iter().flat_map(turned);
        let moved = (state.translation - other.translation).to_array();
        let changes = expressions.take(self.expressions).chain(joints).chain(moved);
        for (i, change) in changes.enumerate() {
            let residual = if self.grows(i) {
                Residual { value: change / unit, slope: unit.recip(), shrinks: change / unit }
            } else {
                Residual { value: change, slope: 1.0, shrinks: 0.0 }
            };
            sum.add(i, residual, self.change_deviation(i), counted);
        }
    }

    /// Whether a parameter of a timestep is larger in a larger head: expressions and translation are, rotations are not.
    fn grows(&self, own: usize) -> bool {
        own < self.expressions || own >= self.own() - 3
    }

    /// What parameters that grow with the head are measured in: its size, in sizes of the mean head. Else all timesteps together would
    /// find small heads probable, whose expressions and motions are small.
    fn unit(&self, size: f64) -> f64 {
        size / self.corners.mean.length()
    }
}

/// A residual of a prior: its value, how it grows with its parameter, and how it shrinks as the logarithm of the size of the head grows.
struct Residual {
    value: f64,
    slope: f64,
    shrinks: f64,
}

/// Adds priors to the terms of a timestep.
struct PriorSum<'t> {
    terms: &'t mut Terms,
    /// Number of shared parameters, and of all.
    shared: usize,
    n: usize,
    /// Derivatives by the logarithm of the size of the head; `cross` with each of the timestep's own parameters.
    gradient: f64,
    hessian: f64,
    cross: Vec<f64>,
}

impl PriorSum<'_> {
    /// Adds the square of a residual of a timestep's own parameter, in standard deviations; its cost is multiplied by `counted`.
    fn add(&mut self, own: usize, residual: Residual, deviation: f64, counted: f64) {
        let Residual { value, slope, shrinks } = residual;
        let [value, slope, shrinks] = [value, slope, shrinks].map(|of| of / deviation);
        let i = self.shared + own;
        self.terms.cost += counted * value * value;
        self.terms.gradient[i] += value * slope;
        self.terms.hessian[i * self.n + i] += slope * slope;
        self.gradient -= counted * value * shrinks;
        self.hessian += counted * shrinks * shrinks;
        self.cross[own] -= slope * shrinks;
    }

    /// Adds derivatives by the logarithm of the size as those by the identity, with each weight of which it grows by `growth`.
    fn spread(self, growth: Vec<f64>) {
        let Self { terms, shared, n, gradient, hessian, cross } = self;
        for (i, growth_of) in growth.iter().enumerate() {
            terms.gradient[i] += gradient * growth_of;
            for (sum, other) in terms.hessian[i * n..].iter_mut().zip(&growth[..=i]) {
                *sum += hessian * growth_of * other;
            }
        }
        for (row, cross) in terms.hessian.chunks_exact_mut(n).skip(shared).zip(cross) {
            row.iter_mut().zip(&growth).for_each(|(sum, growth)| *sum += cross * growth);
        }
    }
}

/// The range of weights of each expression that an action unit is made of: from zero to its weight at full intensity. Components have none.
pub(super) fn ranges(model: &HeadModel, count: usize) -> Vec<Option<[f64; 2]>> {
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
