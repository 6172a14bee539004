use rayon::prelude::*;
use srflow_simd::{Isa, Packed, Precision, SharedMut, Simd, dispatch, zeros};

use super::Epilogue;
use super::panels::{self, Reads};
use super::winograd::{self, Scheme};
use crate::convolution::Conv2dShape;
use crate::pointwise::{Add, Layer, Map, pointwise};
use crate::precision::cpu_precision;

/// Convolutions of fewer channels than these, in or out, multiply `f32` always.
const FEW: usize = 16;
/// Output channels of a register tile.
const BLOCK: usize = 8;
/// Vectors of pixels of a register tile.
const VECTORS: usize = 3;
/// Output rows per task: enough to reuse the weights in the first-level cache, few enough to balance the load.
const BAND_ROWS: usize = 8;

/// Convolution of `input` with `weight`, then the epilogue; `[N, C_out, H_out, W_out]`. At the [`crate::precision()`].
///
/// The order of an element's sum depends on `shape` alone, and each step is a fused multiply-add, so the result does not depend
/// on the number of threads or the instruction set. Panics when the length of a slice does not match `shape`.
pub fn conv2d(input: &[f32], weight: &[f32], epilogue: &Epilogue, shape: &Conv2dShape) -> Vec<f32> {
    conv2d_with(Isa::best(), input, weight, epilogue, shape)
}

/// [`conv2d`] with a chosen instruction set.
pub(super) fn conv2d_with(
    isa: Isa,
    input: &[f32],
    weight: &[f32],
    epilogue: &Epilogue,
    shape: &Conv2dShape,
) -> Vec<f32> {
    convolve_packed(isa, input, &pack(isa, cpu_precision(), weight, shape), epilogue, shape)
}

/// The algorithm of a convolution.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Method {
    /// A matrix product.
    Pointwise,
    Winograd(Scheme),
    /// A matrix product with the inputs under each tap copied side by side (im2col).
    Panels,
    /// Direct, tap by tap.
    Direct,
}

impl Method {
    fn of(shape: &Conv2dShape) -> Self {
        shape.check_dense();
        if shape.kernel == [1, 1] && shape.stride == [1, 1] && shape.padding == [0, 0] {
            return Method::Pointwise;
        }
        match Scheme::of(shape) {
            Some(scheme) => Method::Winograd(scheme),
            // Copies pay off when many output channels use them.
            None if shape.out_channels >= BLOCK => Method::Panels,
            None => Method::Direct,
        }
    }
}

/// The weights in the layout of [`convolve_packed`], for products of a precision where that is [`possible`].
pub(crate) fn pack(isa: Isa, precision: Precision, weight: &[f32], shape: &Conv2dShape) -> Packed {
    assert_eq!(weight.len(), shape.weight_len(), "weight of {shape:?}");
    let precision = possible(precision, [shape.in_channels, shape.out_channels]);
    let depth = shape.in_channels * shape.taps();
    match Method::of(shape) {
        Method::Pointwise | Method::Panels => Packed::rows(isa, precision, weight, depth),
        Method::Winograd(scheme) => scheme.pack(isa, precision, weight, shape),
        Method::Direct => Packed::of_numbers(pack_weights(weight, shape.out_channels, depth)),
    }
}

/// The default, `f32`, for convolutions of few channels, whatever precision is wanted: what goes in or comes out is a frame, a flow, or little else.
pub(crate) fn possible<P: Default>(wanted: P, channels: [usize; 2]) -> P {
    if channels.iter().any(|&channels| channels < FEW) { P::default() } else { wanted }
}

/// [`conv2d`] with weights from [`pack`] for the same instruction set and shape.
pub(crate) fn convolve_packed(
    isa: Isa,
    input: &[f32],
    packed: &Packed,
    epilogue: &Epilogue,
    shape: &Conv2dShape,
) -> Vec<f32> {
    assert_eq!(input.len(), shape.input_len(), "input of {shape:?}");
    epilogue.check(shape.out_channels, shape.output_len());
    if shape.output_len() == 0 {
        return Vec::new();
    }
    match Method::of(shape) {
        Method::Pointwise => {
            let layer = Layer {
                map: Map::Dense { weights: packed.part(0), outputs: shape.out_channels },
                bias: epilogue.bias,
                add: epilogue.residual.map_or(Add::Nothing, Add::Planes),
                activation: epilogue.activation,
            };
            pointwise(isa, input, [shape.batch, shape.in_channels, shape.input[0] * shape.input[1]], &[layer])
        }
        Method::Winograd(scheme) => winograd::convolve(isa, scheme, input, packed, epilogue, shape),
        Method::Panels => panels::convolve(isa, input, packed.part(0), epilogue, &Reads::of(shape)),
        Method::Direct => convolve_directly(isa, input, packed.numbers(), epilogue, shape),
    }
}

fn convolve_directly(
    isa: Isa,
    input: &[f32],
    weights: &[f32],
    epilogue: &Epilogue,
    shape: &Conv2dShape,
) -> Vec<f32> {
    let [height, width] = shape.output();
    let mut out = zeros(shape.output_len());
    let blocks = shape.out_channels.div_ceil(BLOCK);
    let padded = Padded::of(input, shape);
    let plan = Plan {
        channels: shape.in_channels,
        source_channel: padded.channel,
        source_row: padded.row * shape.stride[0],
        taps: padded.taps(shape),
        rows: height,
        columns: width,
        out_channel: height * width,
    };
    let bands = plan.rows.div_ceil(BAND_ROWS);
    let target = SharedMut::new(&mut out);
    (0..shape.batch * blocks * bands).into_par_iter().for_each(|task| {
        let (task, band) = (task / bands, task % bands);
        let (n, block) = (task / blocks, task % blocks);
        let first = block * BLOCK;
        let channels = BLOCK.min(shape.out_channels - first);
        let mut start = [0.0; BLOCK];
        if let Some(bias) = epilogue.bias {
            start[..channels].copy_from_slice(&bias[first..first + channels]);
        }
        let image = &padded.data()[n * padded.image..][..padded.image];
        for row in band * BAND_ROWS..plan.rows.min((band + 1) * BAND_ROWS) {
            let at = (n * shape.out_channels + first) * plan.out_channel + row * plan.columns;
            let tile = Tile {
                source: image[row * plan.source_row..].as_ptr(),
                weights: weights[first * plan.channels * plan.taps.len()..].as_ptr(),
                start,
                out_channels: channels,
                columns: plan.columns,
                // Channel `first` of image `n`, at this row and column.
                out: target.at(at),
            };
            // SAFETY: `Padded` holds a border of the kernel's reach around every pixel read, and
            // no two tasks share an output element.
            unsafe {
                convolve_row(isa, &plan, &tile);
                for channel in 0..channels {
                    let at = at + channel * plan.out_channel;
                    let row = std::slice::from_raw_parts_mut(target.at(at), plan.columns);
                    epilogue.finish(isa, at, row);
                }
            }
        }
    });
    out
}

/// Reorders `[rows, inner]` into blocks of [`BLOCK`] rows (the last may have fewer), each `[inner, rows of the block]`.
fn pack_weights(weight: &[f32], rows: usize, inner: usize) -> Vec<f32> {
    let mut packed = vec![0.0; rows * inner];
    packed.par_chunks_mut(BLOCK * inner).zip(weight.par_chunks(BLOCK * inner)).for_each(|(to, from)| {
        let rows = from.len() / inner;
        for (row, values) in from.chunks_exact(inner).enumerate() {
            for (i, &value) in values.iter().enumerate() {
                to[i * rows + row] = value;
            }
        }
    });
    packed
}

/// The zero-padded input, `[batch, row, channel, column]`: the data of one output row over all channels lies on few memory
/// pages, where planes of a large image would need one page per channel and row. With a stride, each row holds the columns of
/// remainder 0, then of remainder 1, and so on, so that neighbouring outputs read neighbouring inputs.
pub(super) struct Padded<'a> {
    copy: Vec<f32>,
    input: &'a [f32],
    /// The input itself: a pointwise convolution needs no copy.
    pub(super) is_input: bool,
    /// Elements from one row to the next.
    pub(super) row: usize,
    /// Elements from one channel to the next.
    pub(super) channel: usize,
    /// Elements from one image to the next.
    pub(super) image: usize,
    /// Columns of one remainder.
    phase: usize,
}

impl<'a> Padded<'a> {
    pub(super) fn of(input: &'a [f32], shape: &Conv2dShape) -> Self {
        let [height, width] = shape.input;
        if shape.kernel == [1, 1] && shape.stride == [1, 1] && shape.padding == [0, 0] {
            return Self {
                copy: Vec::new(),
                input,
                is_input: true,
                row: width,
                channel: height * width,
                image: shape.in_channels * height * width,
                phase: width,
            };
        }
        let [pad_y, pad_x] = shape.padding;
        let stride = shape.stride[1];
        let phase = (width + 2 * pad_x).div_ceil(stride);
        let columns = phase * stride;
        let row = shape.in_channels * columns;
        let image = (height + 2 * pad_y) * row;
        let mut copy = zeros(shape.batch * image);
        copy.par_chunks_mut(row).enumerate().for_each(|(i, to)| {
            let (n, y) = (i / (height + 2 * pad_y), i % (height + 2 * pad_y));
            let Some(y) = y.checked_sub(pad_y).filter(|&y| y < height) else { return };
            for (c, target) in to.chunks_exact_mut(columns).enumerate() {
                let source = &input[((n * shape.in_channels + c) * height + y) * width..][..width];
                if stride == 1 {
                    target[pad_x..pad_x + width].copy_from_slice(source);
                } else {
                    for (x, &value) in source.iter().enumerate() {
                        let column = x + pad_x;
                        target[column % stride * phase + column / stride] = value;
                    }
                }
            }
        });
        Self { copy, input, is_input: false, row, channel: columns, image, phase }
    }

    pub(super) fn data(&self) -> &[f32] {
        if self.is_input { self.input } else { &self.copy }
    }

    /// Offset of each tap relative to tap 0.
    pub(super) fn taps(&self, shape: &Conv2dShape) -> Vec<usize> {
        let [kernel_height, kernel_width] = shape.kernel;
        let stride = shape.stride[1];
        (0..kernel_height * kernel_width)
            .map(|tap| {
                let (y, x) = (tap / kernel_width, tap % kernel_width);
                y * self.row + x % stride * self.phase + x / stride
            })
            .collect()
    }
}

/// Data shared by all rows of a convolution.
struct Plan {
    channels: usize,
    source_channel: usize,
    source_row: usize,
    taps: Vec<usize>,
    rows: usize,
    columns: usize,
    out_channel: usize,
}

/// A row, or a part of it, of up to [`BLOCK`] output channels.
struct Tile {
    source: *const f32,
    weights: *const f32,
    start: [f32; BLOCK],
    out_channels: usize,
    columns: usize,
    out: *mut f32,
}

dispatch! {
    /// Computes one [`Tile`].
    ///
    /// # Safety
    /// The source is readable at every tap of every channel and column, and the output is writable.
    unsafe fn convolve_row = convolve_row_kernel(plan: &Plan, tile: &Tile)
}

#[inline(always)]
unsafe fn convolve_row_kernel<S: Simd>(s: S, plan: &Plan, tile: &Tile) {
    macro_rules! by_channels {
        ($($channels:literal)*) => {
            match tile.out_channels {
                // SAFETY: guaranteed by the caller.
                $($channels => unsafe { convolve_columns::<S, $channels>(s, plan, tile) },)*
                _ => unreachable!("a block has 1 to {BLOCK} channels"),
            }
        };
    }
    by_channels!(1 2 3 4 5 6 7 8)
}

#[inline(always)]
unsafe fn convolve_columns<S: Simd, const CHANNELS: usize>(s: S, plan: &Plan, tile: &Tile) {
    let mut x = 0;
    // SAFETY: each call covers the given columns from `x` on, all inside the tile.
    unsafe {
        while tile.columns - x >= VECTORS * S::LANES {
            accumulate::<S, CHANNELS, VECTORS, false>(s, plan, tile, x, S::LANES);
            x += VECTORS * S::LANES;
        }
        let rest = tile.columns - x;
        let last = if rest.is_multiple_of(S::LANES) { S::LANES } else { rest % S::LANES };
        match (rest.div_ceil(S::LANES), last == S::LANES) {
            (0, _) => {}
            (1, true) => accumulate::<S, CHANNELS, 1, false>(s, plan, tile, x, last),
            (1, false) => accumulate::<S, CHANNELS, 1, true>(s, plan, tile, x, last),
            (2, true) => accumulate::<S, CHANNELS, 2, false>(s, plan, tile, x, last),
            (2, false) => accumulate::<S, CHANNELS, 2, true>(s, plan, tile, x, last),
            _ => accumulate::<S, CHANNELS, 3, true>(s, plan, tile, x, last),
        }
    }
}

/// The register tile: `CHANNELS` by `V` vectors from column `x`; only `last` lanes of the last vector when `PARTIAL`.
#[inline(always)]
unsafe fn accumulate<S: Simd, const CHANNELS: usize, const V: usize, const PARTIAL: bool>(
    s: S,
    plan: &Plan,
    tile: &Tile,
    x: usize,
    last: usize,
) {
    // SAFETY: guaranteed by the caller: every address below lies in the padded source, the packed weights or the output.
    unsafe {
        let mut sums = [[s.splat(0.0); V]; CHANNELS];
        for (channel, sums) in sums.iter_mut().enumerate() {
            *sums = [s.splat(tile.start[channel]); V];
        }
        let mut weights = tile.weights;
        for channel in 0..plan.channels {
            let source = tile.source.add(channel * plan.source_channel + x);
            for &tap in &plan.taps {
                let mut pixels = [s.splat(0.0); V];
                for (i, pixels) in pixels.iter_mut().enumerate() {
                    let from = source.add(tap + i * S::LANES);
                    *pixels = if PARTIAL && i == V - 1 { s.load_first(from, last) } else { s.load(from) };
                }
                for (channel, sums) in sums.iter_mut().enumerate() {
                    let weight = s.splat(*weights.add(channel));
                    for i in 0..V {
                        sums[i] = s.mul_add(weight, pixels[i], sums[i]);
                    }
                }
                weights = weights.add(CHANNELS);
            }
        }
        for (channel, sums) in sums.iter().enumerate() {
            for (i, &sum) in sums.iter().enumerate() {
                let to = tile.out.add(channel * plan.out_channel + x + i * S::LANES);
                if PARTIAL && i == V - 1 { s.store_first(to, sum, last) } else { s.store(to, sum) }
            }
        }
    }
}
