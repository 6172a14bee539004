//! The configuration of a training.

use serde::{Deserialize, Serialize};

use super::{DensityControl, PoseRates, RateSchedule, Regularizers};

/// How an avatar is trained. The defaults are those of GaussianAvatars (`arguments/__init__.py`, with the white background that its
/// documentation trains with).
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct TrainConfig {
    pub seed: u64,
    pub iterations: u64,
    /// The colour behind the head in the pictures, 0..1.
    pub background: [f32; 3],
    /// Degree of the spherical harmonics at the end, 0 to 3.
    pub sh_degree: usize,
    /// Iterations after which the degree rises by one.
    pub sh_interval: u64,
    /// Weight of `1 - SSIM`; that of L1 is the rest.
    pub ssim_weight: f64,
    /// Whether the poses of the head are learned too.
    pub finetune_head: bool,
    /// As the reference does it, with its defects:
    ///
    /// - cameras have no principal point and no vertical focal length of their own;
    /// - Gaussians do not move in an iteration that adds and removes some, opacities not when they are reset, and nothing does in
    ///   the last iteration;
    /// - Gaussians have their size at the timestep rendered last when it is decided whether they are small or large;
    /// - poses move by their momentum while other timesteps are drawn;
    /// - the defects of [`DensityScene::faithful`](super::DensityScene::faithful).
    pub faithful: bool,
    pub rates: RateSchedule,
    pub pose_rates: PoseRates,
    pub regularizers: Regularizers,
    pub density: DensityControl,
}

impl Default for TrainConfig {
    fn default() -> Self {
        Self {
            seed: 0,
            iterations: 600_000,
            background: [1.0; 3],
            sh_degree: 3,
            sh_interval: 1000,
            ssim_weight: 0.2,
            finetune_head: true,
            faithful: false,
            rates: RateSchedule::default(),
            pose_rates: PoseRates::default(),
            regularizers: Regularizers::default(),
            density: DensityControl::default(),
        }
    }
}

impl TrainConfig {
    /// The degree of the spherical harmonics in an iteration, counted from 1.
    pub fn sh_degree_at(&self, iteration: u64) -> usize {
        let most = self.sh_degree.min(3) as u64;
        iteration.checked_div(self.sh_interval).unwrap_or(most).min(most) as usize
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_configuration_survives_text_and_unknown_keys_are_refused() {
        let config = TrainConfig { iterations: 7, faithful: true, ..TrainConfig::default() };
        let text = serde_json::to_string(&config).unwrap();
        assert_eq!(serde_json::from_str::<TrainConfig>(&text).unwrap(), config);
        let part: TrainConfig = serde_json::from_str(r#"{"density": {"strategy": "absgs"}}"#).unwrap();
        assert_eq!(part.density.threshold(), 8e-4);
        assert_eq!(part.iterations, 600_000);
        assert!(serde_json::from_str::<TrainConfig>(r#"{"rates": {"position": 1}}"#).is_err());
    }

    #[test]
    fn the_degree_rises_by_steps() {
        let degrees = [1, 999, 1000, 2000, 3000, 90_000].map(|i| TrainConfig::default().sh_degree_at(i));
        assert_eq!(degrees, [0, 0, 1, 2, 3, 3]);
        assert_eq!(TrainConfig { sh_interval: 0, ..TrainConfig::default() }.sh_degree_at(1), 3);
    }
}
