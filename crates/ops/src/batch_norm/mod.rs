//! Batch normalization in training (Ioffe and Szegedy 2015), fused with the ReLU that follows: each channel minus its mean over
//! all images, divided by its standard deviation, scaled and shifted. [`mod@reference`] is the definition.

use rayon::prelude::*;

use crate::MapShape;
use crate::instance_norm::EPSILON;
use crate::sums::{sum, sum_pairs};

mod composed;
pub mod reference;
pub mod tensor;

/// Scale and shift, one number per channel, and whether ReLU follows.
#[derive(Debug, Clone, Copy)]
pub struct Affine<'a> {
    /// Scale of the normalized channel.
    pub weight: &'a [f32],
    /// Added to it.
    pub bias: &'a [f32],
    /// Apply ReLU last.
    pub relu: bool,
}

/// Statistics of each channel over the batch.
#[derive(Debug, Clone, PartialEq)]
pub struct Statistics {
    pub mean: Vec<f32>,
    /// Mean squared distance from the mean (the biased estimate).
    pub variance: Vec<f32>,
}

/// One channel: `y = (x - mean) * scale * weight + bias`.
#[derive(Clone, Copy)]
struct Channel {
    mean: f32,
    /// Inverse of the standard deviation.
    scale: f32,
    weight: f32,
    bias: f32,
    relu: bool,
}

impl Channel {
    fn of(channel: usize, statistics: &Statistics, affine: &Affine) -> Self {
        let variance = f64::from(statistics.variance[channel]);
        Self {
            mean: statistics.mean[channel],
            scale: (1.0 / (variance + EPSILON).sqrt()) as f32,
            weight: affine.weight[channel],
            bias: affine.bias[channel],
            relu: affine.relu,
        }
    }

    fn before_relu(&self, x: f32) -> f32 {
        (x - self.mean) * (self.scale * self.weight) + self.bias
    }

    /// The gradient with respect to the ReLU's input.
    fn passed(&self, grad: f32, x: f32) -> f32 {
        if self.relu && self.before_relu(x) <= 0.0 { 0.0 } else { grad }
    }
}

fn check(input: &[f32], affine: &Affine, shape: &MapShape) {
    assert!(shape.batch * shape.pixels() > 0, "batch norm of no pixels: {shape:?}");
    assert_eq!(input.len(), shape.elements(), "input of {shape:?}");
    assert_eq!(affine.weight.len(), shape.channels, "weights of {shape:?}");
    assert_eq!(affine.bias.len(), shape.channels, "biases of {shape:?}");
}

/// The planes of a channel in all images.
fn planes<'a>(
    values: &'a [f32],
    channel: usize,
    shape: &MapShape,
) -> impl Iterator<Item = &'a [f32]> + use<'a> {
    values.chunks_exact(shape.pixels()).skip(channel).step_by(shape.channels)
}

/// The normalized input and the statistics used. Panics when the length of a slice does not match the shape.
pub fn batch_norm(input: &[f32], affine: &Affine, shape: &MapShape) -> (Vec<f32>, Statistics) {
    check(input, affine, shape);
    let of_channel = |channel| mean_and_variance(planes(input, channel, shape));
    let (mean, variance) = (0..shape.channels).into_par_iter().map(of_channel).unzip();
    let statistics = Statistics { mean, variance };
    let mut out = vec![0.0; input.len()];
    let planes = out.par_chunks_mut(shape.pixels()).zip(input.par_chunks(shape.pixels()));
    planes.enumerate().for_each(|(plane, (to, from))| {
        let channel = Channel::of(plane % shape.channels, &statistics, affine);
        let floor = if channel.relu { 0.0 } else { f32::NEG_INFINITY };
        for (to, &x) in to.iter_mut().zip(from) {
            let y = channel.before_relu(x);
            // Not `max`, which turns NaN into the floor.
            *to = if y < floor { floor } else { y };
        }
    });
    (out, statistics)
}

/// Gradients of input, weight and bias from `grad`, that of the output; `statistics` are those that [`batch_norm`] gave. The
/// gradient goes through the statistics too. Panics when the slices do not fit the shape.
pub fn batch_norm_backward(
    input: &[f32],
    grad: &[f32],
    affine: &Affine,
    statistics: &Statistics,
    shape: &MapShape,
) -> [Vec<f32>; 3] {
    check(input, affine, shape);
    assert_eq!(grad.len(), input.len(), "gradient of the output");
    let sums = |index| {
        let channel = Channel::of(index, statistics, affine);
        let (mut of_grad, mut along) = (0.0, 0.0);
        for (x, grad) in planes(input, index, shape).zip(planes(grad, index, shape)) {
            of_grad += sum_pairs(grad, x, |grad, x| channel.passed(grad, x));
            along +=
                sum_pairs(grad, x, |grad, x| channel.passed(grad, x) * (x - channel.mean) * channel.scale);
        }
        (of_grad as f32, along as f32)
    };
    let (bias, weight): (Vec<f32>, Vec<f32>) = (0..shape.channels).into_par_iter().map(sums).unzip();
    let count = (shape.batch * shape.pixels()) as f32;
    let mut out = vec![0.0; input.len()];
    let planes = input.par_chunks(shape.pixels()).zip(grad.par_chunks(shape.pixels()));
    out.par_chunks_mut(shape.pixels()).zip(planes).enumerate().for_each(|(plane, (to, (from, grad)))| {
        let index = plane % shape.channels;
        let channel = Channel::of(index, statistics, affine);
        let (mean_grad, mean_along) = (bias[index] / count, weight[index] / count * channel.scale);
        let factor = channel.scale * channel.weight;
        for ((to, &x), &grad) in to.iter_mut().zip(from).zip(grad) {
            *to = factor * (channel.passed(grad, x) - mean_grad - (x - channel.mean) * mean_along);
        }
    });
    [out, weight, bias]
}

/// Over all planes. Each is summed about its own mean while it is in cache, and merged with the previous ones (Chan, Golub and
/// LeVeque 1983).
fn mean_and_variance<'a>(planes: impl Iterator<Item = &'a [f32]>) -> (f32, f32) {
    let (mut count, mut mean, mut squares) = (0.0_f64, 0.0_f64, 0.0_f64);
    for plane in planes {
        let pixels = plane.len() as f64;
        let plane_mean = sum(plane, |x| x) / pixels;
        let centre = plane_mean as f32;
        let plane_squares = sum(plane, |x| (x - centre) * (x - centre));
        let delta = plane_mean - mean;
        mean += delta * pixels / (count + pixels);
        squares += plane_squares + delta * delta * count * pixels / (count + pixels);
        count += pixels;
    }
    (mean as f32, (squares / count) as f32)
}

#[cfg(test)]
pub(crate) mod tests;
