//! AdamW and the clipping of gradients, as PyTorch computes them.
//!
//! Both work on plain numbers in host memory, one tensor of the network behind the other. Results are the same bits for
//! any number of threads.

use rayon::prelude::*;

use crate::parameters::Layout;

/// Numbers that one task works on. Sums are taken block by block, in order.
const BLOCK: usize = 1 << 14;

/// Settings of AdamW (Loshchilov and Hutter, ICLR 2019), named as in `torch.optim.AdamW`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct AdamW {
    /// Decay rates of the averages of the gradient and of its square.
    pub betas: [f64; 2],
    /// Added to the root of the second average.
    pub epsilon: f64,
    /// Share of a parameter that is taken off it in each step, times the learning rate.
    pub weight_decay: f64,
}

/// What AdamW remembers between steps, in the order of the [`Layout`].
#[derive(Debug, Clone, PartialEq, Default)]
pub struct AdamWState {
    /// Steps that were taken.
    pub steps: u64,
    /// Averages of the gradients.
    pub mean: Vec<f32>,
    /// Averages of the squared gradients.
    pub square: Vec<f32>,
}

impl AdamWState {
    /// Before the first step, for `count` numbers.
    pub fn new(count: usize) -> Self {
        Self { steps: 0, mean: vec![0.0; count], square: vec![0.0; count] }
    }
}

impl AdamW {
    /// Moves `values` against `gradients`. Tensors that are not trained, and those that no gradient reached
    /// (`reached[i]` false), stay as they are, as in PyTorch.
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
        let [beta1, beta2] = self.betas;
        let steps = state.steps as f64;
        let update = Update {
            kept: (1.0 - learning_rate * self.weight_decay) as f32,
            to_mean: (1.0 - beta1) as f32,
            beta2: beta2 as f32,
            to_square: (1.0 - beta2) as f32,
            square_scale: (1.0 - beta2.powf(steps)).sqrt() as f32,
            epsilon: self.epsilon as f32,
            size: (learning_rate / (1.0 - beta1.powf(steps))) as f32,
        };
        for (segment, reached) in layout.segments().iter().zip(reached) {
            if !segment.trained || !reached {
                continue;
            }
            let range = segment.range.clone();
            values[range.clone()]
                .par_chunks_mut(BLOCK)
                .zip(gradients[range.clone()].par_chunks(BLOCK))
                .zip(state.mean[range.clone()].par_chunks_mut(BLOCK))
                .zip(state.square[range].par_chunks_mut(BLOCK))
                .for_each(|(((values, gradients), mean), square)| {
                    update.apply(values, gradients, mean, square);
                });
        }
    }
}

/// The numbers of one step.
#[derive(Clone, Copy)]
struct Update {
    kept: f32,
    to_mean: f32,
    beta2: f32,
    to_square: f32,
    square_scale: f32,
    epsilon: f32,
    size: f32,
}

impl Update {
    /// In the order of operations of `_single_tensor_adamw`.
    fn apply(self, values: &mut [f32], gradients: &[f32], mean: &mut [f32], square: &mut [f32]) {
        let averages = mean.iter_mut().zip(square);
        for ((value, &gradient), (mean, square)) in values.iter_mut().zip(gradients).zip(averages) {
            *value *= self.kept;
            *mean += self.to_mean * (gradient - *mean);
            *square = *square * self.beta2 + self.to_square * gradient * gradient;
            *value -= self.size * *mean / (square.sqrt() / self.square_scale + self.epsilon);
        }
    }
}

/// Euclidean norm of all gradients together.
pub fn norm(gradients: &[f32]) -> f64 {
    let squares: Vec<f64> = gradients
        .par_chunks(BLOCK)
        .map(|block| block.iter().map(|&gradient| f64::from(gradient) * f64::from(gradient)).sum())
        .collect();
    squares.iter().sum::<f64>().sqrt()
}

/// Scales the gradients so that their [`norm`] is at most `limit`, as `torch.nn.utils.clip_grad_norm_` does; gives the
/// norm before.
pub fn clip_norm(gradients: &mut [f32], limit: f64) -> f64 {
    let norm = norm(gradients);
    let scale = limit / (norm + 1e-6);
    if scale < 1.0 {
        let scale = scale as f32;
        gradients.par_chunks_mut(BLOCK).for_each(|block| block.iter_mut().for_each(|x| *x *= scale));
    }
    norm
}
