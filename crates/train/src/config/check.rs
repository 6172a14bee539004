//! Validates the values of a configuration.

use burn::tensor::Device;
use srflow_nets::Start;

use super::error::ConfigError;
use super::{Config, DataConfig, MadeKind, RenderedConfig, Starts, TrainingConfig};
use crate::loss::LossError;

/// More than any network needs; larger values are typing mistakes that would exhaust memory.
const MOST_ITERATIONS: usize = 200;

impl Config {
    /// Checks every value, without accessing any files.
    ///
    /// # Errors
    /// Names the first key with an invalid value, and what was expected.
    pub fn check(&self) -> Result<(), ConfigError> {
        let training = &self.training;
        let validation = &self.validation;
        let whole = |key, value: usize, least: usize, most: usize| {
            let expected = format!("a whole number from {least} to {most}");
            require(key, value, expected, (least..=most).contains(&value))
        };
        let number =
            |key, value: f64, expected: &str, fine| require(key, value, expected, fine && value.is_finite());
        whole("data.workers", self.data.workers, 1, 256)?;
        whole("data.prefetch", self.data.prefetch, 1, 4096)?;
        whole("training.batch", training.batch, 1, 4096)?;
        whole("training.clip_frames", training.clip_frames, 2, 16)?;
        whole("training.accumulate", training.accumulate, 1, training.batch)?;
        self.data.check_made(training.pairs())?;
        if let Some(made) = validation.data.iter().find(|source| source.made().is_some()) {
            let expected = "a dataset in files, such as one that `srflow shapes` or `srflow render` writes";
            require("validation.data", made, expected, false)?;
        }
        whole("training.iterations", training.iterations, 1, MOST_ITERATIONS)?;
        whole("validation.iterations", validation.iterations, 0, MOST_ITERATIONS)?;
        whole("checkpoints.keep", self.checkpoints.keep, 1, 1000)?;
        whole("training.bad_steps", training.bad_steps.try_into().unwrap_or(usize::MAX), 1, 1_000_000)?;
        if training.steps == 0 {
            whole("training.epochs", training.epochs.try_into().unwrap_or(usize::MAX), 1, 1_000_000)?;
        }
        let rate = training.learning_rate;
        number("training.learning_rate", rate, "a number above 0 and at most 1", rate > 0.0 && rate <= 1.0)?;
        let rising = training.rising;
        number("training.rising", rising, "a share from 0 to below 1", (0.0..1.0).contains(&rising))?;
        let decay = training.weight_decay;
        number("training.weight_decay", decay, "a number from 0 to 1", (0.0..=1.0).contains(&decay))?;
        number("training.epsilon", training.epsilon, "a number above 0", training.epsilon > 0.0)?;
        for beta in training.betas {
            number("training.betas", beta, "two numbers from 0 to below 1", (0.0..1.0).contains(&beta))?;
        }
        number("training.clip", training.clip, "a number above 0", training.clip > 0.0)?;
        self.loss.check()?;
        let network = self.network.architecture.facts();
        if self.loss.sequence.needs_mixture() && !network.mixture {
            return Err(LossError::NoMixture.into());
        }
        require("network.architecture", network.name, "a network that can be trained", network.trains)?;
        if training.starts == Starts::Varied {
            let expected = format!("own: {} cannot start from a coarse flow", network.name);
            require("training.starts", "varied", expected, matches!(network.start, Start::Coarse(_)))?;
            let crop = self.data.crop;
            let expected = format!("a multiple of {} along each side, for varied starts", network.padding);
            let fine = [crop.width, crop.height].iter().all(|side| side.is_multiple_of(network.padding));
            require("data.crop", crop, expected, fine)?;
        }
        let TrainingConfig { recompute, clip_frames, .. } = *training;
        let expected = format!("false: {} cannot compute its iterations one by one", network.name);
        require("training.recompute", recompute, expected, network.recompute || !recompute)?;
        let expected = format!("2: {} does not remember earlier pairs", network.name);
        require("training.clip_frames", clip_frames, expected, network.remembers || clip_frames <= 2)?;
        let expected = "false: the memory of a clip needs the gradients of all its pairs at once";
        require("training.recompute", recompute, expected, clip_frames == 2 || !recompute)?;
        let mut network = self.network.architecture.init(&Device::flex());
        for (name, value) in &self.network.settings {
            network.set(name, *value)?;
        }
        Ok(())
    }
}

impl DataConfig {
    /// Checks the settings of the made data in `train`, except for those that only its maker knows.
    fn check_made(&self, pairs_of_clip: usize) -> Result<(), ConfigError> {
        let crop = self.crop;
        for kind in self.train.iter().filter_map(|source| Some(source.made()?.kind)) {
            let (key, size) = match kind {
                MadeKind::Shapes => ("data.shapes.size", self.shapes_size()),
                MadeKind::Rendered => ("data.rendered.size", self.rendered_size()),
            };
            let fits = size.width >= crop.width && size.height >= crop.height;
            require(key, size, format!("at least the crop, {crop} (data.crop)"), fits)?;
            match kind {
                MadeKind::Shapes => {
                    let expected = "2: the pairs of shapes: do not follow each other; rendered: makes clips";
                    require("training.clip_frames", pairs_of_clip + 1, expected, pairs_of_clip == 1)?;
                    let pairs = self.shapes.pairs;
                    require("data.shapes.pairs", pairs, "1 to 99999", (1..=99_999).contains(&pairs))?;
                }
                MadeKind::Rendered => {
                    let RenderedConfig { scenes, frames, .. } = self.rendered;
                    require("data.rendered.scenes", scenes, "1 to 10000", (1..=10_000).contains(&scenes))?;
                    let clips = match pairs_of_clip {
                        1 => "",
                        _ => ", as many pairs as a clip has or more (training.clip_frames)",
                    };
                    let fine = (pairs_of_clip..=1000).contains(&(frames as usize));
                    require("data.rendered.frames", frames, format!("{pairs_of_clip} to 1000{clips}"), fine)?;
                }
            }
        }
        Ok(())
    }
}

fn require(
    key: &'static str,
    found: impl ToString,
    expected: impl Into<String>,
    fine: bool,
) -> Result<(), ConfigError> {
    match fine {
        true => Ok(()),
        false => Err(ConfigError::Value { key, found: found.to_string(), expected: expected.into() }),
    }
}
