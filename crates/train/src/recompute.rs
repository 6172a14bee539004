//! Gradient checkpointing: the gradients of a batch with the memory of one refinement iteration.
//!
//! Plain automatic differentiation stores the activations of all iterations. Here the forward pass runs without it and stores
//! only the hidden state and the coarse flow before each iteration. The backward pass goes from the last iteration to the
//! first: it runs each again from the stored state, now with gradients, and passes the gradient of the hidden state on to the
//! iteration before. Gradients of what all iterations read (context, features) are summed and go through the encoders once.
//! Since the networks detach the coarse flow between iterations, the gradients equal those of plain differentiation up to the
//! order of summation.

use burn::module::Module;
use burn::tensor::Tensor;
use srflow_nets::{Encoded, Estimate, Network, Request};
use srflow_nn::{HostGradients, Layout, numbers};

use crate::batch::Batch;
use crate::loss::{LossError, Prediction, losses};
use crate::pass::{BatchLosses, PassSettings};

/// Adds the gradients of the mean loss of `batch`, times `weight`, to `sum`.
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
    let tracked = parts(network.encode(frames.clone()).expect("the configuration was checked"));
    let plain: Vec<Tensor<4>> = tracked.iter().cloned().map(Tensor::inner).collect();
    let start = settings.starts.draw(network, batch, device).map(Tensor::inner);
    let (states, last) = states(network, batch, &plain, start, settings.iterations);

    let mut losses_of_batch = BatchLosses { epe: batch.end_point_error(&last), ..BatchLosses::default() };
    // Gradients of the hidden state after the iteration, then of the constant parts.
    let mut gradient: Vec<Option<Tensor<4>>> = vec![None; plain.len()];
    for (iteration, (hidden, coarse)) in states.into_iter().enumerate().rev() {
        let parts = std::iter::once(hidden).chain(plain[1..].iter().cloned());
        let leaves: Vec<Tensor<4>> = parts.map(|x| Tensor::from_inner(x).require_grad()).collect();
        let request = Request {
            encoded: Some(encoded(&leaves)),
            start: coarse.map(Tensor::from_inner),
            every_iteration: true,
            ..Request::new(1)
        };
        let estimate = network.forward(frames.clone(), &request);
        let (hidden, _) = state(&estimate);
        // More than one if the network predicts a flow before its first iteration.
        let predictions = Prediction::of(estimate);
        let of_one = losses(&settings.loss, &predictions, &inputs)?;
        let share = settings.loss.gamma.powi((settings.iterations - 1 - iteration) as i32);
        losses_of_batch.add(&BatchLosses::of(&of_one), share);
        let mut total = of_one.total * share;
        if let Some(after) = gradient[0].take() {
            total = total + (hidden * Tensor::from_inner(after)).sum();
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

/// The hidden state and the coarse flow before an iteration; no flow before the first.
type State = (Tensor<4>, Option<Tensor<4>>);

/// The states before each iteration, and the last prediction in host memory.
fn states(
    network: &Network,
    batch: &Batch,
    plain: &[Tensor<4>],
    start: Option<Tensor<4>>,
    iterations: usize,
) -> (Vec<State>, Vec<f32>) {
    let network = network.valid();
    let frames = batch.frames(&plain[0].device());
    let mut parts = plain.to_vec();
    let mut coarse = start;
    let mut states = Vec::with_capacity(iterations);
    let mut last = Vec::new();
    for iteration in 1..=iterations {
        states.push((parts[0].clone(), coarse.clone()));
        let request = Request { encoded: Some(encoded(&parts)), start: coarse, ..Request::new(1) };
        let estimate = network.forward(frames.clone(), &request);
        if iteration == iterations {
            last = numbers(estimate.last().clone());
        }
        (parts[0], coarse) = state(&estimate);
    }
    (states, last)
}

/// The state after an iteration.
fn state(estimate: &Estimate) -> State {
    let hidden = estimate.hidden.clone().expect("a network that supports recompute");
    (hidden, estimate.coarse.clone())
}

/// The hidden state, followed by the tensors that all iterations share.
fn parts(Encoded { hidden, constant }: Encoded) -> Vec<Tensor<4>> {
    std::iter::once(hidden).chain(constant).collect()
}

fn encoded(parts: &[Tensor<4>]) -> Encoded {
    Encoded { hidden: parts[0].clone(), constant: parts[1..].to_vec() }
}
