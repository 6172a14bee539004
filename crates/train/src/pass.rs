//! A forward and backward pass over a batch: its settings, losses and gradients.

use burn::tensor::Tensor;
use srflow_nn::{HostGradients, numbers};
use srflow_ops::Precision;

use crate::loss::{LossConfig, Losses};
use crate::starts::Starts;

/// Settings of a forward and backward pass over a batch.
#[derive(Debug, Clone, PartialEq)]
pub struct PassSettings {
    pub loss: LossConfig,
    /// Refinement iterations of the network.
    pub iterations: usize,
    /// What the network starts from.
    pub starts: Starts,
    /// Parts that the share of a device is split into, to save memory.
    pub accumulate: usize,
    /// Keep only the hidden states, and recompute the rest in the backward pass.
    pub recompute: bool,
    /// What is multiplied on the CPU.
    pub precision: Precision,
}

/// Result of a pass over a batch.
#[derive(Debug, Clone, PartialEq)]
pub struct Pass {
    /// Gradients of the mean loss of the batch.
    pub gradients: HostGradients,
    pub losses: BatchLosses,
}

/// The mean losses of a batch.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct BatchLosses {
    /// The minimised loss, the sum of `parts`.
    pub total: f64,
    /// The sequence loss and each active regularizer, weighted, by name.
    pub parts: Vec<(&'static str, f64)>,
    /// Mean end-point error of the last prediction, in pixels.
    pub epe: f64,
}

impl BatchLosses {
    pub fn is_finite(&self) -> bool {
        self.total.is_finite() && self.parts.iter().all(|(_, value)| value.is_finite())
    }

    /// Without an end-point error.
    pub(crate) fn of(losses: &Losses) -> Self {
        let number = |tensor: &Tensor<1>| f64::from(numbers(tensor.clone().inner())[0]);
        let parts = losses.parts.iter().map(|(name, part)| (*name, number(part)));
        Self { total: number(&losses.total), parts: parts.collect(), epe: 0.0 }
    }

    /// Adds `weight` times the losses of another batch.
    pub fn add(&mut self, other: &Self, weight: f64) {
        if self.parts.is_empty() {
            self.parts = other.parts.iter().map(|&(name, _)| (name, 0.0)).collect();
        }
        self.total += weight * other.total;
        self.epe += weight * other.epe;
        for ((_, sum), (_, value)) in self.parts.iter_mut().zip(&other.parts) {
            *sum += weight * value;
        }
    }
}
