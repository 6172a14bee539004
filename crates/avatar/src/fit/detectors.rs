//! Where a detector puts dlib's landmarks on a head. Each has its own idea of them, and head models have another: MediaPipe's brows and
//! jaw are more than a centimetre from where models have them.

mod mediapipe;

use std::fmt;

use glam::DVec3;
use serde::Serialize;
use srflow_core::median;
use srflow_head::HeadModel;

use super::problem::{Heads, LEAST_NOISE, Problem, Window};
use crate::capture::LANDMARK_COUNT;

/// Where the landmarks of a fit come from, by which fits best.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Detector {
    /// Those of the head model, or of a detector that agrees with it about them.
    Dlib,
    MediaPipe,
}

/// A detector's landmarks are off by about this, in distances between the outer corners of the eyes, and the same way in many pictures, so
/// that they agree better with each other than with the face. Measured for MediaPipe: on rendered heads, a photometric fit with this noise
/// halves the error of the motion, compared with the noise that the landmarks seem to have.
const NOISE: f64 = 0.016;

/// Where a landmark of a detector is, from that of a head model: mean and standard deviation over persons, along the axes of the head and
/// in distances between the outer corners of the eyes.
#[derive(Debug, Clone, Copy)]
pub(super) struct Offset {
    pub mean: DVec3,
    pub deviation: DVec3,
}

impl Detector {
    pub(super) const ALL: [Self; 2] = [Self::Dlib, Self::MediaPipe];

    /// From the landmarks of a model. `unknown` is the deviation of offsets about which nothing is known.
    pub(super) fn offsets(self, model: &HeadModel, unknown: f64) -> [Offset; LANDMARK_COUNT] {
        let table = match (self, model.name.as_str()) {
            (Self::Dlib, _) => {
                return [Offset { mean: DVec3::ZERO, deviation: DVec3::splat(unknown) }; LANDMARK_COUNT];
            }
            (Self::MediaPipe, "builtin" | "builtin-average") => mediapipe::ON_BUILTIN,
            // The other models are made from scans too, and have their landmarks where people see them.
            (Self::MediaPipe, _) => mediapipe::ON_ICT,
        };
        table.map(|[mean, deviation]| Offset {
            mean: DVec3::from_array(mean),
            deviation: DVec3::from_array(deviation),
        })
    }
}

impl fmt::Display for Detector {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        f.write_str(match self {
            Self::Dlib => "dlib",
            Self::MediaPipe => "MediaPipe",
        })
    }
}

impl Problem<'_> {
    /// Fits one timestep with each detector's offsets and keeps the detector that fits best. Returns the heads (only that timestep is
    /// fitted) and the noise; `None` when no pose fits.
    pub fn begin(&mut self, first: usize) -> Option<(Heads, f64)> {
        let window = Window::one(first).with_identity();
        let mut tried = Vec::new();
        for detector in Detector::ALL {
            self.detector = detector;
            let mut heads = self.heads();
            let Some(posed) = self.posed(first, &heads.states[first], &heads.offsets) else { continue };
            heads.states[first] = posed;
            let noise = self.anneal(&mut heads, &window);
            tried.push((detector, heads, noise));
        }
        // Compared with the same noise.
        let noise = tried.iter().fold(0.0, |most: f64, (.., noise)| most.max(*noise));
        let with_costs = tried.into_iter().map(|fitted| {
            self.detector = fitted.0;
            (self.linearise(&fitted.1, &window, noise, None).1, fitted)
        });
        let (_, (detector, heads, noise)) = with_costs.min_by(|(one, _), (other, _)| one.total_cmp(other))?;
        self.detector = detector;
        Some((heads, noise))
    }

    /// Where the offsets of landmarks are expected.
    pub fn expected_offsets(&self) -> [Offset; LANDMARK_COUNT] {
        self.detector.offsets(self.model, self.options.priors.landmark)
    }

    /// The smallest noise that a fit assumes, pixels.
    pub fn least_noise(&self, heads: &Heads, window: &Window) -> f64 {
        match self.detector {
            Detector::Dlib => LEAST_NOISE,
            Detector::MediaPipe => self.usual_noise(heads, window).max(LEAST_NOISE),
        }
    }

    /// The noise of detectors at the size of the heads, pixels.
    pub fn usual_noise(&self, heads: &Heads, window: &Window) -> f64 {
        let corners = window
            .range
            .clone()
            .flat_map(|timestep| self.corner_pixels(heads.state(timestep), &self.views[timestep]));
        NOISE * median(corners.flatten())
    }
}
