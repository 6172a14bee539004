use rayon::prelude::*;
use srflow_simd::Isa;

use super::Epilogue;
use super::forward::{BLOCK, Plan, Tile, convolve_packed, convolve_row, pack, pack_weights};
use crate::convolution::Conv2dShape;
use crate::sums::sum;

/// Gradient of the bias: `grad` (`[N, channels, H, W]`, each plane of `pixels` elements) summed over images and pixels;
/// `[channels]`. Panics when `grad` is not a whole number of images.
pub fn conv2d_backward_bias(grad: &[f32], channels: usize, pixels: usize) -> Vec<f32> {
    let mut sums = vec![0.0_f64; channels];
    if grad.is_empty() {
        return vec![0.0; channels];
    }
    assert!(grad.len().is_multiple_of(channels * pixels), "images of {channels} planes of {pixels} pixels");
    sums.par_iter_mut().enumerate().for_each(|(channel, total)| {
        for plane in grad.chunks_exact(pixels).skip(channel).step_by(channels) {
            *total += sum(plane, |x| x);
        }
    });
    sums.into_iter().map(|sum| sum as f32).collect()
}

/// Gradient of the input given `grad`, that of the output; `[N, C_in, H, W]`.
///
/// It is itself a convolution of `grad`, one for each remainder of the input's row and column modulo the stride, with the
/// kernel's taps of that remainder, flipped. Panics when the length of a slice does not match `shape`.
pub fn conv2d_backward_input(grad: &[f32], weight: &[f32], shape: &Conv2dShape) -> Vec<f32> {
    backward_input_with(Isa::best(), grad, weight, shape)
}

/// [`conv2d_backward_input`] with a chosen instruction set.
pub(super) fn backward_input_with(isa: Isa, grad: &[f32], weight: &[f32], shape: &Conv2dShape) -> Vec<f32> {
    backward_input_packed(isa, grad, &pack_backward(isa, weight, shape), None, shape)
}

/// The single convolution that computes the gradient of the input, if there is one.
fn as_convolution(shape: &Conv2dShape) -> Option<Conv2dShape> {
    shape.check_dense();
    let one = shape.stride == [1, 1] && shape.kernel.iter().zip(shape.padding).all(|(&k, p)| p < k);
    one.then(|| Conv2dShape {
        in_channels: shape.out_channels,
        out_channels: shape.in_channels,
        input: shape.output(),
        padding: [0, 1].map(|i| shape.kernel[i] - 1 - shape.padding[i]),
        ..*shape
    })
}

/// The weights in the layout of [`backward_input_packed`].
pub(crate) fn pack_backward(isa: Isa, weight: &[f32], shape: &Conv2dShape) -> Vec<f32> {
    assert_eq!(weight.len(), shape.weight_len(), "weight of {shape:?}");
    match as_convolution(shape) {
        Some(backward) => pack(isa, &turn_around(weight, shape, [0, 0]), &backward),
        None => remainders(shape).flat_map(|remainder| turn_around(weight, shape, remainder)).collect(),
    }
}

/// [`conv2d_backward_input`] plus `add`, with weights from [`pack_backward`] for the same instruction set and shape.
pub(crate) fn backward_input_packed(
    isa: Isa,
    grad: &[f32],
    packed: &[f32],
    add: Option<&[f32]>,
    shape: &Conv2dShape,
) -> Vec<f32> {
    assert_eq!(grad.len(), shape.output_len(), "gradient of {shape:?}");
    if shape.input_len() == 0 || grad.is_empty() {
        return add.map_or_else(|| vec![0.0; shape.input_len()], <[f32]>::to_vec);
    }
    if let Some(backward) = as_convolution(shape) {
        let epilogue = Epilogue { residual: add, ..Epilogue::default() };
        return convolve_packed(isa, grad, packed, &epilogue, &backward);
    }
    let mut out = vec![0.0; shape.input_len()];
    let mut rest = packed;
    for remainder in remainders(shape) {
        let taps = taps_of(shape, remainder);
        let (turned, others) = rest.split_at(shape.in_channels * shape.out_channels * taps[0] * taps[1]);
        backward_remainder(isa, grad, turned, shape, remainder, &mut out);
        rest = others;
    }
    if let Some(add) = add {
        out.par_iter_mut().zip(add).for_each(|(out, add)| *out += add);
    }
    out
}

/// Remainders of the input's row and column modulo the stride.
fn remainders(shape: &Conv2dShape) -> impl Iterator<Item = [usize; 2]> {
    let [down, across] = shape.stride;
    (0..down).flat_map(move |y| (0..across).map(move |x| [y, x]))
}

/// Number of taps, down and across, that reach pixels of a remainder.
fn taps_of(shape: &Conv2dShape, remainder: [usize; 2]) -> [usize; 2] {
    [0, 1].map(|i| (remainder[i]..shape.kernel[i]).step_by(shape.stride[i]).len())
}

/// The taps of a remainder, flipped, with input and output channels exchanged: `[C_in, C_out, taps down, taps across]`.
fn turn_around(weight: &[f32], shape: &Conv2dShape, remainder: [usize; 2]) -> Vec<f32> {
    /// Channels of a block that is transposed in cache.
    const SQUARE: usize = 16;
    let [down, across] = taps_of(shape, remainder);
    let taps = down * across;
    let mut out = vec![0.0; shape.in_channels * shape.out_channels * taps];
    if taps == 0 {
        return out;
    }
    let row = shape.out_channels * taps;
    out.par_chunks_mut(SQUARE * row).enumerate().for_each(|(square, out)| {
        for first in (0..shape.out_channels).step_by(SQUARE) {
            for (c, out) in out.chunks_exact_mut(row).enumerate() {
                let c = square * SQUARE + c;
                for o in first..shape.out_channels.min(first + SQUARE) {
                    let from = &weight[(o * shape.in_channels + c) * shape.taps()..][..shape.taps()];
                    let to = &mut out[o * taps..][..taps];
                    for (y, to) in to.chunks_exact_mut(across).rev().enumerate() {
                        let from = &from[(remainder[0] + y * shape.stride[0]) * shape.kernel[1]..];
                        for (x, to) in to.iter_mut().rev().enumerate() {
                            *to = from[remainder[1] + x * shape.stride[1]];
                        }
                    }
                }
            }
        }
    });
    out
}

/// The input's pixels `(stride * q + remainder - padding)`, for all `q`.
fn backward_remainder(
    isa: Isa,
    grad: &[f32],
    turned: &[f32],
    shape: &Conv2dShape,
    remainder: [usize; 2],
    out: &mut [f32],
) {
    let taps = taps_of(shape, remainder);
    if taps.contains(&0) {
        return; // no tap reaches these pixels: their gradient is zero
    }
    // Pixel q of this remainder sums the output gradient at q, q - 1, ... q - (taps - 1).
    let first_q = [0, 1].map(|i| shape.padding[i].saturating_sub(remainder[i]).div_ceil(shape.stride[i]));
    let count = [0, 1].map(|i| {
        let end = (shape.input[i] + shape.padding[i]).saturating_sub(remainder[i]).div_ceil(shape.stride[i]);
        end.saturating_sub(first_q[i])
    });
    if count.contains(&0) {
        return;
    }
    let gathered = gather(isa, grad, turned, shape, taps, first_q, count);
    let [height, width] = shape.input;
    let [stride_y, stride_x] = shape.stride;
    out.par_chunks_mut(height * width).zip(gathered.par_chunks(count[0] * count[1])).for_each(
        |(to, from)| {
            for (row, values) in from.chunks_exact(count[1]).enumerate() {
                let y = (first_q[0] + row) * stride_y + remainder[0] - shape.padding[0];
                let x = first_q[1] * stride_x + remainder[1] - shape.padding[1];
                for (i, &value) in values.iter().enumerate() {
                    to[y * width + x + i * stride_x] = value;
                }
            }
        },
    );
}

/// `[N, C_in, count]`: at each `q` from `first_q`, the taps of the flipped kernel applied to the zero-padded output gradient.
fn gather(
    isa: Isa,
    grad: &[f32],
    turned: &[f32],
    shape: &Conv2dShape,
    taps: [usize; 2],
    first_q: [usize; 2],
    count: [usize; 2],
) -> Vec<f32> {
    let [grad_height, grad_width] = shape.output();
    // Row j of the padded gradient is row first_q + j - (taps - 1) of the gradient.
    let padded = [count[0] + taps[0] - 1, count[1] + taps[1] - 1];
    let row = shape.out_channels * padded[1];
    let mut source = vec![0.0; shape.batch * padded[0] * row];
    source.par_chunks_mut(row).enumerate().for_each(|(index, to)| {
        let (n, j) = (index / padded[0], index % padded[0]);
        let Some(y) = (first_q[0] + j).checked_sub(taps[0] - 1).filter(|&y| y < grad_height) else { return };
        for (o, to) in to.chunks_exact_mut(padded[1]).enumerate() {
            let from = &grad[((n * shape.out_channels + o) * grad_height + y) * grad_width..][..grad_width];
            for (i, to) in to.iter_mut().enumerate() {
                if let Some(x) = (first_q[1] + i).checked_sub(taps[1] - 1).filter(|&x| x < grad_width) {
                    *to = from[x];
                }
            }
        }
    });
    let plan = Plan {
        channels: shape.out_channels,
        source_channel: padded[1],
        source_row: row,
        taps: (0..taps[0] * taps[1]).map(|tap| tap / taps[1] * row + tap % taps[1]).collect(),
        rows: count[0],
        columns: count[1],
        out_channel: count[0] * count[1],
    };
    let inner = plan.channels * plan.taps.len();
    let weights = pack_weights(turned, shape.in_channels, inner);
    let mut out = vec![0.0; shape.batch * shape.in_channels * plan.out_channel];
    out.par_chunks_mut(shape.in_channels * plan.out_channel).enumerate().for_each(|(n, image)| {
        image.par_chunks_mut(BLOCK * plan.out_channel).enumerate().for_each(|(block, channels)| {
            let first = n * padded[0] * row;
            for row in 0..plan.rows {
                let tile = Tile {
                    source: source[first + row * plan.source_row..].as_ptr(),
                    weights: weights[block * BLOCK * inner..].as_ptr(),
                    start: [0.0; BLOCK],
                    out_channels: channels.len() / plan.out_channel,
                    columns: plan.columns,
                    out: channels[row * plan.columns..].as_mut_ptr(),
                };
                // SAFETY: the padded gradient holds every tap of every pixel, and the output chunk
                // holds all its channels.
                unsafe { convolve_row(isa, &plan, &tile) }
            }
        });
    });
    out
}
