//! The upsampling on CubeCL devices in one kernel: composed, the weights of each of the nine neighbours would be cut out of the mask,
//! multiplied and added one after another.

use burn_cubecl::cubecl::{self, prelude::*};
use burn_cubecl::tensor::CubeTensor;

use super::UpsampleShape;
use crate::cube::{contiguous, empty, threads};

pub(super) fn convex_upsample(inputs: [CubeTensor; 2], scale: f32, shape: &UpsampleShape) -> CubeTensor {
    let [flow, mask] = inputs.map(contiguous);
    let UpsampleShape { batch, coarse: [height, width], factor } = *shape;
    let out = empty(&flow, [batch, 2, factor * height, factor * width]);
    let client = flow.client.clone();
    let (count, dim) = threads(&client, shape.output_len() / 2);
    upsample_kernel::launch(
        &client,
        count,
        dim,
        flow.into_tensor_arg(),
        mask.into_tensor_arg(),
        out.clone().into_tensor_arg(),
        scale,
        factor,
    );
    out
}

/// One thread per fine pixel, for both components. Neighbouring threads process the same fine pixel of neighbouring coarse ones: their
/// nine reads of the mask are contiguous, and their two writes are not. Layouts as in [`UpsampleShape`].
#[cube(launch)]
fn upsample_kernel(
    flow: &Tensor<f32>,
    mask: &Tensor<f32>,
    out: &mut Tensor<f32>,
    scale: f32,
    #[comptime] factor: usize,
) {
    let (height, width) = (flow.shape(2), flow.shape(3));
    let pixels = height * width;
    let per_neighbour = comptime!(factor * factor);
    if ABSOLUTE_POS >= flow.shape(0) * per_neighbour * pixels {
        terminate!();
    }
    let pixel = ABSOLUTE_POS % pixels;
    let place = ABSOLUTE_POS / pixels % per_neighbour;
    let n = ABSOLUTE_POS / (pixels * per_neighbour);
    let (y, x) = (pixel / width, pixel % width);
    let first = (n * comptime!(9 * factor * factor) + place) * pixels + pixel;

    // By the largest, so that no exponential overflows.
    let mut largest = scale * mask[first];
    for k in 1..9usize {
        largest = largest.max(scale * mask[first + k * per_neighbour * pixels]);
    }
    let plane = n * 2 * pixels;
    let mut total = 0.0f32;
    let mut u = 0.0f32;
    let mut v = 0.0f32;
    for k in 0..9usize {
        let weight = (scale * mask[first + k * per_neighbour * pixels] - largest).exp();
        total += weight;
        // One more than the neighbour's place, which may lie before the first.
        let (row, column) = (y + k / 3, x + k % 3);
        if row >= 1 && row <= height && column >= 1 && column <= width {
            let at = plane + (row - 1) * width + column - 1;
            u += weight * flow[at];
            v += weight * flow[at + pixels];
        }
    }
    let by = f32::cast_from(factor) / total;
    let fine_width = width * factor;
    let fine = (y * factor + place / factor) * fine_width + x * factor + place % factor;
    let start = plane * per_neighbour + fine;
    out[start] = u * by;
    out[start + pixels * per_neighbour] = v * by;
}
