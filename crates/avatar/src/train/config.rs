//! The configuration of a training.

use serde::{Deserialize, Serialize};
use srflow_core::random::Key;
use srflow_splat::{Options, Outputs, Sorting};

use super::{DensityControl, Mcmc, PoseRates, RateSchedule, Regularizers, Strategy};

/// How an avatar is trained. The defaults are those of GaussianAvatars (`arguments/__init__.py`, with the white background that its
/// documentation trains with).
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
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
    /// Whether Gaussians smaller than a pixel are drawn with their own area; see [`srflow_splat::Gaussians::antialiased`].
    pub antialiased: bool,
    /// Whether Gaussians are sorted at each pixel; see [`Sorting::PerPixel`].
    pub sort_per_pixel: bool,
    /// Whether what is behind the head in the pictures is covered by the background, where the masks of the capture say so. Those of
    /// VHAP and srflow are over one colour already.
    pub apply_masks: bool,
    /// Whether pictures with a mask have a colour behind the head that is drawn at random for each iteration. An opaque head looks
    /// the same before all of them; before one colour, a thin one can too. (The option of this name in 3D Gaussian Splatting leaves the
    /// colour in the pictures.)
    pub random_background: bool,
    /// Whether the mesh hides what is more than 10 mm behind it in the pictures that are trained on. Gaussians in front then become
    /// opaque. Otherwise the back of the head may be seen through the face, in its colour and with another motion.
    pub opaque_mesh: bool,
    /// As the reference does it, with its defects:
    ///
    /// - cameras have no principal point and no vertical focal length of their own;
    /// - Gaussians do not move in an iteration that adds and removes some, opacities not when they are reset, and nothing does in
    ///   the last iteration;
    /// - Gaussians have their size at the timestep rendered last when it is decided whether they are small or large;
    /// - poses move by their momentum while other timesteps are drawn;
    /// - Gaussians before one camera do not move, and are too large;
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
            antialiased: false,
            sort_per_pixel: false,
            apply_masks: false,
            random_background: false,
            opaque_mesh: false,
            faithful: false,
            rates: RateSchedule::default(),
            pose_rates: PoseRates::default(),
            regularizers: Regularizers::default(),
            density: DensityControl::default(),
        }
    }
}

/// A key of the configuration is out of range.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{key} of the configuration: expected {expected}, found {found}")]
pub struct ConfigError {
    pub key: &'static str,
    expected: &'static str,
    found: String,
}

impl TrainConfig {
    /// How views are rendered: their colours before [`TrainConfig::background`].
    pub fn rendering(&self) -> Options {
        let outputs = Outputs { color: true, ..Outputs::NONE };
        let sorting = if self.sort_per_pixel { Sorting::PerPixel } else { Sorting::Global };
        Options { background: self.background, sorting, outputs, ..Options::default() }
    }

    /// Checks that every value is in the range in which it means something.
    ///
    /// # Errors
    /// Names the first key that is not.
    pub fn check(&self) -> Result<(), ConfigError> {
        let Self { rates, pose_rates, regularizers, density, .. } = self;
        let Mcmc { most_gaussians, growth, initial_opacity, noise, opacity_weight, scale_weight } =
            density.mcmc;
        const MOST: u64 = 1 << 24;
        let counts = [
            ("iterations", self.iterations, 1..=MOST),
            ("sh_degree", self.sh_degree as u64, 0..=3),
            ("density.mcmc.most_gaussians", most_gaussians as u64, 1..=MOST),
        ];
        for (key, found, range) in counts {
            if !range.contains(&found) {
                let expected =
                    if *range.end() == 3 { "a number from 0 to 3" } else { "a number from 1 to 16777216" };
                return Err(ConfigError { key, expected, found: found.to_string() });
            }
        }
        let least = f64::MIN_POSITIVE;
        let any = (0.0, f64::MAX, "a number that is not negative");
        let positive = (least, f64::MAX, "a positive number");
        let share = (0.0, 1.0, "a number from 0 to 1");
        let inside = (least, 1.0 - 1e-6, "a number between 0 and 1");
        let [red, green, blue] = self.background.map(f64::from);
        let numbers = [
            ("background", red, share),
            ("background", green, share),
            ("background", blue, share),
            ("ssim_weight", self.ssim_weight, share),
            ("rates.positions", rates.positions, positive),
            ("rates.positions_final", rates.positions_final, positive),
            ("rates.scales", rates.scales.into(), any),
            ("rates.rotations", rates.rotations.into(), any),
            ("rates.opacities", rates.opacities.into(), any),
            ("rates.sh_0", rates.sh_0.into(), any),
            ("rates.sh_rest", rates.sh_rest.into(), any),
            ("pose_rates.expressions", pose_rates.expressions, any),
            ("pose_rates.joints", pose_rates.joints, any),
            ("pose_rates.translation", pose_rates.translation, any),
            ("regularizers.position_weight", regularizers.position_weight.into(), any),
            ("regularizers.position_threshold", regularizers.position_threshold.into(), any),
            ("regularizers.scale_weight", regularizers.scale_weight.into(), any),
            ("regularizers.scale_threshold", regularizers.scale_threshold.into(), any),
            ("density.gradient_threshold", density.threshold().into(), any),
            ("density.small", density.small.into(), any),
            ("density.large", density.large.into(), any),
            ("density.least_opacity", density.least_opacity.into(), inside),
            (
                "density.reset_opacity",
                density.reset_opacity.into(),
                (least, 1.0, "a number above 0, up to 1"),
            ),
            ("density.mcmc.growth", growth.into(), any),
            ("density.mcmc.initial_opacity", initial_opacity.into(), inside),
            ("density.mcmc.noise", noise.into(), any),
            ("density.mcmc.opacity_weight", opacity_weight.into(), any),
            ("density.mcmc.scale_weight", scale_weight.into(), any),
        ];
        // Written such that NaN is out of every range.
        match numbers.into_iter().find(|(_, found, (low, high, _))| !(low..=high).contains(&found)) {
            None => Ok(()),
            Some((key, found, (_, _, expected))) => {
                Err(ConfigError { key, expected, found: found.to_string() })
            }
        }
    }

    /// The same training in another number of iterations: what happens at an iteration, or every so many, does so at the same share
    /// of the whole. The adjustment is that of gsplat's `steps_scaler`.
    pub fn over(mut self, iterations: u64) -> Self {
        let ratio = iterations as f64 / self.iterations.max(1) as f64;
        let RateSchedule { position_steps, .. } = &mut self.rates;
        let DensityControl { from, until, interval, reset_interval, .. } = &mut self.density;
        for at in [&mut self.sh_interval, position_steps, from, until, interval, reset_interval] {
            // Zero is never.
            if *at > 0 {
                *at = ((*at as f64 * ratio).round() as u64).max(1);
            }
        }
        Self { iterations, ..self }
    }

    /// Whether opacities are reset after an iteration. In the last quarter they are not, unless `faithful`: they would not recover.
    pub(super) fn resets_opacities(&self, iteration: u64) -> bool {
        let recovers = self.faithful || 4 * u128::from(iteration) <= 3 * u128::from(self.iterations);
        recovers && self.density.resets(iteration, self.background == [1.0; 3])
    }

    /// The colour behind the head in an iteration.
    pub(super) fn background_at(&self, iteration: u64) -> [f32; 3] {
        if !self.random_background {
            return self.background;
        }
        let mut stream = Key::new(self.seed).scene(iteration as u32).stream("background");
        std::array::from_fn(|_| stream.unit())
    }

    /// Opacity of all Gaussians at the start.
    pub(super) fn initial_opacity(&self) -> f32 {
        match self.density.strategy {
            Strategy::Default | Strategy::AbsGs => 0.1,
            Strategy::Mcmc => self.density.mcmc.initial_opacity,
        }
    }

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
    fn values_out_of_range_are_refused_by_name() {
        assert_eq!(TrainConfig::default().check(), Ok(()));
        let refused = |text: &str| {
            let config: TrainConfig = serde_json::from_str(text).unwrap();
            config.check().unwrap_err().to_string()
        };
        let expected = "sh_degree of the configuration: expected a number from 0 to 3, found 4";
        assert_eq!(refused(r#"{"sh_degree": 4}"#), expected);
        assert!(refused(r#"{"iterations": 0}"#).contains("iterations"));
        assert!(refused(r#"{"rates": {"positions": 0}}"#).starts_with("rates.positions of"));
        assert!(refused(r#"{"rates": {"scales": -1e-3}}"#).contains("found -0.001"));
        assert!(refused(r#"{"background": [0, 2, 0]}"#).starts_with("background"));
        assert!(refused(r#"{"density": {"mcmc": {"initial_opacity": 1}}}"#).contains("initial_opacity"));
        let mut config = TrainConfig::default();
        config.density.small = f32::NAN;
        assert!(config.check().is_err());
    }

    #[test]
    fn a_shorter_training_does_the_same_at_the_same_share_of_it() {
        let config: TrainConfig = srflow_files::read_settings("cpu".as_ref(), crate::train::PRESETS).unwrap();
        let short = config.over(500);
        assert_eq!((short.iterations, short.sh_interval, short.rates.position_steps), (500, 50, 500));
        let DensityControl { from, until, interval, reset_interval, .. } = short.density;
        assert_eq!((from, until, interval, reset_interval), (25, 250, 5, 125));
        assert_eq!(config.over(config.iterations), config);
        assert_eq!(TrainConfig { sh_interval: 0, ..config }.over(3).sh_interval, 0);
        assert_eq!(config.over(3).density.interval, 1);
    }

    #[test]
    fn opacities_have_a_quarter_of_the_training_to_recover() {
        for config in [TrainConfig::default(), TrainConfig::default().over(3000)] {
            let resets = |iteration: &u64| config.resets_opacities(*iteration);
            let last = (1..=config.iterations).rev().find(resets).expect("a reset");
            assert!(4 * last <= 3 * config.iterations, "{last} of {}", config.iterations);
        }
        let faithful = TrainConfig { faithful: true, ..TrainConfig::default() };
        assert!(faithful.resets_opacities(540_000) && !TrainConfig::default().resets_opacities(540_000));
    }

    #[test]
    fn the_degree_rises_by_steps() {
        let degrees = [1, 999, 1000, 2000, 3000, 90_000].map(|i| TrainConfig::default().sh_degree_at(i));
        assert_eq!(degrees, [0, 0, 1, 2, 3, 3]);
        assert_eq!(TrainConfig { sh_interval: 0, ..TrainConfig::default() }.sh_degree_at(1), 3);
    }
}
