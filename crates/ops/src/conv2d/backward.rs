use rayon::prelude::*;
use srflow_simd::{Activation, Isa, Packed, Precision};

use super::Epilogue;
use super::forward::{convolve_packed, pack, possible};
use super::panels::{self, Reads};
use crate::convolution::Conv2dShape;
use crate::precision::cpu_precision;
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
    let packed = pack_backward(isa, cpu_precision(), weight, shape);
    backward_input_packed(isa, grad, &packed, &Epilogue::default(), shape)
}

/// The single convolution that computes the gradient of the input, if there is one.
pub(crate) fn as_convolution(shape: &Conv2dShape) -> Option<Conv2dShape> {
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

/// The weights in the layout of [`backward_input_packed`], for products of a precision where that is [`possible`].
pub(crate) fn pack_backward(isa: Isa, precision: Precision, weight: &[f32], shape: &Conv2dShape) -> Packed {
    assert_eq!(weight.len(), shape.weight_len(), "weight of {shape:?}");
    if let Some(backward) = as_convolution(shape) {
        return pack(isa, precision, &turn_around(weight, shape, [0, 0]), &backward);
    }
    let each: Vec<[usize; 2]> = remainders(shape).collect();
    let depth =
        |remainder: &[usize; 2]| shape.out_channels * taps_of(shape, *remainder).iter().product::<usize>();
    let depths: Vec<usize> = each.iter().map(depth).collect();
    let precision = possible(precision, [shape.in_channels, shape.out_channels]);
    Packed::parts(isa, precision, shape.in_channels, &depths, |number, rows| {
        rows.copy_from_slice(&turn_around(weight, shape, each[number]));
    })
}

/// [`conv2d_backward_input`], then the epilogue, whose bias is one number for each input channel, with weights from
/// [`pack_backward`] for the same instruction set and shape.
pub(crate) fn backward_input_packed(
    isa: Isa,
    grad: &[f32],
    packed: &Packed,
    epilogue: &Epilogue,
    shape: &Conv2dShape,
) -> Vec<f32> {
    assert_eq!(grad.len(), shape.output_len(), "gradient of {shape:?}");
    epilogue.check(shape.in_channels, shape.input_len());
    if shape.input_len() == 0 {
        return Vec::new();
    }
    let [height, width] = shape.input;
    if grad.is_empty() {
        let channels = (0..shape.batch * shape.in_channels).map(|plane| plane % shape.in_channels);
        let bias = |channel: usize| epilogue.bias.map_or(0.0, |bias| bias[channel]);
        let mut out: Vec<f32> =
            channels.flat_map(|channel| std::iter::repeat_n(bias(channel), height * width)).collect();
        epilogue.finish(isa, 0, &mut out);
        return out;
    }
    if let Some(backward) = as_convolution(shape) {
        return convolve_packed(isa, grad, packed, epilogue, &backward);
    }
    // A residual lies in the order of all pixels, and is added when they are together.
    let activation = if epilogue.residual.is_some() { Activation::Identity } else { epilogue.activation };
    let of_remainder = Epilogue { residual: None, activation, ..*epilogue };
    let mut out = vec![0.0; shape.input_len()];
    for (number, remainder) in remainders(shape).enumerate() {
        let (weights, taps) = (packed.part(number), taps_of(shape, remainder));
        let pixels = Pixels::of(shape, remainder);
        let sums = panels::convolve(isa, grad, weights, &of_remainder, &pixels.reads(shape, taps));
        pixels.place(&sums, shape, &mut out);
    }
    if epilogue.residual.is_some() {
        let rows = out.par_chunks_mut(width).enumerate();
        rows.for_each(|(number, row)| epilogue.finish(isa, number * width, row));
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

/// The input's pixels `stride * q + remainder - padding` of one remainder.
struct Pixels {
    remainder: [usize; 2],
    /// The `q` of the first row and column inside the input.
    first: [usize; 2],
    /// Rows and columns.
    count: [usize; 2],
}

impl Pixels {
    fn of(shape: &Conv2dShape, remainder: [usize; 2]) -> Self {
        let first = [0, 1].map(|i| shape.padding[i].saturating_sub(remainder[i]).div_ceil(shape.stride[i]));
        let count = [0, 1].map(|i| {
            let end =
                (shape.input[i] + shape.padding[i]).saturating_sub(remainder[i]).div_ceil(shape.stride[i]);
            end.saturating_sub(first[i])
        });
        Self { remainder, first, count }
    }

    /// Their gradients as a convolution of the output's: pixel `q` gathers it at `q`, `q - 1`, ... `q - (taps - 1)`.
    fn reads(&self, shape: &Conv2dShape, taps: [usize; 2]) -> Reads {
        Reads {
            batch: shape.batch,
            in_channels: shape.out_channels,
            out_channels: shape.in_channels,
            input: shape.output(),
            kernel: taps,
            stride: [1, 1],
            origin: [0, 1].map(|i| self.first[i] as isize + 1 - taps[i] as isize),
            output: self.count,
        }
    }

    /// Puts `[batch, in_channels, rows, columns]` among the pixels of the other remainders.
    fn place(&self, values: &[f32], shape: &Conv2dShape, to: &mut [f32]) {
        let [rows, columns] = self.count;
        if rows * columns == 0 {
            return;
        }
        let [height, width] = shape.input;
        let [down, across] = shape.stride;
        let place = |i: usize| self.first[i] * shape.stride[i] + self.remainder[i] - shape.padding[i];
        let (top, left) = (place(0), place(1));
        to.par_chunks_mut(height * width).zip(values.par_chunks(rows * columns)).for_each(|(to, from)| {
            for (row, from) in from.chunks_exact(columns).enumerate() {
                let to = &mut to[(top + row * down) * width + left..];
                to.iter_mut().step_by(across).zip(from).for_each(|(to, from)| *to = *from);
            }
        });
    }
}
