//! Training one network.

use std::borrow::Cow;

use burn::tensor::activation::log_softmax;
use burn::tensor::{Device, Int, Tensor, TensorData};
use srflow_core::random::{Key, Stream};
use srflow_nn::{
    AdamW, ModuleAdamW, Parameters, ParametersError, Rounding, parameters, with_batch_statistics,
    with_parameters,
};

use crate::balance::Balance;
use crate::classifier::{Classifier, initialized};
use crate::learning::{Epoch, Example, Learned, Lesson, Unfinished};
use crate::protocol::Protocol;

/// Adam with PyTorch's defaults.
const ADAM: AdamW =
    AdamW { betas: [0.9, 0.999], epsilon: 1e-8, weight_decay: 0.0, rounding: Rounding::Grouped };

/// A classifier and its optimizer. The classifier lives on a device with automatic differentiation.
pub struct Training<C: Classifier> {
    network: C,
    adam: ModuleAdamW,
    class_weights: Option<Vec<f32>>,
}

impl<C: Classifier> Training<C> {
    /// Starts from a network's current parameters.
    pub fn new(network: C) -> Self {
        let network = with_batch_statistics(network, true);
        Self { network, adam: ModuleAdamW::new(ADAM), class_weights: None }
    }

    /// Lets a clip count in the loss by its class: a weight for each.
    #[must_use]
    pub fn with_class_weights(self, class_weights: Vec<f32>) -> Self {
        Self { class_weights: Some(class_weights), ..self }
    }

    /// One step of Adam on the [`cross_entropy`] of a batch; `inputs` `[batch, C::INPUT...]`, `labels` class numbers. Without `dropout` there
    /// is no dropout. Returns the loss before the step.
    pub fn step(
        &mut self,
        inputs: Tensor<4>,
        labels: Tensor<1, Int>,
        learning_rate: f64,
        dropout: Option<&mut Stream>,
    ) -> f32 {
        let scores = self.network.scores(inputs, dropout);
        let loss = cross_entropy(scores, labels, self.class_weights.as_deref());
        let gradients = loss.backward();
        self.network = self.adam.step(self.network.clone(), &gradients, learning_rate);
        loss.into_scalar()
    }

    /// The current network.
    pub fn network(&self) -> &C {
        &self.network
    }
}

/// Cross-entropy, `[1]`: mean over the batch of the negative log-likelihood of the labels; with class weights the weighted mean, as in
/// PyTorch's `CrossEntropyLoss`. Scores `[batch, classes]`.
pub fn cross_entropy(scores: Tensor<2>, labels: Tensor<1, Int>, class_weights: Option<&[f32]>) -> Tensor<1> {
    let weights = class_weights
        .map(|weights| Tensor::<1>::from_data(weights, &scores.device()).select(0, labels.clone()));
    let likelihoods = log_softmax(scores, 1).gather(1, labels.unsqueeze_dim(1));
    match weights {
        None => likelihoods.mean().neg(),
        Some(weights) => {
            let total = weights.clone().sum();
            ((likelihoods * weights.unsqueeze_dim(1)).sum() / total).neg()
        }
    }
}

/// Trains a network from random parameters by the lesson's protocol.
pub(crate) fn train_network<C: Classifier>(
    lesson: &Lesson,
    on_epoch: &mut dyn FnMut(Epoch) -> bool,
) -> Result<Box<dyn Learned>, Unfinished> {
    let Lesson { name, classes, examples, protocol } = *lesson;
    let key = Key::new(protocol.seed);
    let device = Device::flex().autodiff();
    let labels: Vec<usize> = examples.iter().map(|example| example.class).collect();
    let mut training = Training::new(initialized::<C>(&device, classes, key, name));
    if protocol.balance == Balance::Weights {
        let weights = protocol.balance.class_weights(&labels, classes);
        training = training.with_class_weights(weights.into_iter().map(|weight| weight as f32).collect());
    }
    let mut order: Vec<usize> = (0..examples.len()).collect();
    for epoch in 0..protocol.epochs {
        let key = key.frame(epoch as u32);
        let mut stream = key.stream(&format!("{name}: order"));
        protocol.balance.arrange(&mut order, &labels, classes, &mut stream);
        let mut dropout = key.stream(&format!("{name}: dropout"));
        let mut sum = 0.0;
        for batch in order.chunks(protocol.batch) {
            let drawn = |&index: &usize| -> Cow<[f32]> {
                let Example { name: clip, features, input, .. } = examples[index];
                let mut stream = key.stream(&format!("{name}: {clip}"));
                match protocol.augment.drawn(features, &mut stream) {
                    Some(changed) => C::input(&changed).into(),
                    None => input.as_slice().into(),
                }
            };
            let inputs: Vec<Cow<[f32]>> = batch.iter().map(drawn).collect();
            let inputs: Vec<&[f32]> = inputs.iter().map(|input| &input[..]).collect();
            let labels: Vec<i64> = batch.iter().map(|&index| labels[index] as i64).collect();
            let labels = Tensor::<1, Int>::from_data(labels.as_slice(), &device);
            let inputs = stacked::<C>(&inputs, &device);
            let loss = training.step(inputs, labels, protocol.learning_rate(epoch), Some(&mut dropout));
            if !loss.is_finite() {
                return Err(Unfinished::Diverged { epoch });
            }
            sum += f64::from(loss) * batch.len() as f64;
        }
        let learned = LearnedNetwork { network: training.network().valid(), batch: protocol.batch };
        let loss = sum / examples.len() as f64;
        if !on_epoch(Epoch { number: epoch, loss, learned: &learned }) && epoch + 1 < protocol.epochs {
            return Err(Unfinished::Stopped);
        }
    }
    Ok(Box::new(LearnedNetwork { network: training.network().valid(), batch: protocol.batch }))
}

/// A trained network, without automatic differentiation.
struct LearnedNetwork<C> {
    network: C,
    /// Clips that it scores at once.
    batch: usize,
}

impl<C: Classifier> Learned for LearnedNetwork<C> {
    fn scores(&self, inputs: &[&[f32]]) -> Vec<Vec<f32>> {
        let device = Device::flex();
        let of_batch = |inputs: &[&[f32]]| {
            let scores = self.network.scores(stacked::<C>(inputs, &device), None);
            let classes = scores.dims()[1];
            let scores: Vec<f32> = scores.into_data().try_to_vec().expect("scores are f32");
            scores.chunks_exact(classes).map(<[f32]>::to_vec).collect::<Vec<_>>()
        };
        inputs.chunks(self.batch).flat_map(of_batch).collect()
    }

    fn parameters(&self) -> Parameters {
        parameters(&self.network)
    }
}

/// The network for so many classes with these parameters.
pub(crate) fn restore_network<C: Classifier>(
    parameters: Parameters,
    classes: usize,
) -> Result<Box<dyn Learned>, ParametersError> {
    let network = with_parameters(C::new(&Device::flex(), classes), parameters)?;
    Ok(Box::new(LearnedNetwork { network, batch: Protocol::default().batch }))
}

fn stacked<C: Classifier>(inputs: &[&[f32]], device: &Device) -> Tensor<4> {
    let [channels, height, width] = C::INPUT;
    Tensor::from_data(TensorData::new(inputs.concat(), [inputs.len(), channels, height, width]), device)
}
