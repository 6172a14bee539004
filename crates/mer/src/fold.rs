//! One fold: train on all other subjects, classify the held-out subject's clips.

use std::time::Instant;

use burn::tensor::{Device, Int, Tensor, TensorData};
use srflow_core::random::Key;

use crate::classifier::{Classifier, initialized};
use crate::protocol::Protocol;
use crate::training::Training;

/// The input of a classifier for one clip.
pub(crate) struct Example {
    pub(crate) input: Vec<f32>,
    pub(crate) class: usize,
    /// Number of its subject, within a run.
    pub(crate) subject: usize,
}

#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Trained {
    /// By recorded epoch, then by clip of the subject, then by class.
    pub(crate) scores: Vec<Vec<Vec<f32>>>,
    /// By recorded epoch: mean cross-entropy over the training clips during that epoch.
    pub(crate) losses: Vec<f64>,
    pub(crate) seconds: f64,
}

/// Why a fold has no result.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Unfinished {
    /// The loss was not finite in this epoch.
    Diverged {
        epoch: usize,
    },
    Stopped,
}

/// Trains on `training` and scores `tested`, which must not be empty. Random numbers are keyed by `name`, the identity of the
/// fold, so the result does not depend on which folds run, or where. `goes_on` is called after each epoch; a fold whose last
/// epoch is done is finished whatever it says.
pub(crate) fn train_fold<C: Classifier>(
    name: &str,
    classes: usize,
    training: &[&Example],
    tested: &[&Example],
    protocol: &Protocol,
    goes_on: &dyn Fn() -> bool,
) -> Result<Trained, Unfinished> {
    let start = Instant::now();
    let key = Key::new(protocol.seed);
    let device = Device::flex().autodiff();
    let mut network = Training::new(initialized::<C>(&device, classes, key, name));
    let recorded = protocol.recorded();
    let (mut scores, mut losses) = (Vec::new(), Vec::new());
    let mut order: Vec<usize> = (0..training.len()).collect();
    for epoch in 0..protocol.epochs {
        let key = key.frame(epoch as u32);
        key.stream(&format!("{name}: order")).shuffle(&mut order);
        let mut dropout = key.stream(&format!("{name}: dropout"));
        let mut sum = 0.0;
        for batch in order.chunks(protocol.batch) {
            let examples: Vec<&Example> = batch.iter().map(|&index| training[index]).collect();
            let labels: Vec<i64> = examples.iter().map(|example| example.class as i64).collect();
            let labels = Tensor::<1, Int>::from_data(labels.as_slice(), &device);
            let inputs = stacked::<C>(&examples, &device);
            let loss = network.step(inputs, labels, protocol.learning_rate(epoch), Some(&mut dropout));
            if !loss.is_finite() {
                return Err(Unfinished::Diverged { epoch });
            }
            sum += f64::from(loss) * batch.len() as f64;
        }
        if recorded.contains(&epoch) {
            losses.push(sum / training.len() as f64);
            scores.push(score(network.network(), tested, protocol.batch));
        }
        if !goes_on() && epoch + 1 < protocol.epochs {
            return Err(Unfinished::Stopped);
        }
    }
    Ok(Trained { scores, losses, seconds: start.elapsed().as_secs_f64() })
}

fn score<C: Classifier>(network: &C, examples: &[&Example], batch: usize) -> Vec<Vec<f32>> {
    let network = network.valid();
    let device = Device::flex();
    let of_batch = |examples: &[&Example]| {
        let scores = network.scores(stacked::<C>(examples, &device), None);
        let classes = scores.dims()[1];
        let scores: Vec<f32> = scores.into_data().try_to_vec().expect("scores are f32");
        scores.chunks_exact(classes).map(<[f32]>::to_vec).collect::<Vec<_>>()
    };
    examples.chunks(batch).flat_map(of_batch).collect()
}

fn stacked<C: Classifier>(examples: &[&Example], device: &Device) -> Tensor<4> {
    let [channels, height, width] = C::INPUT;
    let values: Vec<f32> = examples.iter().flat_map(|example| &example.input).copied().collect();
    Tensor::from_data(TensorData::new(values, [examples.len(), channels, height, width]), device)
}
