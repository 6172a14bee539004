//! Training one classifier.

use burn::tensor::activation::log_softmax;
use burn::tensor::{Int, Tensor};
use srflow_core::random::Stream;
use srflow_nn::{AdamW, ModuleAdamW, Rounding, with_batch_statistics};

use crate::classifier::Classifier;

/// Adam with PyTorch's defaults.
const ADAM: AdamW =
    AdamW { betas: [0.9, 0.999], epsilon: 1e-8, weight_decay: 0.0, rounding: Rounding::Grouped };

/// A classifier and its optimizer. The classifier lives on a device with automatic differentiation.
pub struct Training<C: Classifier> {
    network: C,
    adam: ModuleAdamW,
}

impl<C: Classifier> Training<C> {
    /// Starts from a network's current parameters.
    pub fn new(network: C) -> Self {
        Self { network: with_batch_statistics(network, true), adam: ModuleAdamW::new(ADAM) }
    }

    /// One step of Adam on the cross-entropy of a batch; `inputs` `[batch, C::INPUT...]`, `labels` class numbers. Without `dropout` there
    /// is no dropout. Returns the loss before the step.
    pub fn step(
        &mut self,
        inputs: Tensor<4>,
        labels: Tensor<1, Int>,
        learning_rate: f64,
        dropout: Option<&mut Stream>,
    ) -> f32 {
        let scores = self.network.scores(inputs, dropout);
        let loss = cross_entropy(scores, labels);
        let gradients = loss.backward();
        self.network = self.adam.step(self.network.clone(), &gradients, learning_rate);
        loss.into_scalar()
    }

    /// The current network.
    pub fn network(&self) -> &C {
        &self.network
    }
}

/// Cross-entropy: mean over the batch of the negative log-likelihood of the labels, `[1]`; scores `[batch, classes]`.
pub fn cross_entropy(scores: Tensor<2>, labels: Tensor<1, Int>) -> Tensor<1> {
    log_softmax(scores, 1).gather(1, labels.unsqueeze_dim(1)).mean().neg()
}
