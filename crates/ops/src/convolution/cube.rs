//! Dense convolutions of 16-bit numbers on CubeCL devices: matrix products of the weight and the patches of the input, in pieces. Burn's
//! own convolutions may add up in the type that they multiply, which would lose digits; here sums are `f32`.

use std::ops::Range;

use burn::backend::TensorMetadata;
use burn::backend::cubecl::dtype_to_storage_type;
use burn::backend::ops::FloatTensorOps as _;
use burn_cubecl::cubecl::ir::ElemType;
use burn_cubecl::cubecl::{self, prelude::*};
use burn_cubecl::{CubeBackend, tensor::CubeTensor};

use super::Conv2dShape;
use crate::conv2d::as_convolution;
use crate::cube::{contiguous, empty_of, magnified, product, threads};
use crate::operation::narrow;
use crate::precision::precision;

/// What the patches of a piece may take.
const PIECE_BYTES: usize = 64 << 20;

/// The convolution's sums, at the precision of this thread.
pub(super) fn sums(input: CubeTensor, weight: CubeTensor, shape: &Conv2dShape) -> CubeTensor {
    let input = contiguous(input);
    let weight = CubeBackend::float_reshape(weight, [1, shape.out_channels, depth(shape)].into());
    let [_, width] = shape.output();
    let sums = pieces(shape, PIECE_BYTES).map(|rows| {
        let sums = product(weight.clone(), patches(&input, shape, &rows));
        CubeBackend::float_reshape(sums, [shape.batch, shape.out_channels, rows.len(), width].into())
    });
    joined(sums.collect())
}

/// Gradient of the input, which is a convolution too; `None` where the stride is not 1 or the padding not less than the kernel.
pub(super) fn backward_input(
    grad: &CubeTensor,
    weight: &CubeTensor,
    shape: &Conv2dShape,
) -> Option<CubeTensor> {
    let backward = as_convolution(shape)?;
    let turned = CubeBackend::float_flip(CubeBackend::float_swap_dims(weight.clone(), 0, 1), &[2, 3]);
    Some(magnified(grad.clone(), |grad| sums(grad, turned, &backward)))
}

/// Gradient of the weight.
pub(super) fn backward_weight(input: &CubeTensor, grad: &CubeTensor, shape: &Conv2dShape) -> CubeTensor {
    let input = contiguous(input.clone());
    let [_, width] = shape.output();
    magnified(grad.clone(), |grad| {
        let grad = contiguous(grad);
        let parts = pieces(shape, PIECE_BYTES).map(|rows| {
            let pixels = [shape.batch, shape.out_channels, rows.len() * width];
            let grad = CubeBackend::float_reshape(cut(&grad, &rows), pixels.into());
            let patches = CubeBackend::float_swap_dims(patches(&input, shape, &rows), 1, 2);
            CubeBackend::float_sum_dim(product(grad, patches), 0)
        });
        let whole =
            parts.reduce(CubeBackend::float_add).unwrap_or_else(|| unreachable!("an output has rows"));
        CubeBackend::float_reshape(whole, shape.weight().into())
    })
}

/// Products of each sum.
fn depth(shape: &Conv2dShape) -> usize {
    shape.in_channels * shape.taps()
}

/// Rows of the output whose patches together take no more than `piece_bytes`; each piece has a row.
fn pieces(shape: &Conv2dShape, piece_bytes: usize) -> impl Iterator<Item = Range<usize>> {
    let [height, width] = shape.output();
    let row_bytes = shape.batch * depth(shape) * width * size_of::<u16>();
    let rows = (piece_bytes / row_bytes.max(1)).clamp(1, height);
    (0..height).step_by(rows).map(move |first| first..(first + rows).min(height))
}

fn joined(mut parts: Vec<CubeTensor>) -> CubeTensor {
    if parts.len() == 1 { parts.swap_remove(0) } else { CubeBackend::float_cat(parts, 2) }
}

/// Some rows of a map.
fn cut(map: &CubeTensor, rows: &Range<usize>) -> CubeTensor {
    if rows.len() == map.shape()[2] {
        return map.clone();
    }
    narrow::<CubeBackend>(map.clone(), 2, rows.start, rows.len())
}

/// What each sum of some output rows multiplies the weight with, `[batch, depth, pixels]`, of 16 bits.
fn patches(input: &CubeTensor, shape: &Conv2dShape, rows: &Range<usize>) -> CubeTensor {
    let [_, width] = shape.output();
    let sizes = [shape.batch, depth(shape), rows.len() * width];
    if shape.kernel == [1, 1] && shape.stride == [1, 1] && shape.padding == [0, 0] {
        return CubeBackend::float_reshape(cut(input, rows), sizes.into());
    }
    let dtype = precision().dtype();
    let out = empty_of(input, sizes, dtype);
    let client = input.client.clone();
    let (count, dim) = threads(&client, out.shape().num_elements());
    patches_kernel::launch(
        &client,
        count,
        dim,
        input.clone().into_tensor_arg(),
        out.clone().into_tensor_arg(),
        rows.start,
        width,
        shape.stride[0],
        shape.stride[1],
        shape.padding[0],
        shape.padding[1],
        shape.kernel[0],
        shape.kernel[1],
        dtype_to_storage_type(dtype),
    );
    out
}

/// One thread per number: neighbours write neighbouring numbers, and read some that are near each other. The input is
/// `[batch, channels, height, width]`, the patches `[batch, channels * kernel_height * kernel_width, rows * out_width]`.
#[cube(launch)]
fn patches_kernel<F: Float>(
    input: &Tensor<f32>,
    patches: &mut Tensor<F>,
    first_row: usize,
    out_width: usize,
    stride_y: usize,
    stride_x: usize,
    padding_y: usize,
    padding_x: usize,
    #[comptime] kernel_height: usize,
    #[comptime] kernel_width: usize,
    #[define(F)] _dtype: ElemType,
) {
    let (channels, height, width) = (input.shape(1), input.shape(2), input.shape(3));
    let pixels = patches.shape(2);
    let taps = comptime!(kernel_height * kernel_width);
    if ABSOLUTE_POS >= patches.shape(0) * channels * taps * pixels {
        terminate!();
    }
    let pixel = ABSOLUTE_POS % pixels;
    let tap = ABSOLUTE_POS / pixels % taps;
    let plane = ABSOLUTE_POS / (pixels * taps);
    // Of the input with its border of zeros.
    let y = (first_row + pixel / out_width) * stride_y + tap / kernel_width;
    let x = pixel % out_width * stride_x + tap % kernel_width;
    let mut value = 0.0f32;
    if y >= padding_y && y - padding_y < height && x >= padding_x && x - padding_x < width {
        value = input[(plane * height + y - padding_y) * width + x - padding_x];
    }
    patches[ABSOLUTE_POS] = F::cast_from(value);
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pieces_cover_the_output_and_have_at_least_a_row() {
        let shape = Conv2dShape {
            batch: 2,
            in_channels: 3,
            out_channels: 5,
            groups: 1,
            input: [7, 8],
            kernel: [3, 3],
            stride: [1, 1],
            padding: [1, 1],
        };
        let row_bytes = 2 * 27 * 8 * 2;
        let of = |bytes| pieces(&shape, bytes).collect::<Vec<_>>();
        assert_eq!(of(0), (0..7).map(|row| row..row + 1).collect::<Vec<_>>());
        assert_eq!(of(3 * row_bytes), [0..3, 3..6, 6..7]);
        assert_eq!(of(usize::MAX), vec![Range { start: 0, end: 7 }]);
    }
}
