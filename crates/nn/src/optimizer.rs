//! AdamW and gradient clipping, as PyTorch computes them.
//!
//! Both work in host memory. Results are bit-identical for any number of threads.

use std::collections::HashMap;

use burn::module::{Module, ModuleMapper, Param, ParamId};
use burn::tensor::{Gradients, Tensor, TensorData};
use rayon::prelude::*;

use crate::host::{Layout, numbers};

/// Values per task. Norms are summed block by block, in order.
const BLOCK: usize = 1 << 14;

/// Settings of AdamW (Loshchilov and Hutter, ICLR 2019), named as in `torch.optim.AdamW`. Without weight decay it is Adam
/// (Kingma and Ba, ICLR 2015).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct AdamW {
    /// Decay rates of the averages of the gradient and of its square.
    pub betas: [f64; 2],
    /// Added to the square root of the second average.
    pub epsilon: f64,
    /// Each step shrinks a parameter by this share times the learning rate.
    pub weight_decay: f64,
    pub rounding: Rounding,
}

/// Order of multiplication in two products of three factors, which affects the last bit of the results.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Rounding {
    /// `((1 - beta2) g) g` and `(step mean) / root`: `_single_tensor_adamw` of PyTorch.
    Pytorch,
    /// `(1 - beta2) (g g)` and `step (mean / root)`: reproduces the classifier results of docs/explanation/results.md.
    Grouped,
}

/// The state of AdamW between steps, for the values of a [`Layout`] or of one tensor.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct AdamWState {
    pub steps: u64,
    /// Averages of the gradients.
    pub mean: Vec<f32>,
    /// Averages of the squared gradients.
    pub square: Vec<f32>,
}

impl AdamWState {
    /// The state before the first step, for `count` values.
    pub fn new(count: usize) -> Self {
        Self { steps: 0, mean: vec![0.0; count], square: vec![0.0; count] }
    }
}

impl AdamW {
    /// Updates `values`, which like `gradients` and `state` are in the order of `layout`. Tensors that are not trained, and those
    /// without a gradient (`reached[i]` false for tensor `i`), stay unchanged, as in PyTorch.
    pub fn step(
        &self,
        layout: &Layout,
        values: &mut [f32],
        gradients: &[f32],
        reached: &[bool],
        learning_rate: f64,
        state: &mut AdamWState,
    ) {
        state.steps += 1;
        let update = self.update(state.steps, learning_rate);
        for (segment, reached) in layout.segments().iter().zip(reached) {
            if !segment.trained || !reached {
                continue;
            }
            let range = segment.range.clone();
            update.apply_blocks(
                &mut values[range.clone()],
                &gradients[range.clone()],
                &mut state.mean[range.clone()],
                &mut state.square[range],
            );
        }
    }

    fn update(&self, steps: u64, learning_rate: f64) -> Update {
        let [beta1, beta2] = self.betas;
        let steps = steps as f64;
        Update {
            kept: (1.0 - learning_rate * self.weight_decay) as f32,
            to_mean: (1.0 - beta1) as f32,
            beta2: beta2 as f32,
            to_square: (1.0 - beta2) as f32,
            square_scale: (1.0 - beta2.powf(steps)).sqrt() as f32,
            epsilon: self.epsilon as f32,
            size: (learning_rate / (1.0 - beta1.powf(steps))) as f32,
            rounding: self.rounding,
        }
    }
}

/// Coefficients of one step.
#[derive(Clone, Copy)]
struct Update {
    kept: f32,
    to_mean: f32,
    beta2: f32,
    to_square: f32,
    square_scale: f32,
    epsilon: f32,
    size: f32,
    rounding: Rounding,
}

impl Update {
    fn apply_blocks(self, values: &mut [f32], gradients: &[f32], mean: &mut [f32], square: &mut [f32]) {
        values
            .par_chunks_mut(BLOCK)
            .zip(gradients.par_chunks(BLOCK))
            .zip(mean.par_chunks_mut(BLOCK))
            .zip(square.par_chunks_mut(BLOCK))
            .for_each(|(((values, gradients), mean), square)| self.apply(values, gradients, mean, square));
    }

    fn apply(self, values: &mut [f32], gradients: &[f32], mean: &mut [f32], square: &mut [f32]) {
        let averages = mean.iter_mut().zip(square);
        for ((value, &gradient), (mean, square)) in values.iter_mut().zip(gradients).zip(averages) {
            *value *= self.kept;
            *mean += self.to_mean * (gradient - *mean);
            let root = |square: f32| square.sqrt() / self.square_scale + self.epsilon;
            match self.rounding {
                Rounding::Pytorch => {
                    *square = *square * self.beta2 + self.to_square * gradient * gradient;
                    *value -= self.size * *mean / root(*square);
                }
                Rounding::Grouped => {
                    *square = *square * self.beta2 + self.to_square * (gradient * gradient);
                    *value -= self.size * (*mean / root(*square));
                }
            }
        }
    }
}

/// AdamW on the tensors of a network in place, without the copies of a [`Layout`].
#[derive(Debug)]
pub struct ModuleAdamW {
    settings: AdamW,
    states: HashMap<ParamId, AdamWState>,
}

impl ModuleAdamW {
    pub fn new(settings: AdamW) -> Self {
        Self { settings, states: HashMap::new() }
    }

    /// The network after one step. Parameters without a gradient stay unchanged.
    pub fn step<M: Module>(&mut self, network: M, gradients: &Gradients, learning_rate: f64) -> M {
        network.map(&mut ModuleStep { optimizer: self, gradients, learning_rate })
    }
}

struct ModuleStep<'a> {
    optimizer: &'a mut ModuleAdamW,
    gradients: &'a Gradients,
    learning_rate: f64,
}

impl ModuleMapper for ModuleStep<'_> {
    fn map_float<const D: usize>(&mut self, param: Param<Tensor<D>>) -> Param<Tensor<D>> {
        let (id, tensor, mapper) = param.consume();
        let Some(gradient) = tensor.grad(self.gradients) else {
            return Param::from_mapped_value(id, tensor, mapper);
        };
        let (shape, device) = (tensor.shape(), tensor.device());
        let (mut values, gradient) = (numbers(tensor), numbers(gradient));
        let ModuleAdamW { settings, states } = &mut *self.optimizer;
        let state = states.entry(id).or_insert_with(|| AdamWState::new(values.len()));
        state.steps += 1;
        let update = settings.update(state.steps, self.learning_rate);
        update.apply_blocks(&mut values, &gradient, &mut state.mean, &mut state.square);
        let tensor = Tensor::from_data(TensorData::new(values, shape), &device).require_grad();
        Param::from_mapped_value(id, tensor, mapper)
    }
}

/// Euclidean norm of all gradients.
pub fn norm(gradients: &[f32]) -> f64 {
    let squares: Vec<f64> = gradients
        .par_chunks(BLOCK)
        .map(|block| block.iter().map(|&gradient| f64::from(gradient) * f64::from(gradient)).sum())
        .collect();
    squares.iter().sum::<f64>().sqrt()
}

/// Scales the gradients so that their [`norm`] is at most `limit`, as `torch.nn.utils.clip_grad_norm_` does. Returns the norm
/// before clipping.
pub fn clip_norm(gradients: &mut [f32], limit: f64) -> f64 {
    let norm = norm(gradients);
    let scale = limit / (norm + 1e-6);
    if scale < 1.0 {
        let scale = scale as f32;
        gradients.par_chunks_mut(BLOCK).for_each(|block| block.iter_mut().for_each(|x| *x *= scale));
    }
    norm
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Expected values: torch 2.11, `Adam([x], lr=0.1)`, x = (1, -2, 3), gradients (0.5, -1e-9, 4), then (-0.25, 0, 4).
    #[test]
    fn without_weight_decay_it_is_adam() {
        for rounding in [Rounding::Pytorch, Rounding::Grouped] {
            let adam = AdamW { betas: [0.9, 0.999], epsilon: 1e-8, weight_decay: 0.0, rounding };
            let mut state = AdamWState::new(3);
            let mut values = [1.0, -2.0, 3.0];
            let steps = [
                ([0.5, -1e-9, 4.0], [0.9, -1.990_909, 2.9]),
                ([-0.25, 0.0, 4.0], [0.873_366_4, -1.986_485, 2.8]),
            ];
            for (number, (gradient, expected)) in (1..).zip(steps) {
                let update = adam.update(number, 0.1);
                update.apply(&mut values, &gradient, &mut state.mean, &mut state.square);
                for (found, expected) in values.iter().zip(expected) {
                    assert!((found - expected).abs() < 1e-6, "{rounding:?}: {values:?}");
                }
            }
        }
    }
}
