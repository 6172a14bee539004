//! The elementwise parts of a gated recurrent unit (RAFT's `update.py`): the reset gate applied to the hidden state, and the step
//! from the hidden state towards the candidate. The convolutions with their sigmoid and tanh are [`crate::conv2d`]'s.
//! [`mod@reference`] is the definition.
//!
//! Gates have the layout of the convolution that computes both: `[batch, 2 channels, height, width]`, update gates before reset
//! gates.

use rayon::prelude::*;
use srflow_simd::copy_pieces;

use crate::MapShape;

mod composed;
#[cfg(feature = "cube")]
mod cube;
pub mod reference;
pub mod tensor;

/// Panics when a slice does not fit the hidden state's shape.
fn check(shape: &MapShape, gates: &[f32], of_hidden_shape: &[&[f32]]) {
    assert_eq!(gates.len(), 2 * shape.elements(), "gates of {shape:?}");
    for slice in of_hidden_shape {
        assert_eq!(slice.len(), shape.elements(), "hidden state of {shape:?}");
    }
}

/// Elements of an image's update gates, or its reset gates, or its hidden state; one where there are none, for slices are cut
/// by it.
fn image_of(shape: &MapShape) -> usize {
    (shape.channels * shape.pixels()).max(1)
}

/// Update gates and reset gates of each image.
fn halves<'a>(gates: &'a [f32], shape: &MapShape) -> impl Iterator<Item = (&'a [f32], &'a [f32])> + use<'a> {
    let image = image_of(shape);
    gates.chunks_exact(2 * image).map(move |both| both.split_at(image))
}

/// The update gates and the reset gates of a plane of the hidden state.
fn gates_of<'a>(gates: &'a [f32], plane: usize, shape: &MapShape) -> [&'a [f32]; 2] {
    let (n, channel) = (plane / shape.channels, plane % shape.channels);
    let first = 2 * n * shape.channels + channel;
    [first, first + shape.channels].map(|plane| &gates[plane * shape.pixels()..][..shape.pixels()])
}

/// Elements per task.
const PIECE: usize = 16 << 10;

/// `reset * hidden`. `shape` is the hidden state's. Panics when a slice
/// does not fit.
pub fn reset(gates: &[f32], hidden: &[f32], shape: &MapShape) -> Vec<f32> {
    check(shape, gates, &[hidden]);
    copy_pieces(hidden, shape.pixels(), |plane, out| {
        let [_, reset] = gates_of(gates, plane, shape);
        out.iter_mut().zip(reset).for_each(|(out, reset)| *out *= reset);
    })
}

/// Gradients of gates and hidden state from that of [`reset`]'s output. `shape` is the hidden state's. Panics when a slice
/// does not fit.
pub fn reset_backward(gates: &[f32], hidden: &[f32], grad: &[f32], shape: &MapShape) -> [Vec<f32>; 2] {
    check(shape, gates, &[hidden, grad]);
    let (mut d_gates, mut d_hidden) = (vec![0.0; gates.len()], vec![0.0; hidden.len()]);
    let image = image_of(shape);
    let outs = d_gates.chunks_mut(2 * image).zip(d_hidden.chunks_mut(image));
    let ins = hidden.chunks(image).zip(grad.chunks(image)).zip(halves(gates, shape));
    for ((d_gates, d_hidden), ((hidden, grad), (_, reset))) in outs.zip(ins) {
        let outs = d_gates[image..].par_chunks_mut(PIECE).zip(d_hidden.par_chunks_mut(PIECE));
        let ins = hidden.par_chunks(PIECE).zip(grad.par_chunks(PIECE)).zip(reset.par_chunks(PIECE));
        outs.zip(ins).for_each(|((d_reset, d_hidden), ((hidden, grad), reset))| {
            for i in 0..grad.len() {
                d_reset[i] = grad[i] * hidden[i];
                d_hidden[i] = grad[i] * reset[i];
            }
        });
    }
    [d_gates, d_hidden]
}

/// `hidden + update * (candidate - hidden)`. `shape` is the hidden state's. Panics when a slice
/// does not fit.
pub fn update(gates: &[f32], hidden: &[f32], candidate: &[f32], shape: &MapShape) -> Vec<f32> {
    check(shape, gates, &[hidden, candidate]);
    copy_pieces(hidden, shape.pixels(), |plane, out| {
        let [update, _] = gates_of(gates, plane, shape);
        let candidate = &candidate[plane * shape.pixels()..];
        for ((out, candidate), update) in out.iter_mut().zip(candidate).zip(update) {
            *out += update * (candidate - *out);
        }
    })
}

/// Gradients of gates, hidden state and candidate from that of [`update`]'s output. `shape` is the hidden state's. Panics when a slice
/// does not fit.
pub fn update_backward(
    gates: &[f32],
    hidden: &[f32],
    candidate: &[f32],
    grad: &[f32],
    shape: &MapShape,
) -> [Vec<f32>; 3] {
    check(shape, gates, &[hidden, candidate, grad]);
    let mut d_gates = vec![0.0; gates.len()];
    let (mut d_hidden, mut d_candidate) = (vec![0.0; hidden.len()], vec![0.0; hidden.len()]);
    let image = image_of(shape);
    let outs =
        d_gates.chunks_mut(2 * image).zip(d_hidden.chunks_mut(image)).zip(d_candidate.chunks_mut(image));
    let ins =
        hidden.chunks(image).zip(candidate.chunks(image)).zip(grad.chunks(image)).zip(halves(gates, shape));
    for (((d_gates, d_hidden), d_candidate), (((hidden, candidate), grad), (update, _))) in outs.zip(ins) {
        let outs = d_gates[..image]
            .par_chunks_mut(PIECE)
            .zip(d_hidden.par_chunks_mut(PIECE))
            .zip(d_candidate.par_chunks_mut(PIECE));
        let ins = hidden
            .par_chunks(PIECE)
            .zip(candidate.par_chunks(PIECE))
            .zip(grad.par_chunks(PIECE))
            .zip(update.par_chunks(PIECE));
        outs.zip(ins).for_each(
            |(((d_update, d_hidden), d_candidate), (((hidden, candidate), grad), update))| {
                for i in 0..grad.len() {
                    d_update[i] = grad[i] * (candidate[i] - hidden[i]);
                    d_hidden[i] = grad[i] * (1.0 - update[i]);
                    d_candidate[i] = grad[i] * update[i];
                }
            },
        );
    }
    [d_gates, d_hidden, d_candidate]
}

#[cfg(test)]
pub(crate) mod tests;
