//! The flows that networks start from in training.

use burn::module::Module;
use burn::tensor::module::avg_pool2d;
use burn::tensor::ops::AvgPoolOptions;
use burn::tensor::{Device, Tensor, TensorData};
use serde::{Deserialize, Serialize};
use srflow_core::random::Key;
use srflow_nets::{Network, Request, Start};
use srflow_ops::resize::Grids;
use srflow_ops::resize::tensor::resize;

use crate::batch::Batch;

/// What a network starts from in training.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Starts {
    /// As it starts without a given flow.
    Own,
    /// In each step one of these: as without a given flow, zero flow, the true flow with smooth errors, or what the network finds in up
    /// to six iterations, which makes it stable under more iterations than those it learns by.
    Varied,
}

/// Shares of [`Starts::Varied`]; the rest is what the network finds.
const OWN: f32 = 0.55;
const ZERO: f32 = 0.05;
const NEAR_TRUTH: f32 = 0.15;
/// Of what the network finds.
const MOST_ITERATIONS: u32 = 6;
/// Standard deviation of the errors near the truth, in pixels.
const ERRORS_PX: [f32; 2] = [0.02, 6.0];
/// Coarse pixels between independent errors.
const SMOOTH_OVER: [usize; 3] = [2, 6, 16];

impl Starts {
    /// The flow to start from between the frames of `batch`, in coarse pixels; `None` for that of the network.
    pub(crate) fn draw(self, network: &Network, batch: &Batch, device: &Device) -> Option<Tensor<4>> {
        let Start::Coarse(stride) = network.architecture().facts().start else { return None };
        let (Self::Varied, Some(&key)) = (self, batch.keys.first()) else { return None };
        // The same for all parts of a batch.
        let mut stream = key.frame(0).stream("start");
        let kind = stream.unit();
        let size = batch.size.map(|side| side / stride);
        if kind < OWN {
            None
        } else if kind < OWN + ZERO {
            Some(Tensor::zeros([batch.len(), 2, size[0], size[1]], device))
        } else if kind < OWN + ZERO + NEAR_TRUTH {
            Some(near_truth(batch, stride, device))
        } else {
            let iterations = 1 + stream.below(MOST_ITERATIONS) as usize;
            let request = Request { every_iteration: true, ..Request::new(iterations) };
            let found = network.valid().forward(batch.frames(&device.clone().inner()), &request);
            found.coarse.map(Tensor::from_inner)
        }
    }
}

/// The true flow with smooth errors, each sample's of another size and smoothness, and half of them without fine structure.
fn near_truth(batch: &Batch, stride: usize, device: &Device) -> Tensor<4> {
    let truth = batch.truth(device);
    let samples = batch.keys.iter().enumerate().map(|(at, key)| {
        let mut stream = key.stream("errors of the start");
        let [low, high] = ERRORS_PX.map(libm::logf);
        let deviation = libm::expf(stream.uniform(low, high)) / stride as f32;
        let smooth = SMOOTH_OVER[stream.below(SMOOTH_OVER.len() as u32) as usize];
        let truth = pooled(truth.clone().narrow(0, at, 1), stride) / stride as f64;
        let [_, _, height, width] = truth.dims();
        let coarse = stream.unit() < 0.5 && height.is_multiple_of(smooth) && width.is_multiple_of(smooth);
        let truth =
            if coarse { resize(pooled(truth, smooth), [height, width], Grids::EdgesOnEdges) } else { truth };
        truth + errors(*key, [height, width], smooth, deviation, device)
    });
    Tensor::cat(samples.collect(), 0)
}

/// Normal errors that are independent at every `smooth`-th pixel and interpolated between, `[1, 2, height, width]`.
fn errors(
    key: Key,
    [height, width]: [usize; 2],
    smooth: usize,
    deviation: f32,
    device: &Device,
) -> Tensor<4> {
    let mut stream = key.stream("smooth errors");
    let (rows, columns) = (height.div_ceil(smooth), width.div_ceil(smooth));
    let values: Vec<f32> = (0..2 * rows * columns).map(|_| deviation * stream.normal()).collect();
    let grid = Tensor::from_data(TensorData::new(values, [1, 2, rows, columns]), device);
    resize(grid, [height, width], Grids::EdgesOnEdges)
}

fn pooled(x: Tensor<4>, side: usize) -> Tensor<4> {
    avg_pool2d(x, AvgPoolOptions::new([side; 2]))
}

#[cfg(test)]
mod tests {
    use srflow_core::{FlowField, Image};
    use srflow_data::flow::Sample;
    use srflow_nets::Architecture;
    use srflow_nn::numbers;

    use super::*;
    use crate::training_set::TrainingSample;

    fn batch(step: u32) -> Batch {
        let frame = |shift: usize| {
            Image::from_fn(64, 64, |x, y| {
                [((x + shift) * 7 % 251) as u8, (y * 5 % 241) as u8, (x * y % 239) as u8]
            })
        };
        let sample = |place| TrainingSample {
            name: String::new(),
            key: Key::new(3).scene(step).frame(place),
            sample: Sample {
                frame1: frame(0),
                frame2: frame(1),
                flow: Some(FlowField::filled(64, 64, [8.0, -4.0])),
                mask: None,
                occlusion: None,
            },
        };
        Batch::new(&[sample(0), sample(1)])
    }

    #[test]
    fn starts_vary_by_step_and_not_by_call() {
        let device = Device::flex().autodiff();
        let network = Architecture::SrFlow.init(&device);
        let draw = |step| Starts::Varied.draw(&network, &batch(step), &device).map(numbers);
        let drawn: Vec<Option<Vec<f32>>> = (0..40).map(draw).collect();
        let count = |is: &dyn Fn(&Option<Vec<f32>>) -> bool| drawn.iter().filter(|start| is(start)).count();
        let own = count(&Option::is_none);
        let zero = count(&|start| start.as_ref().is_some_and(|start| start.iter().all(|x| *x == 0.0)));
        assert!((8..24).contains(&own) && (1..12).contains(&zero), "{own} own, {zero} zero");
        assert!(drawn.iter().flatten().all(|start| start.len() == 2 * 2 * 32 * 32));
        assert_eq!(drawn[..10], (0..10).map(draw).collect::<Vec<_>>());
        assert_eq!(Starts::Own.draw(&network, &batch(1), &device).map(numbers), None);
        let raft = Architecture::FlowNetS.init(&device);
        assert_eq!(Starts::Varied.draw(&raft, &batch(1), &device).map(numbers), None);
    }

    #[test]
    fn a_start_near_the_truth_has_smooth_errors_of_many_sizes() {
        let device = Device::flex();
        let errors = |step| {
            let cells = 32 * 32;
            let start = numbers(near_truth(&batch(step), 2, &device));
            let of = |sample: &[f32]| {
                let (u, v) = sample.split_at(cells);
                let squares = |x: &[f32], truth: f32| x.iter().map(|x| (x - truth).powi(2)).sum::<f32>();
                ((squares(u, 4.0) + squares(v, -2.0)) / (2 * cells) as f32).sqrt()
            };
            start.chunks(2 * cells).map(of).collect::<Vec<f32>>()
        };
        let found: Vec<f32> = (0..30).flat_map(errors).collect();
        let [least, most] = [f32::min, f32::max].map(|of| found.iter().copied().reduce(of).expect("errors"));
        assert!(least < 0.05 && least > 0.0 && most > 1.0 && most < 6.0, "from {least} to {most}");
    }
}
