use rayon::prelude::*;
use srflow_simd::{Isa, Precision, Simd, dispatch};

use super::forward::{depthwise_with, pad};
use crate::conv2d::Epilogue;
use crate::convolution::Conv2dShape;
use crate::precision::cpu_precision;

/// Kernel rows and columns whose weight gradients are summed together in registers.
const TAPS_DOWN: usize = 4;
const TAPS_ACROSS: usize = 5;

/// Gradient of the input given `grad`, that of the output: the convolution of `grad` with the flipped kernel. Panics when the
/// length of a slice does not match `shape`, or the padding is not smaller than the kernel.
pub fn depthwise_backward_input(grad: &[f32], weight: &[f32], shape: &Conv2dShape) -> Vec<f32> {
    backward_input_with(Isa::best(), cpu_precision(), [grad, weight], None, shape)
}

/// [`depthwise_backward_input`], plus `add`, with a chosen instruction set.
pub(crate) fn backward_input_with(
    isa: Isa,
    precision: Precision,
    [grad, weight]: [&[f32]; 2],
    add: Option<&[f32]>,
    shape: &Conv2dShape,
) -> Vec<f32> {
    assert!(
        shape.padding[0] < shape.kernel[0] && shape.padding[1] < shape.kernel[1],
        "padding smaller than the kernel: {shape:?}"
    );
    if grad.is_empty() {
        return add.map_or_else(|| vec![0.0; shape.input_len()], <[f32]>::to_vec);
    }
    let taps = shape.kernel[0] * shape.kernel[1];
    let turned: Vec<f32> =
        weight.chunks_exact(taps).flat_map(|kernel| kernel.iter().rev()).copied().collect();
    let backward = Conv2dShape {
        input: shape.output(),
        padding: [0, 1].map(|i| shape.kernel[i] - 1 - shape.padding[i]),
        ..*shape
    };
    let epilogue = Epilogue { residual: add, ..Epilogue::default() };
    depthwise_with(isa, precision, grad, &turned, &epilogue, &backward)
}

/// Gradient of the weight given the input and `grad`, the gradient of the output; `[C, 1, kernel]`. It does not depend on the
/// number of threads (its last bits do depend on the vector width). Panics when the length of a slice does not match.
pub fn depthwise_backward_weight(input: &[f32], grad: &[f32], shape: &Conv2dShape) -> Vec<f32> {
    backward_weight_with(Isa::best(), input, grad, shape)
}

/// [`depthwise_backward_weight`] with a chosen instruction set.
pub(super) fn backward_weight_with(isa: Isa, input: &[f32], grad: &[f32], shape: &Conv2dShape) -> Vec<f32> {
    shape.check_depthwise();
    assert_eq!(input.len(), shape.input_len(), "input of {shape:?}");
    assert_eq!(grad.len(), shape.output_len(), "gradient of {shape:?}");
    let mut out = vec![0.0; shape.weight_len()];
    let [height, width] = shape.output();
    if out.is_empty() || grad.is_empty() {
        return out;
    }
    let [kernel_height, kernel_width] = shape.kernel;
    let scratch = || (Vec::new(), Vec::new());
    out.par_chunks_mut(kernel_height * kernel_width).enumerate().for_each_init(
        scratch,
        |(source, padded_grad), (channel, out)| {
            for n in 0..shape.batch {
                let plane = n * shape.out_channels + channel;
                let input_len = shape.input[0] * shape.input[1];
                let row = pad(&input[plane * input_len..][..input_len], shape.input, shape.padding, source);
                // Rows of zeros above and below let every tap of a group pass over the same input rows.
                let grad = &grad[plane * height * width..][..height * width];
                pad(grad, [height, width], [TAPS_DOWN - 1, 0], padded_grad);
                let task =
                    WeightPlane { source, row, grad: padded_grad, height, width, kernel: shape.kernel };
                // SAFETY: both planes have the padding that the kernel reads.
                unsafe { add_weight_gradient(isa, &task, out) }
            }
        },
    );
    out
}

/// One channel of one image.
struct WeightPlane<'a> {
    source: &'a [f32],
    row: usize,
    /// With [`TAPS_DOWN`]` - 1` rows of zeros above and below.
    grad: &'a [f32],
    height: usize,
    width: usize,
    kernel: [usize; 2],
}

dispatch! {
    /// Adds the weight gradient of one [`WeightPlane`].
    ///
    /// # Safety
    /// Both planes are padded, and `out` has the size of the kernel.
    unsafe fn add_weight_gradient = add_weight_gradient_kernel(plane: &WeightPlane, out: &mut [f32])
}

#[inline(always)]
unsafe fn add_weight_gradient_kernel<S: Simd>(s: S, plane: &WeightPlane, out: &mut [f32]) {
    let [kernel_height, kernel_width] = plane.kernel;
    for ky in (0..kernel_height).step_by(TAPS_DOWN) {
        let down = TAPS_DOWN.min(kernel_height - ky);
        let mut kx = 0;
        // SAFETY: the taps from `(ky, kx)` on, as many as each call covers, belong to the kernel.
        unsafe {
            while kernel_width - kx >= TAPS_ACROSS {
                sum_taps::<S, TAPS_ACROSS>(s, plane, ky, down, kx, out);
                kx += TAPS_ACROSS;
            }
            while kx < kernel_width {
                sum_taps::<S, 1>(s, plane, ky, down, kx, out);
                kx += 1;
            }
        }
    }
}

/// The taps of `down` kernel rows from `ky` and `T` columns from `kx`.
#[inline(always)]
unsafe fn sum_taps<S: Simd, const T: usize>(
    s: S,
    plane: &WeightPlane,
    ky: usize,
    down: usize,
    kx: usize,
    out: &mut [f32],
) {
    // SAFETY: guaranteed by the caller: every address below lies in the padded input or gradient.
    unsafe {
        let mut sums = [[s.splat(0.0); T]; TAPS_DOWN];
        // Input row `ky + i` meets gradient row `i - d` at tap row `ky + d`.
        for i in 0..plane.height + down - 1 {
            let source = plane.source.as_ptr().add((ky + i) * plane.row + kx);
            let grad = plane.grad.as_ptr().add(i * plane.width);
            let mut x = 0;
            while x < plane.width {
                let count = (plane.width - x).min(S::LANES);
                let load = |from: *const f32| {
                    if count == S::LANES { s.load(from) } else { s.load_first(from, count) }
                };
                let mut grads = [s.splat(0.0); TAPS_DOWN];
                for (d, grads) in grads.iter_mut().enumerate() {
                    *grads = load(grad.add((TAPS_DOWN - 1 - d) * plane.width + x));
                }
                for t in 0..T {
                    let pixels = load(source.add(x + t));
                    for d in 0..TAPS_DOWN {
                        sums[d][t] = s.mul_add(grads[d], pixels, sums[d][t]);
                    }
                }
                x += S::LANES;
            }
        }
        for (d, sums) in sums.iter().enumerate().take(down) {
            for (t, &sum) in sums.iter().enumerate() {
                out[(ky + d) * plane.kernel[1] + kx + t] += s.sum(sum);
            }
        }
    }
}
