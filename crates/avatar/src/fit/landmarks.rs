//! Landmarks: where the fitted head has them, how far the detected ones are off, and what that says about the parameters.

use glam::{DMat3, DVec2, DVec3};
use rayon::prelude::*;
use srflow_core::median;

use super::LandmarkView;
use super::problem::{Heads, Problem, Projection, Terms, Window};
use super::robust::geman_mcclure;
use crate::capture::LANDMARK_COUNT;

/// The first landmark that is not of the jaw's contour.
pub(super) const CONTOUR: usize = 17;

/// For two normally distributed coordinates, the median distance in standard deviations.
const MEDIAN_DISTANCE: f64 = 1.177_41;

/// One landmark in one view.
pub(super) struct LandmarkResidual {
    pub landmark: usize,
    /// Index into the views of the timestep.
    pub view: usize,
    /// Projected minus detected, pixels; `None` behind the camera.
    pub pixels: Option<DVec2>,
}

impl Problem<'_> {
    /// How each parameter moves each landmark of a timestep: for each landmark, the shared parameters, then the timestep's own. Also
    /// where the landmarks are.
    pub fn derivatives(&self, heads: &Heads, timestep: usize) -> (Vec<DVec3>, Vec<Vec<DVec3>>) {
        let state = heads.state(timestep);
        let derivatives = self.points.derivatives(state);
        let all = self.points.columns();
        let columns = self.own_columns();
        let axes = DMat3::from_quat(state.joint(0));
        let (size, slopes) = self.size(state);
        let (root, mut positions) = (self.shared() + self.expressions, derivatives.positions);
        let rows =
            positions.iter_mut().zip(&heads.offsets).enumerate().map(|(landmark, (position, offset))| {
                let values = &derivatives.values[landmark * all..][..all];
                let mut row = vec![DVec3::ZERO; self.shared() + self.own()];
                let turned = axes * *offset;
                for ((row, value), slope) in row.iter_mut().zip(&values[..self.identities]).zip(&slopes) {
                    *row = *value + turned * *slope;
                }
                let along = [axes.x_axis, axes.y_axis, axes.z_axis].map(|axis| axis * size);
                row[self.identities + 3 * landmark..][..3].copy_from_slice(&along);
                for (row, column) in row[self.shared()..].iter_mut().zip(&columns) {
                    *row = values[*column];
                }
                // The offset turns with the root.
                let offset = turned * size;
                for (row, axis) in row[root..].iter_mut().zip([DVec3::X, DVec3::Y, DVec3::Z]) {
                    *row += axis.cross(offset);
                }
                *position += offset;
                row
            });
        let rows = rows.collect();
        (positions, rows)
    }

    /// Where the detector puts the landmarks of a timestep.
    fn positions(&self, heads: &Heads, timestep: usize) -> Vec<DVec3> {
        let state = heads.state(timestep);
        let positions = self.points.positions(state).into_iter();
        let (size, _) = self.size(state);
        let offsets = heads.offsets.iter().map(|offset| state.joint(0) * *offset * size);
        positions.zip(offsets).map(|(position, offset)| position + offset).collect()
    }

    /// All detected landmarks of a timestep against the fitted ones.
    pub fn residuals(&self, heads: &Heads, timestep: usize) -> Vec<LandmarkResidual> {
        let positions = self.positions(heads, timestep);
        let mut residuals = Vec::new();
        for (view, seen) in self.views[timestep].iter().enumerate() {
            for (landmark, pixel) in seen.landmarks.iter().enumerate() {
                if let Some([x, y]) = *pixel {
                    let projected = seen.camera.project(positions[landmark]);
                    let pixels =
                        projected.map(|(pixel, _)| pixel - DVec2::new(x, y)).filter(|r| r.is_finite());
                    residuals.push(LandmarkResidual { landmark, view, pixels });
                }
            }
        }
        residuals
    }

    /// Standard deviation of the landmarks' coordinates, in pixels, by the median of the residuals; `None` without landmarks.
    pub(super) fn noise(&self, heads: &Heads, window: &Window) -> Option<f64> {
        let mut views = window.range.clone().flat_map(|timestep| &self.views[timestep]);
        let without_contour = views.any(|view| view.landmarks[CONTOUR..].iter().any(Option::is_some));
        let residuals = |timestep: usize| {
            let norms = self
                .residuals(heads, timestep)
                .into_iter()
                .filter(|residual| !without_contour || residual.landmark >= CONTOUR)
                .map(|r| r.pixels.map_or(f64::INFINITY, |pixels| pixels.length()) / self.factors[r.landmark]);
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

    /// Learns how precise each landmark is from its residuals: some are defined by less than a corner, and a detector may place
    /// them elsewhere than the model does.
    pub fn weigh_landmarks(&mut self, heads: &Heads, noise: f64) {
        // With fewer residuals the median says little.
        const ENOUGH: usize = 8;
        const MOST: f64 = 8.0;
        let mut distances = vec![Vec::new(); LANDMARK_COUNT];
        for timestep in 0..heads.states.len() {
            for residual in self.residuals(heads, timestep) {
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

    /// The landmarks of a timestep.
    pub(super) fn data(&self, heads: &Heads, timestep: usize, window: &Window, noise: f64) -> Terms {
        // Of shared parameters that are held, nothing is asked.
        let asked = if window.identity { 0 } else { self.shared() };
        let n = self.shared() + self.own();
        let mut terms = Terms { cost: 0.0, hessian: vec![0.0; n * n], gradient: vec![0.0; n] };
        let views = &self.views[timestep];
        if landmarks_in(views) == 0 {
            return terms;
        }
        let limit = self.options.outlier * self.options.outlier;
        let (positions, rows) = self.derivatives(heads, timestep);
        let mut along = vec![0.0; 3 * n];
        let mut pulled = vec![0.0; 3 * n];
        for (landmark, (position, row)) in positions.into_iter().zip(rows).enumerate() {
            // All views of a landmark share its derivatives in the world: they are summed first.
            let (mut information, mut gradient, mut seen) = (DMat3::ZERO, DVec3::ZERO, false);
            let precision = (noise * self.factors[landmark]).powi(-2);
            for view in views {
                let Some([x, y]) = view.landmarks[landmark] else { continue };
                let projection = Projection::of(&view.camera, position);
                let residual = projection.as_ref().map(|at| (at, at.pixel - DVec2::new(x, y)));
                let residual = residual.map(|(at, apart)| (at, apart, apart.length_squared() * precision));
                let Some((at, residual, square)) = residual.filter(|(.., square)| square.is_finite()) else {
                    terms.cost += limit;
                    continue;
                };
                let (cost, weight) = geman_mcclure(square, limit);
                terms.cost += cost;
                let weight = weight * precision;
                for (row, residual) in [(at.across, residual.x), (at.down, residual.y)] {
                    information += DMat3::from_cols(row * row.x, row * row.y, row * row.z) * weight;
                    gradient += row * (weight * residual);
                }
                seen = true;
            }
            if !seen {
                continue;
            }
            for (i, moves) in row.into_iter().enumerate().skip(asked) {
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
                    for (sum, value) in
                        terms.hessian[i * n + asked..=i * n + i].iter_mut().zip(&pulled[asked..])
                    {
                        *sum += weight * value;
                    }
                }
            }
        }
        terms
    }
}

/// Number of detected landmarks.
pub(super) fn landmarks_in(views: &[&LandmarkView]) -> usize {
    views.iter().map(|view| view.landmarks.iter().flatten().count()).sum()
}
