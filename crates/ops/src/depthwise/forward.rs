use srflow_simd::{
    Isa, Multiply, Numbers, Pair, Precision, Simd, dispatch, dispatch_pairs, fill_pieces, pair_neighbours,
};

use crate::conv2d::Epilogue;
use crate::convolution::Conv2dShape;
use crate::precision::cpu_precision;

/// Output rows of a register tile.
const ROWS: usize = 4;
/// Vectors of pixels of a register tile.
const VECTORS: usize = 4;

/// Depthwise convolution of `input` with `weight`, then the epilogue; `[N, C, H_out, W_out]`.
///
/// The sum of an element starts at the bias and runs over kernel rows, then columns, each step a fused multiply-add, so the
/// result does not depend on the number of threads or the instruction set. At the [`crate::precision()`]. Panics when the length of a
/// slice does not match `shape`, or that is not depthwise with stride 1.
pub fn depthwise(input: &[f32], weight: &[f32], epilogue: &Epilogue, shape: &Conv2dShape) -> Vec<f32> {
    depthwise_with(Isa::best(), cpu_precision(), input, weight, epilogue, shape)
}

/// [`depthwise`] with a chosen instruction set.
pub(super) fn depthwise_with(
    isa: Isa,
    precision: Precision,
    input: &[f32],
    weight: &[f32],
    epilogue: &Epilogue,
    shape: &Conv2dShape,
) -> Vec<f32> {
    shape.check_depthwise();
    assert_eq!(input.len(), shape.input_len(), "input of {shape:?}");
    assert_eq!(weight.len(), shape.weight_len(), "weight of {shape:?}");
    epilogue.check(shape.out_channels, shape.output_len());
    let [height, width] = shape.output();
    let taps = shape.kernel[0] * shape.kernel[1];
    // Neighbouring taps of a row make a pair.
    let paired = precision == Precision::Bf16 && shape.kernel[1] > 1;
    let weight_pairs = if paired { pairs_of_rows(weight, shape.kernel[1]) } else { Vec::new() };
    let steps = if paired { shape.kernel[1].div_ceil(2) } else { shape.kernel[1] };
    let scratch = || (Vec::new(), Vec::new());
    fill_pieces(shape.output_len(), height * width, scratch, |(scratch, pairs), plane, out| {
        let channel = plane % shape.out_channels;
        let source = &input[plane * shape.input[0] * shape.input[1]..][..shape.input[0] * shape.input[1]];
        let row = pad(source, shape.input, shape.padding, scratch);
        let task = Plane {
            source: scratch.as_ptr(),
            row,
            weight: weight[channel * taps..][..taps].as_ptr(),
            kernel: [shape.kernel[0], steps],
            start: epilogue.bias.map_or(0.0, |bias| bias[channel]),
            height,
            width,
        };
        let to = out.as_mut_ptr().cast();
        // SAFETY: `pad` wrote the padding that the kernel reads; the kernel writes the whole plane.
        let out = unsafe {
            if paired {
                pairs.resize(scratch.len(), Pair::default());
                pair_neighbours(isa, scratch, pairs);
                let taps = shape.kernel[0] * steps;
                let weight = weight_pairs[channel * taps..][..taps].as_ptr().cast();
                convolve_plane_of_pairs(isa, &Plane { source: pairs.as_ptr().cast(), weight, ..task }, to);
            } else {
                convolve_plane(isa, &task, to);
            }
            out.assume_init_mut()
        };
        epilogue.finish(isa, plane * height * width, out);
        out
    })
}

/// The taps of each kernel row, of `width` taps, two by two; a missing last one is zero.
fn pairs_of_rows(weight: &[f32], width: usize) -> Vec<Pair> {
    let two = |taps: &[f32]| Pair::new(taps[0], taps.get(1).copied().unwrap_or(0.0));
    weight.chunks_exact(width).flat_map(|row| row.chunks(2).map(two)).collect()
}

/// Copies a plane into `padded` with a border of zeros; returns the number of elements from one row to the next.
pub(super) fn pad(
    plane: &[f32],
    [_, width]: [usize; 2],
    [pad_y, pad_x]: [usize; 2],
    padded: &mut Vec<f32>,
) -> usize {
    let row = width + 2 * pad_x;
    padded.clear();
    padded.resize(pad_y * row, 0.0);
    for source in plane.chunks_exact(width) {
        padded.resize(padded.len() + pad_x, 0.0);
        padded.extend_from_slice(source);
        padded.resize(padded.len() + pad_x, 0.0);
    }
    padded.resize(padded.len() + pad_y * row, 0.0);
    row
}

/// One channel of one image.
struct Plane {
    /// Numbers, or each number and the one to its right as [`Pair`]s.
    source: *const f32,
    row: usize,
    /// Taps, or pairs of them.
    weight: *const f32,
    /// Rows of the kernel, and elements of a row.
    kernel: [usize; 2],
    start: f32,
    height: usize,
    width: usize,
}

dispatch! {
    /// Computes one [`Plane`].
    ///
    /// # Safety
    /// The source contains every tap of every pixel of the plane, and `out` is a writable plane.
    unsafe fn convolve_plane = convolve_plane_of_numbers(plane: &Plane, out: *mut f32)
}

dispatch_pairs! {
    /// Computes one [`Plane`] of pairs.
    ///
    /// # Safety
    /// As for [`convolve_plane`].
    unsafe fn convolve_plane_of_pairs = convolve_plane_kernel(plane: &Plane, out: *mut f32)
}

#[inline(always)]
unsafe fn convolve_plane_of_numbers<S: Simd>(s: S, plane: &Plane, out: *mut f32) {
    // SAFETY: guaranteed by the caller.
    unsafe { convolve_plane_kernel(s, Numbers, plane, out) }
}

#[inline(always)]
unsafe fn convolve_plane_kernel<S: Simd, M: Multiply<S>>(s: S, how: M, plane: &Plane, out: *mut f32) {
    let mut y = 0;
    // SAFETY: the rows from `y` on, as many as each call covers, lie in the plane.
    unsafe {
        while plane.height - y >= ROWS {
            convolve_rows::<S, M, ROWS>(s, how, plane, y, out);
            y += ROWS;
        }
        while y < plane.height {
            convolve_rows::<S, M, 1>(s, how, plane, y, out);
            y += 1;
        }
    }
}

#[inline(always)]
unsafe fn convolve_rows<S: Simd, M: Multiply<S>, const R: usize>(
    s: S,
    how: M,
    plane: &Plane,
    y: usize,
    out: *mut f32,
) {
    let mut x = 0;
    // SAFETY: the columns from `x` on, as many as each call covers, lie in the plane.
    unsafe {
        while plane.width - x >= VECTORS * S::LANES {
            accumulate::<S, M, R, VECTORS, false>(s, how, plane, [y, x], S::LANES, out);
            x += VECTORS * S::LANES;
        }
        let rest = plane.width - x;
        let last = if rest.is_multiple_of(S::LANES) { S::LANES } else { rest % S::LANES };
        match rest.div_ceil(S::LANES) {
            0 => {}
            1 => accumulate::<S, M, R, 1, true>(s, how, plane, [y, x], last, out),
            2 => accumulate::<S, M, R, 2, true>(s, how, plane, [y, x], last, out),
            3 => accumulate::<S, M, R, 3, true>(s, how, plane, [y, x], last, out),
            _ => accumulate::<S, M, R, 4, true>(s, how, plane, [y, x], last, out),
        }
    }
}

/// The register tile: `R` rows from `y` by `V` vectors from `x`; only `last` lanes of the last vector when `PARTIAL`.
#[inline(always)]
unsafe fn accumulate<S: Simd, M: Multiply<S>, const R: usize, const V: usize, const PARTIAL: bool>(
    s: S,
    how: M,
    plane: &Plane,
    [y, x]: [usize; 2],
    last: usize,
    out: *mut f32,
) {
    let [kernel_height, kernel_width] = plane.kernel;
    // SAFETY: guaranteed by the caller: every address below lies in the padded source, the weight or the output.
    unsafe {
        let mut sums = [[how.begin(s, s.splat(plane.start)); V]; R];
        let source = plane.source.add(y * plane.row + x);
        let weight = plane.weight;
        for input_row in 0..kernel_height + R - 1 {
            for kx in 0..kernel_width {
                let from = source.add(input_row * plane.row + kx * M::FACTORS);
                let mut pixels = [s.splat(0.0); V];
                for (i, pixels) in pixels.iter_mut().enumerate() {
                    let from = from.add(i * S::LANES);
                    *pixels = if PARTIAL && i == V - 1 { s.load_first(from, last) } else { s.load(from) };
                }
                for (row, sums) in sums.iter_mut().enumerate() {
                    // A negative value wraps to far beyond the kernel: one comparison checks both ends.
                    let ky = input_row.wrapping_sub(row);
                    if ky < kernel_height {
                        let weight = s.splat(*weight.add(ky * kernel_width + kx));
                        for i in 0..V {
                            sums[i] = how.add(s, weight, pixels[i], sums[i]);
                        }
                    }
                }
            }
        }
        for (row, sums) in sums.iter().enumerate() {
            for (i, &sum) in sums.iter().enumerate() {
                let to = out.add((y + row) * plane.width + x + i * S::LANES);
                if PARTIAL && i == V - 1 { s.store_first(to, sum, last) } else { s.store(to, sum) }
            }
        }
    }
}
