//! What a fit leaves unexplained, and what the landmarks cannot determine.

use glam::DVec3;
use serde::Serialize;

use super::detectors::Detector;
use super::landmarks::landmarks_in;
use super::pictures::PictureFit;
use super::problem::{EYE_CORNERS, Heads, Problem, Window};
use crate::capture::LANDMARK_COUNT;
use srflow_core::dense::{inverse, product, subtract_transposed_product};
use srflow_core::median;

/// How well a fit explains its landmarks, and what they determine.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct FitReport {
    pub detector: Detector,
    /// Standard deviation of a landmark's coordinates, pixels: as given, or as estimated.
    pub noise: f64,
    /// Detected landmarks in all views.
    pub landmarks: usize,
    /// Of them those too far from the fit.
    pub outliers: usize,
    /// Landmarks without a position, of 68 per view.
    pub missing: usize,
    /// One per camera, by number.
    pub cameras: Vec<CameraFit>,
    /// Detected, and outliers, of each of the 68 landmarks over all views.
    pub by_landmark: Vec<[usize; 2]>,
    /// Views in which more than half of the landmarks are outliers: a wrong detection, or a wrong camera.
    pub suspect_views: Vec<ViewFit>,
    /// Timesteps without any landmark, which follow from their neighbours.
    pub empty_timesteps: Vec<u32>,
    /// What the landmarks determine at one timestep.
    pub reach: Reach,
    /// How well the pictures agree, if they were aligned.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub pictures: Option<PictureFit>,
}

/// The landmarks of one camera.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct CameraFit {
    pub camera_index: u32,
    /// Pictures.
    pub views: usize,
    /// Detected landmarks.
    pub landmarks: usize,
    pub outliers: usize,
    /// Median distance between detected landmarks and the fit, pixels; NaN without landmarks.
    pub median: f64,
}

/// The landmarks of one view.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct ViewFit {
    pub timestep: u32,
    pub camera_index: u32,
    /// Detected landmarks.
    pub landmarks: usize,
    pub outliers: usize,
}

/// Standard deviations of the fit by its Hessian, and parameters that the priors determine more than the landmarks: those whose
/// variance stays above half of the prior's.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Reach {
    /// The timestep that this is about.
    pub timestep: u32,
    /// Cameras that see landmarks at this timestep.
    pub cameras: usize,
    /// Of the face's place, metres: along the axis of the first camera, and the larger one of the two across it.
    pub depth: f64,
    pub across: f64,
    /// Distance between the outer corners of the eyes, metres, which is the scale of the head; and its standard deviation.
    pub eye_corners: [f64; 2],
    /// The largest identity weight, and the root of the mean square of all, in standard deviations of the prior. Where the model can
    /// be this head, they are about 2.5 and at most 1.
    pub largest_identity: f64,
    pub typical_identity: f64,
    /// Number of fitted identity weights, and names of those that the prior determines.
    pub identities: usize,
    pub unknown_identities: Vec<String>,
    /// Number of fitted expression weights, and names of those that the prior determines.
    pub expressions: usize,
    pub unknown_expressions: Vec<String>,
    /// Names of the joints of which the prior determines the rotation about every axis.
    pub unknown_joints: Vec<String>,
}

impl Problem<'_> {
    /// What the fit explains, with the reach at the timestep of index `at`.
    pub fn report(&self, heads: &Heads, at: usize, noise: f64) -> FitReport {
        let mut report = FitReport {
            detector: self.detector,
            noise,
            landmarks: 0,
            outliers: 0,
            missing: 0,
            cameras: Vec::new(),
            by_landmark: vec![[0; 2]; LANDMARK_COUNT],
            suspect_views: Vec::new(),
            empty_timesteps: Vec::new(),
            reach: self.reach(heads, at, noise),
            pictures: None,
        };
        let mut distances: std::collections::BTreeMap<u32, (CameraFit, Vec<f64>)> = Default::default();
        for (index, (&timestep, views)) in self.timesteps.iter().zip(&self.views).enumerate() {
            if landmarks_in(views) == 0 {
                report.empty_timesteps.push(timestep);
            }
            let mut of_views: Vec<ViewFit> = views
                .iter()
                .map(|view| ViewFit { timestep, camera_index: view.camera_index, landmarks: 0, outliers: 0 })
                .collect();
            for residual in self.residuals(heads, index) {
                let distance = residual.pixels.map_or(f64::INFINITY, |pixels| pixels.length());
                let limit = self.options.outlier * noise * self.factors[residual.landmark];
                let outlier = usize::from(distance > limit);
                let view = &mut of_views[residual.view];
                view.landmarks += 1;
                view.outliers += outlier;
                let [seen, outliers] = &mut report.by_landmark[residual.landmark];
                *seen += 1;
                *outliers += outlier;
                let camera_index = view.camera_index;
                let (_, of_camera) = distances.entry(camera_index).or_insert_with(|| empty(camera_index));
                of_camera.push(distance);
            }
            for view in of_views {
                let camera_index = view.camera_index;
                let (camera, _) = distances.entry(camera_index).or_insert_with(|| empty(camera_index));
                camera.views += 1;
                camera.landmarks += view.landmarks;
                camera.outliers += view.outliers;
                report.landmarks += view.landmarks;
                report.outliers += view.outliers;
                report.missing += LANDMARK_COUNT - view.landmarks;
                if 2 * view.outliers > view.landmarks {
                    report.suspect_views.push(view);
                }
            }
        }
        let with_median = |(camera, distances): (CameraFit, Vec<f64>)| {
            let median = if distances.is_empty() { f64::NAN } else { median(distances.iter().copied()) };
            CameraFit { median, ..camera }
        };
        report.cameras = distances.into_values().map(with_median).collect();
        report
    }

    fn reach(&self, heads: &Heads, at: usize, noise: f64) -> Reach {
        let (s, d) = (self.shared(), self.own());
        let covariance = self.covariance(heads, at, noise);
        let variance = |i: usize| covariance.as_ref().map_or(f64::INFINITY, |c| c[i * (s + d) + i]);
        let by_prior = |i: usize, deviation: f64| variance(i) > 0.5 * deviation * deviation;

        let (_, mut rows) = self.derivatives(heads, at);
        // Of the head, not of where the detector puts its landmarks.
        rows.iter_mut().for_each(|row| row[self.identities..s].fill(DVec3::ZERO));
        let deviation = |slopes: Vec<f64>| {
            covariance.as_ref().map_or(f64::INFINITY, |c| {
                let carried = product(c, &slopes, s + d, 1);
                slopes.iter().zip(carried).map(|(a, b)| a * b).sum::<f64>().sqrt()
            })
        };
        let mut mean = vec![DVec3::ZERO; s + d];
        for row in &rows {
            for (sum, value) in mean.iter_mut().zip(row) {
                *sum += *value / LANDMARK_COUNT as f64;
            }
        }
        let views = &self.views[at];
        let axes = views
            .iter()
            .find(|view| view.landmarks.iter().any(Option::is_some))
            .map_or([DVec3::X, DVec3::Y, DVec3::Z], |view| {
                [0, 1, 2].map(|axis| view.camera.camera_from_world.row(axis).truncate())
            });
        let [x, y, depth] = axes.map(|axis| deviation(mean.iter().map(|slope| slope.dot(axis)).collect()));

        let [right, left] = EYE_CORNERS;
        let positions = self.points.positions(&heads.states[at]);
        let apart = positions[left] - positions[right];
        let along = apart.normalize_or_zero();
        let slopes = rows[left].iter().zip(&rows[right]).map(|(left, right)| (*left - *right).dot(along));
        let of_corners = deviation(slopes.collect());

        let weights =
            || heads.states[at].identity.iter().map(|weight| weight.abs() / self.options.priors.identity);
        let name = |shapes: &[srflow_head::Shape], number: usize| shapes[number].name.clone();
        let unknown = |joint: usize, place: usize| {
            self.joint_deviations(joint)
                .is_some_and(|deviations| (0..3).all(|axis| by_prior(place + axis, deviations[axis])))
        };
        let joints = self.joints.iter().enumerate();
        Reach {
            timestep: self.timesteps[at],
            cameras: views.iter().filter(|view| view.landmarks.iter().any(Option::is_some)).count(),
            depth,
            across: x.max(y),
            eye_corners: [apart.length(), of_corners],
            largest_identity: weights().fold(0.0, f64::max),
            typical_identity: (weights().map(|weight| weight * weight).sum::<f64>()
                / self.identities.max(1) as f64)
                .sqrt(),
            identities: self.identities,
            unknown_identities: (0..self.identities)
                .filter(|i| by_prior(*i, self.options.priors.identity))
                .map(|i| name(&self.model.identities, i))
                .collect(),
            expressions: self.expressions,
            unknown_expressions: (0..self.expressions)
                .filter(|i| by_prior(s + i, self.expression_deviation(*i)))
                .map(|i| name(&self.model.expressions, i))
                .collect(),
            unknown_joints: joints
                .filter(|(number, joint)| unknown(**joint, s + self.expressions + 3 * number))
                .map(|(_, joint)| self.model.joints[*joint].name.clone())
                .collect(),
        }
    }

    /// Covariance of identity and of one timestep's parameters. All timesteps count for the identity, neighbours not for the pose;
    /// `None` when it is not determined at all.
    fn covariance(&self, heads: &Heads, at: usize, noise: f64) -> Option<Vec<f64>> {
        let (s, d) = (self.shared(), self.own());
        let all = Window::all(heads.states.len()).with_identity();
        let (whole, _) = self.linearise(heads, &all, noise, None);
        // The priors are narrower by the certainty, and with them the covariance.
        let scale = all.certainty().powi(2);
        let of_identity = whole.solve(0.0)?.shared_covariance.into_iter().map(|c| c * scale).collect();
        let (one, _) = self.linearise(heads, &Window::one(at).with_identity(), noise, None);
        let block = one.blocks.first()?;
        // The precision whose marginal of the identity is that of all timesteps: its inverse plus what the pose takes away.
        let mut identity = inverse(of_identity, s)?;
        let solved = product(&inverse(block.hessian.clone(), d)?, &block.cross, d, s);
        let mut taken = vec![0.0; s * s];
        subtract_transposed_product(&mut taken, &block.cross, &solved, s, s);
        identity.iter_mut().zip(taken).for_each(|(sum, taken)| *sum -= taken);
        let n = s + d;
        let mut precision = vec![0.0; n * n];
        for i in 0..n {
            for j in 0..=i {
                precision[i * n + j] = match (i < s, j < s) {
                    (true, _) => identity[i * s + j],
                    (false, true) => block.cross[(i - s) * s + j],
                    (false, false) => block.hessian[(i - s) * d + j - s],
                };
            }
        }
        inverse(precision, n)
    }
}

fn empty(camera_index: u32) -> (CameraFit, Vec<f64>) {
    (CameraFit { camera_index, views: 0, landmarks: 0, outliers: 0, median: f64::NAN }, Vec::new())
}
