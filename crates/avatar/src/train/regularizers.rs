//! What keeps Gaussians on their triangles and small (Qian et al. 2024, equations 4 and 5; `train.py`).

use glam::Vec3;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use srflow_splat::Gaussians;

/// Weights and thresholds, in units of the triangles. The defaults are those of GaussianAvatars.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Regularizers {
    pub position_weight: f32,
    /// Distance from the centroid of the triangle that costs nothing.
    pub position_threshold: f32,
    pub scale_weight: f32,
    /// Scale that costs nothing.
    pub scale_threshold: f32,
}

impl Default for Regularizers {
    fn default() -> Self {
        Self { position_weight: 0.01, position_threshold: 1.0, scale_weight: 1.0, scale_threshold: 0.6 }
    }
}

/// Losses of one picture, weighted.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct RegularizerValue {
    /// `weight * mean relu(|x| - threshold)` over the visible Gaussians.
    pub position: f64,
    /// `weight * mean |relu(s - threshold)|` over the visible Gaussians.
    pub scale: f64,
}

impl Regularizers {
    /// The losses of `local` Gaussians, those that are visible; adds their gradients to those of `positions` and `scales`. Lists
    /// are as long as those of the Gaussians.
    pub fn backward(
        &self,
        local: &Gaussians,
        visible: &[bool],
        positions: &mut [Vec3],
        scales: &mut [Vec3],
    ) -> RegularizerValue {
        let count = visible.iter().filter(|&&visible| visible).count().max(1) as f32;
        let (of_position, of_scale) = (self.position_weight / count, self.scale_weight / count);
        const CHUNK: usize = 4096;
        let lists = local.positions.par_chunks(CHUNK).zip(local.scales.par_chunks(CHUNK));
        let gradients = positions.par_chunks_mut(CHUNK).zip(scales.par_chunks_mut(CHUNK));
        // Sums of chunks are added in order, for any number of threads.
        let sums: Vec<[f64; 2]> = lists
            .zip(gradients)
            .zip(visible.par_chunks(CHUNK))
            .map(|(((positions, scales), (position_gradients, scale_gradients)), visible)| {
                let mut sums = [0.0; 2];
                for (i, _) in visible.iter().enumerate().filter(|(_, visible)| **visible) {
                    let distance = positions[i].length();
                    if distance > self.position_threshold {
                        sums[0] += f64::from(distance - self.position_threshold);
                        position_gradients[i] += positions[i] * (of_position / distance);
                    }
                    let excess = (scales[i] - self.scale_threshold).max(Vec3::ZERO);
                    let length = excess.length();
                    if length > 0.0 {
                        sums[1] += f64::from(length);
                        scale_gradients[i] += excess * (of_scale / length);
                    }
                }
                sums
            })
            .collect();
        let [position, scale] = sums.iter().fold([0.0; 2], |[a, b], [c, d]| [a + c, b + d]);
        RegularizerValue { position: position * f64::from(of_position), scale: scale * f64::from(of_scale) }
    }
}

#[cfg(test)]
mod tests {
    use srflow_core::random::Key;

    use super::*;

    fn gaussians() -> (Gaussians, Vec<bool>) {
        let mut stream = Key::new(2).stream("regularizers");
        let mut vector = || Vec3::new(stream.normal(), stream.normal(), stream.normal());
        let local = Gaussians {
            positions: (0..40).map(|_| vector()).collect(),
            scales: (0..40).map(|_| vector().abs() * 0.8).collect(),
            ..Gaussians::default()
        };
        (local, (0..40).map(|i| i % 3 != 0).collect())
    }

    #[test]
    fn values_are_those_of_the_definition() {
        let (local, visible) = gaussians();
        let mut zeros = [vec![Vec3::ZERO; 40], vec![Vec3::ZERO; 40]];
        let [positions, scales] = &mut zeros;
        let found = Regularizers::default().backward(&local, &visible, positions, scales);
        let (mut position, mut scale, mut count) = (0.0, 0.0, 0.0);
        for i in (0..40).filter(|&i| visible[i]) {
            count += 1.0;
            position += (local.positions[i].as_dvec3().length() - 1.0).max(0.0);
            scale += (local.scales[i].as_dvec3() - f64::from(0.6_f32)).max(glam::DVec3::ZERO).length();
        }
        assert!((found.position - 0.01 * position / count).abs() < 1e-7 && found.position > 0.0);
        assert!((found.scale - scale / count).abs() < 1e-6 && found.scale > 0.0);
    }

    #[test]
    fn gradients_are_central_differences_and_only_of_visible_gaussians() {
        let (mut local, visible) = gaussians();
        let weights = Regularizers { position_weight: 1.0, ..Regularizers::default() };
        let (mut positions, mut scales) = (vec![Vec3::ZERO; 40], vec![Vec3::ZERO; 40]);
        weights.backward(&local, &visible, &mut positions, &mut scales);
        let value = |local: &Gaussians| {
            let found = weights.backward(local, &visible, &mut [Vec3::ZERO; 40], &mut [Vec3::ZERO; 40]);
            found.position + found.scale
        };
        for i in 0..40 {
            for axis in 0..3 {
                for (of_scale, gradient) in [(false, positions[i][axis]), (true, scales[i][axis])] {
                    let mut at = |step: f32| {
                        let list = if of_scale { &mut local.scales } else { &mut local.positions };
                        let before = list[i];
                        list[i][axis] += step;
                        let value = value(&local);
                        let list = if of_scale { &mut local.scales } else { &mut local.positions };
                        list[i] = before;
                        value
                    };
                    let difference = ((at(1e-3) - at(-1e-3)) / 2e-3) as f32;
                    assert!((difference - gradient).abs() < 3e-4, "{i}, {axis}: {gradient}, {difference}");
                }
            }
            assert!(visible[i] || positions[i] == Vec3::ZERO && scales[i] == Vec3::ZERO);
        }
    }
}
