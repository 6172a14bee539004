//! Adam (Kingma and Ba 2015) with PyTorch's defaults and PyTorch's order of operations.

use std::collections::HashMap;

use burn::module::{Module, ModuleMapper, Param, ParamId};
use burn::tensor::{Gradients, Tensor, TensorData};

/// Decay of the mean of gradients.
const BETA_1: f64 = 0.9;
/// Decay of the mean of their squares.
const BETA_2: f64 = 0.999;
/// Added to the root of the latter.
const EPSILON: f32 = 1e-8;

/// The optimizer and what it remembers of each parameter.
#[derive(Debug, Default)]
pub(crate) struct Adam {
    moments: HashMap<ParamId, Moments>,
}

#[derive(Debug)]
struct Moments {
    steps: i32,
    mean: Vec<f32>,
    square: Vec<f32>,
}

impl Adam {
    /// The network after one step down the gradients. Parameters without gradient stay as they are.
    pub(crate) fn step<M: Module>(&mut self, network: M, gradients: &Gradients, learning_rate: f64) -> M {
        network.map(&mut Step { adam: self, gradients, learning_rate })
    }

    fn update(&mut self, id: ParamId, values: &mut [f32], gradient: &[f32], learning_rate: f64) {
        let moments = self.moments.entry(id).or_insert_with(|| Moments {
            steps: 0,
            mean: vec![0.0; values.len()],
            square: vec![0.0; values.len()],
        });
        moments.steps += 1;
        let step = (learning_rate / (1.0 - BETA_1.powi(moments.steps))) as f32;
        let root = (1.0 - BETA_2.powi(moments.steps)).sqrt() as f32;
        let states = moments.mean.iter_mut().zip(&mut moments.square);
        for ((value, gradient), (mean, square)) in values.iter_mut().zip(gradient).zip(states) {
            *mean += (gradient - *mean) * (1.0 - BETA_1) as f32;
            *square = *square * BETA_2 as f32 + gradient * gradient * (1.0 - BETA_2) as f32;
            *value -= step * (*mean / (square.sqrt() / root + EPSILON));
        }
    }
}

struct Step<'a> {
    adam: &'a mut Adam,
    gradients: &'a Gradients,
    learning_rate: f64,
}

impl ModuleMapper for Step<'_> {
    fn map_float<const D: usize>(&mut self, param: Param<Tensor<D>>) -> Param<Tensor<D>> {
        let (id, tensor, mapper) = param.consume();
        let Some(gradient) = tensor.grad(self.gradients) else {
            return Param::from_mapped_value(id, tensor, mapper);
        };
        let (shape, device) = (tensor.shape(), tensor.device());
        let numbers = |data: TensorData| data.try_to_vec::<f32>().expect("parameters are f32");
        let mut values = numbers(tensor.into_data());
        self.adam.update(id, &mut values, &numbers(gradient.into_data()), self.learning_rate);
        let tensor = Tensor::from_data(TensorData::new(values, shape), &device).require_grad();
        Param::from_mapped_value(id, tensor, mapper)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// torch 2.11: `Adam([x], lr=0.1)`, x = (1, -2, 3), gradients (0.5, -1e-9, 4) and then (-0.25, 0, 4).
    #[test]
    fn two_steps_are_pytorchs() {
        let mut adam = Adam::default();
        let id = ParamId::new();
        let mut values = [1.0, -2.0, 3.0];
        adam.update(id, &mut values, &[0.5, -1e-9, 4.0], 0.1);
        for (found, expected) in values.iter().zip([0.9, -1.990_909, 2.9]) {
            assert!((found - expected).abs() < 1e-6, "{values:?}");
        }
        adam.update(id, &mut values, &[-0.25, 0.0, 4.0], 0.1);
        for (found, expected) in values.iter().zip([0.873_366_4, -1.986_485, 2.8]) {
            assert!((found - expected).abs() < 1e-6, "{values:?}");
        }
    }
}
