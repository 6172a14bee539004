//! Colours of points, light, and exposures of pictures: together they give the expected levels.

use glam::DVec3;
use srflow_core::dense::{inverse, product};

/// Harmonics of the light but for the constant one, which is part of the colours.
const HARMONICS: usize = 8;

/// Adds to the precision of the light, per observation: a head that keeps its pose does not show the light.
const LIGHT_PRECISION: f64 = 1e-3;

/// A point in a picture.
pub(super) struct Observation {
    pub timestep: usize,
    pub view: usize,
    /// Number of the picture.
    pub picture: usize,
    pub point: usize,
    pub levels: [f64; 3],
    pub harmonics: [f64; HARMONICS],
    pub weight: f64,
}

/// Colours of points, the light, and exposures of pictures, in logarithms of levels.
pub(super) struct Look {
    colors: Vec<[f64; 3]>,
    light: [[f64; HARMONICS]; 3],
    exposures: Vec<[f64; 3]>,
}

impl Look {
    pub fn new(points: usize, pictures: usize) -> Self {
        Self {
            colors: vec![[0.0; 3]; points],
            light: [[0.0; HARMONICS]; 3],
            exposures: vec![[0.0; 3]; pictures],
        }
    }

    /// What is to be seen.
    pub fn levels(&self, seen: &Observation) -> [f64; 3] {
        std::array::from_fn(|channel| {
            self.colors[seen.point][channel] + self.lit(seen, channel) + self.exposures[seen.picture][channel]
        })
    }

    fn lit(&self, seen: &Observation, channel: usize) -> f64 {
        self.light[channel].iter().zip(seen.harmonics).map(|(a, b)| a * b).sum()
    }

    pub fn distance(&self, seen: &Observation) -> f64 {
        let apart = self.levels(seen).into_iter().zip(seen.levels).map(|(a, b)| (a - b) * (a - b));
        apart.sum::<f64>().sqrt()
    }

    /// Least squares by turns: light and colours, then exposures.
    pub fn fit(&mut self, observations: &[Observation]) {
        let points = self.colors.len();
        let means = Means::of(observations, points, |seen| seen.point);
        // The light is that of how a point changes: colours take up the rest.
        let rest = means.mean(observations, |seen| seen.harmonics);
        let apart = |seen: &Observation| -> [f64; HARMONICS] {
            std::array::from_fn(|k| seen.harmonics[k] - rest[seen.point][k])
        };
        let mut matrix = vec![0.0; HARMONICS * HARMONICS];
        let mut total = 0.0;
        for seen in observations {
            let apart = apart(seen);
            total += seen.weight;
            for i in 0..HARMONICS {
                for j in 0..HARMONICS {
                    matrix[i * HARMONICS + j] += seen.weight * apart[i] * apart[j];
                }
            }
        }
        for i in 0..HARMONICS {
            matrix[i * HARMONICS + i] += LIGHT_PRECISION * total.max(1.0);
        }
        let Some(inverse) = inverse(matrix, HARMONICS) else { return };
        let in_pictures = Means::of(observations, self.exposures.len(), |seen| seen.picture);
        for _ in 0..4 {
            let exposed: Vec<[f64; 3]> = observations
                .iter()
                .map(|seen| std::array::from_fn(|c| seen.levels[c] - self.exposures[seen.picture][c]))
                .collect();
            for channel in 0..3 {
                let mut right = vec![0.0; HARMONICS];
                for (seen, levels) in observations.iter().zip(&exposed) {
                    let apart = apart(seen);
                    right
                        .iter_mut()
                        .zip(apart)
                        .for_each(|(sum, k)| *sum += seen.weight * k * levels[channel]);
                }
                let light = product(&inverse, &right, HARMONICS, 1);
                self.light[channel].copy_from_slice(&light);
            }
            self.colors = means.mean(observations, |seen| {
                std::array::from_fn(|c| seen.levels[c] - self.exposures[seen.picture][c] - self.lit(seen, c))
            });
            self.exposures = in_pictures.mean(observations, |seen| {
                std::array::from_fn(|c| seen.levels[c] - self.colors[seen.point][c] - self.lit(seen, c))
            });
        }
    }
}

/// Weighted means over groups of observations.
struct Means<G> {
    group: G,
    weights: Vec<f64>,
}

impl<G: Fn(&Observation) -> usize> Means<G> {
    fn of(observations: &[Observation], groups: usize, group: G) -> Self {
        let mut weights = vec![0.0; groups];
        observations.iter().for_each(|seen| weights[group(seen)] += seen.weight);
        Self { group, weights }
    }

    /// Zero for groups without observations.
    fn mean<const N: usize>(
        &self,
        observations: &[Observation],
        value: impl Fn(&Observation) -> [f64; N],
    ) -> Vec<[f64; N]> {
        let mut sums = vec![[0.0; N]; self.weights.len()];
        for seen in observations {
            let sum = &mut sums[(self.group)(seen)];
            sum.iter_mut().zip(value(seen)).for_each(|(sum, value)| *sum += seen.weight * value);
        }
        for (sum, weight) in sums.iter_mut().zip(&self.weights) {
            sum.iter_mut().for_each(|sum| *sum /= weight.max(f64::MIN_POSITIVE));
        }
        sums
    }
}

/// Spherical harmonics of the first and second order, but for their factors.
pub(super) fn harmonics(DVec3 { x, y, z }: DVec3) -> [f64; HARMONICS] {
    [x, y, z, x * y, y * z, x * z, x * x - y * y, z * z - 1.0 / 3.0]
}
