use rayon::prelude::*;

use super::forward::{BLOCK, Padded, Plan, Tile, convolve_row, pack_weights};
use super::{Conv2dShape, Epilogue};
use crate::shared_mut::SharedMut;
use crate::simd::{Isa, Simd, dispatch};
use crate::sums::sum;

/// Kernel taps whose weight gradients are summed together in registers.
const TAPS: usize = 3;
/// Elements of the output gradient, per channel, that are passed over at a time: eight channels of it stay in the
/// second-level cache while all input channels pass by.
const BAND_PIXELS: usize = 4096;
/// Input channels of one piece of work.
const CHANNEL_CHUNK: usize = 16;

/// Gradient of the bias: `grad` (`[N, channels, H, W]`, each plane of `pixels` elements) summed over images and pixels;
/// `[channels]`. Panics when `grad` is not whole images.
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

/// Gradient of the input from `grad`, that of the output; `[N, C_in, H, W]`.
///
/// It is itself a convolution of `grad`, one for each remainder of the input's row and column modulo the stride: the
/// kernel's taps of that remainder, turned around. Panics when a slice does not fit `shape`.
pub fn conv2d_backward_input(grad: &[f32], weight: &[f32], shape: &Conv2dShape) -> Vec<f32> {
    backward_input_with(Isa::best(), grad, weight, shape)
}

/// [`conv2d_backward_input`] with a chosen instruction set, one of [`Isa::available`].
pub(super) fn backward_input_with(isa: Isa, grad: &[f32], weight: &[f32], shape: &Conv2dShape) -> Vec<f32> {
    assert_eq!(grad.len(), shape.output_len(), "gradient of {shape:?}");
    assert_eq!(weight.len(), shape.weight_len(), "weight of {shape:?}");
    let mut out = vec![0.0; shape.input_len()];
    if out.is_empty() || grad.is_empty() {
        return out;
    }
    if shape.stride == [1, 1] && shape.kernel.iter().zip(shape.padding).all(|(&k, p)| p < k) {
        let transposed = turn_around(weight, shape, 0..shape.kernel[0], 0..shape.kernel[1], [1, 1]);
        let backward = Conv2dShape {
            in_channels: shape.out_channels,
            out_channels: shape.in_channels,
            input: shape.output(),
            padding: [0, 1].map(|i| shape.kernel[i] - 1 - shape.padding[i]),
            ..*shape
        };
        return super::forward::conv2d_with(isa, grad, &transposed, &Epilogue::default(), &backward);
    }
    for remainder_y in 0..shape.stride[0] {
        for remainder_x in 0..shape.stride[1] {
            backward_remainder(isa, grad, weight, shape, [remainder_y, remainder_x], &mut out);
        }
    }
    out
}

/// The taps of `rows` and `columns` at every `step`, last first, and input and output channels exchanged:
/// `[C_in, C_out, taps down, taps across]`.
fn turn_around(
    weight: &[f32],
    shape: &Conv2dShape,
    rows: std::ops::Range<usize>,
    columns: std::ops::Range<usize>,
    step: [usize; 2],
) -> Vec<f32> {
    let mut out = Vec::with_capacity(weight.len());
    for c in 0..shape.in_channels {
        for o in 0..shape.out_channels {
            let taps = &weight[(o * shape.in_channels + c) * shape.taps()..][..shape.taps()];
            for y in rows.clone().step_by(step[0]).rev() {
                out.extend(columns.clone().step_by(step[1]).rev().map(|x| taps[y * shape.kernel[1] + x]));
            }
        }
    }
    out
}

/// The input's pixels `(stride * q + remainder - padding)`, for every `q`.
fn backward_remainder(
    isa: Isa,
    grad: &[f32],
    weight: &[f32],
    shape: &Conv2dShape,
    remainder: [usize; 2],
    out: &mut [f32],
) {
    let taps = [0, 1].map(|i| (remainder[i]..shape.kernel[i]).step_by(shape.stride[i]).len());
    if taps.contains(&0) {
        return; // no tap reaches these pixels: their gradient is zero
    }
    // Pixel q of this remainder gathers the output gradient at q, q - 1, ... q - (taps - 1).
    let first_q = [0, 1].map(|i| shape.padding[i].saturating_sub(remainder[i]).div_ceil(shape.stride[i]));
    let count = [0, 1].map(|i| {
        let end = (shape.input[i] + shape.padding[i]).saturating_sub(remainder[i]).div_ceil(shape.stride[i]);
        end.saturating_sub(first_q[i])
    });
    if count.contains(&0) {
        return;
    }
    let transposed = turn_around(
        weight,
        shape,
        remainder[0]..shape.kernel[0],
        remainder[1]..shape.kernel[1],
        shape.stride,
    );
    let gathered = gather(isa, grad, &transposed, shape, taps, first_q, count);
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

/// `[N, C_in, count]`: at each `q` from `first_q`, the taps of the turned-around kernel over the output gradient, which
/// is zero outside.
fn gather(
    isa: Isa,
    grad: &[f32],
    transposed: &[f32],
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
    let weights = pack_weights(transposed, shape.in_channels, inner);
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
                // SAFETY: `isa` is available; the padded gradient holds every tap of every pixel, and the output chunk
                // holds all its channels.
                unsafe { convolve_row(isa, &plan, &tile) }
            }
        });
    });
    out
}

/// Gradient of the weight from the input and `grad`, the gradient of the output; `[C_out, C_in, kernel]`.
///
/// Pixels are summed in bands of fixed size, in order, so the result does not depend on the number of threads (it does,
/// in its last bits, on the width of the vectors). Panics when a slice does not fit `shape`.
pub fn conv2d_backward_weight(input: &[f32], grad: &[f32], shape: &Conv2dShape) -> Vec<f32> {
    backward_weight_with(Isa::best(), input, grad, shape)
}

/// [`conv2d_backward_weight`] with a chosen instruction set, one of [`Isa::available`].
pub(super) fn backward_weight_with(isa: Isa, input: &[f32], grad: &[f32], shape: &Conv2dShape) -> Vec<f32> {
    assert_eq!(input.len(), shape.input_len(), "input of {shape:?}");
    assert_eq!(grad.len(), shape.output_len(), "gradient of {shape:?}");
    let mut out = vec![0.0; shape.weight_len()];
    if out.is_empty() || grad.is_empty() {
        return out;
    }
    let [height, width] = shape.output();
    let padded = Padded::of(input, shape);
    let taps = padded.taps(shape);
    let band_rows = (BAND_PIXELS / width).max(1);
    let chunks = shape.in_channels.div_ceil(CHANNEL_CHUNK);
    let blocks = shape.out_channels.div_ceil(BLOCK);
    let target = SharedMut::new(&mut out);
    (0..blocks * chunks).into_par_iter().for_each(|task| {
        let (block, chunk) = (task / chunks, task % chunks);
        let first = block * BLOCK;
        for n in 0..shape.batch {
            for top in (0..height).step_by(band_rows) {
                for c in chunk * CHANNEL_CHUNK..shape.in_channels.min((chunk + 1) * CHANNEL_CHUNK) {
                    let source = n * padded.image + c * padded.channel + top * padded.row * shape.stride[0];
                    let piece = WeightPiece {
                        source: padded.data()[source..].as_ptr(),
                        source_row: padded.row * shape.stride[0],
                        grad: grad[(n * shape.out_channels + first) * height * width + top * width..]
                            .as_ptr(),
                        grad_channel: height * width,
                        rows: band_rows.min(height - top),
                        columns: width,
                        out_channels: BLOCK.min(shape.out_channels - first),
                        // SAFETY: inside; this task alone writes these output and input channels.
                        out: unsafe { target.at((first * shape.in_channels + c) * taps.len()) },
                        out_stride: shape.in_channels * taps.len(),
                    };
                    // SAFETY: `isa` is available; the padded input holds every tap of the rows of this band.
                    unsafe { add_weight_gradient(isa, &piece, &taps) }
                }
            }
        }
    });
    out
}

/// The products of one input channel with a block of output channels over a band of rows.
struct WeightPiece {
    source: *const f32,
    source_row: usize,
    grad: *const f32,
    grad_channel: usize,
    rows: usize,
    columns: usize,
    out_channels: usize,
    out: *mut f32,
    out_stride: usize,
}

dispatch! {
    /// Adds the weight gradient of one [`WeightPiece`].
    ///
    /// # Safety
    /// `isa` is available; the source can be read at every tap of every row and column, and the output written.
    fn add_weight_gradient = add_weight_gradient_kernel(piece: &WeightPiece, taps: &[usize])
}

#[inline(always)]
unsafe fn add_weight_gradient_kernel<S: Simd>(piece: &WeightPiece, taps: &[usize]) {
    macro_rules! by_channels {
        ($($channels:literal)*) => {
            match piece.out_channels {
                // SAFETY: the caller's promise, passed on.
                $($channels => unsafe { sum_taps::<S, $channels>(piece, taps) },)*
                _ => unreachable!("a block has 1 to {BLOCK} channels"),
            }
        };
    }
    by_channels!(1 2 3 4 5 6 7 8)
}

#[inline(always)]
unsafe fn sum_taps<S: Simd, const CHANNELS: usize>(piece: &WeightPiece, taps: &[usize]) {
    let mut first = 0;
    // SAFETY: each call handles the taps from `first`, all of them taps of the kernel.
    unsafe {
        while taps.len() - first >= TAPS {
            sum_pixels::<S, CHANNELS, TAPS>(piece, taps, first);
            first += TAPS;
        }
        match taps.len() - first {
            1 => sum_pixels::<S, CHANNELS, 1>(piece, taps, first),
            2 => sum_pixels::<S, CHANNELS, 2>(piece, taps, first),
            _ => {}
        }
    }
}

#[inline(always)]
unsafe fn sum_pixels<S: Simd, const CHANNELS: usize, const T: usize>(
    piece: &WeightPiece,
    taps: &[usize],
    first: usize,
) {
    // SAFETY: the caller's promise: every address below lies in the padded input, the gradient or the output.
    unsafe {
        let mut sums = [[S::splat(0.0); T]; CHANNELS];
        for row in 0..piece.rows {
            let source = piece.source.add(row * piece.source_row);
            let grad = piece.grad.add(row * piece.columns);
            let mut x = 0;
            while x < piece.columns {
                let count = (piece.columns - x).min(S::LANES);
                let load = |from: *const f32| {
                    if count == S::LANES { S::load(from) } else { S::load_first(from, count) }
                };
                let mut pixels = [S::splat(0.0); T];
                for (t, pixels) in pixels.iter_mut().enumerate() {
                    *pixels = load(source.add(taps[first + t] + x));
                }
                for (channel, sums) in sums.iter_mut().enumerate() {
                    let grad = load(grad.add(channel * piece.grad_channel + x));
                    for t in 0..T {
                        sums[t] = S::mul_add(grad, pixels[t], sums[t]);
                    }
                }
                x += S::LANES;
            }
        }
        for (channel, sums) in sums.iter().enumerate() {
            for (t, &sum) in sums.iter().enumerate() {
                *piece.out.add(channel * piece.out_stride + first + t) += S::sum(sum);
            }
        }
    }
}
