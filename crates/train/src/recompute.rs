//! The gradients of a batch with the memory of one refinement.
//!
//! Automatic differentiation keeps everything that every refinement computed. Here a first pass, without it, keeps the hidden
//! state and the coarse flow before each refinement only; the way back runs each refinement again from there, with it, last
//! one first, and carries the gradient of the hidden state on to the one before. What all refinements read (context,
//! features) collects its gradient, which then goes through the encoders once. The networks cut the gradient of the coarse
//! flow between refinements, so these are the same gradients, in another order of summation.

use burn::module::Module;
use burn::tensor::Tensor;
use srflow_nets::{Encoded, Network, Request};
use srflow_nn::{HostGradients, Layout, numbers};

use crate::batch::Batch;
use crate::loss::{LossError, Prediction, losses};
use crate::replica::{BatchLosses, PassSettings};

/// Adds the gradients of the mean loss of `batch`, times `weight`.
pub(crate) fn add_gradients(
    network: &Network,
    batch: &Batch,
    layout: &Layout,
    settings: &PassSettings,
    weight: f32,
    sum: &mut HostGradients,
) -> Result<BatchLosses, LossError> {
    let device = &network.devices()[0];
    let frames = batch.frames(device);
    let inputs = batch.loss_inputs(device);
    let tracked = parts(network.encode(frames.clone()));
    let plain = tracked.clone().map(Tensor::inner);
    let (states, last) = states(network, batch, &plain, settings.iterations);

    let mut losses_of_batch = BatchLosses { epe: batch.end_point_error(&last), ..BatchLosses::default() };
    // Of the hidden state after the refinement, and of what all refinements read.
    let mut gradient: [Option<Tensor<4>>; 4] = [None, None, None, None];
    for (iteration, (hidden, coarse)) in states.into_iter().enumerate().rev() {
        let [_, context, first, second] = plain.clone();
        let leaves = [hidden, context, first, second].map(|x| Tensor::from_inner(x).require_grad());
        let request = Request {
            encoded: Some(encoded(leaves.clone())),
            start: coarse.map(Tensor::from_inner),
            ..Request::new(1)
        };
        let estimate = network.forward(frames.clone(), &request);
        let prediction = Prediction::from(estimate.last().clone());
        let of_one = losses(&settings.loss, &[prediction], &inputs)?;
        let share = settings.loss.gamma.powi((settings.iterations - 1 - iteration) as i32);
        losses_of_batch.add(&BatchLosses::of(&of_one), share);
        let mut total = of_one.total * share;
        if let Some(after) = gradient[0].take() {
            total = total + (estimate.hidden * Tensor::from_inner(after)).sum();
        }
        let gradients = total.backward();
        sum.add(network, layout, &gradients, weight);
        for (sum, leaf) in gradient.iter_mut().zip(&leaves) {
            let more = leaf.grad(&gradients);
            *sum = match (sum.take(), more) {
                (Some(sum), Some(more)) => Some(sum + more),
                (one, other) => one.or(other),
            };
        }
    }
    let total = tracked
        .into_iter()
        .zip(gradient)
        .filter_map(|(part, gradient)| Some((part * Tensor::from_inner(gradient?)).sum()))
        .reduce(|sum, more| sum + more);
    if let Some(total) = total {
        sum.add(network, layout, &total.backward(), weight);
    }
    Ok(losses_of_batch)
}

/// The hidden state and the coarse flow before a refinement; no flow before the first.
type State = (Tensor<4>, Option<Tensor<4>>);

/// The states before each refinement, and the last prediction in host memory.
fn states(
    network: &Network,
    batch: &Batch,
    plain: &[Tensor<4>; 4],
    iterations: usize,
) -> (Vec<State>, Vec<f32>) {
    let network = network.valid();
    let [mut hidden, context, first, second] = plain.clone();
    let frames = batch.frames(&hidden.device());
    let mut coarse = None;
    let mut states = Vec::with_capacity(iterations);
    let mut last = Vec::new();
    for iteration in 1..=iterations {
        states.push((hidden.clone(), coarse.clone()));
        let before = encoded([hidden, context.clone(), first.clone(), second.clone()]);
        let request = Request { encoded: Some(before), start: coarse, ..Request::new(1) };
        let estimate = network.forward(frames.clone(), &request);
        if iteration == iterations {
            last = numbers(estimate.last().clone());
        }
        (hidden, coarse) = (estimate.hidden, Some(estimate.coarse));
    }
    (states, last)
}

/// Hidden state, context, and features of the first and the second frames.
fn parts(encoded: Encoded) -> [Tensor<4>; 4] {
    let Encoded { hidden, context, features: [first, second] } = encoded;
    [hidden, context, first, second]
}

fn encoded([hidden, context, first, second]: [Tensor<4>; 4]) -> Encoded {
    Encoded { hidden, context, features: [first, second] }
}
