//! From the flow that is refined to the flow of every pixel.

use burn::tensor::{Device, Tensor};
use srflow_nn::layers::{Conv2d, Conv2dConfig, NoParameters};
use srflow_ops::Activation;
use srflow_ops::upsample::tensor;

use crate::recurrent::STRIDE;

/// What the reference multiplies the weights with "to balance gradients".
const MASK_SCALE: f32 = 0.25;

/// Weights of convex upsampling from the hidden state: the sequence `update_block.mask`.
pub(crate) type ConvexMask = (Conv2d, NoParameters, Conv2d);

pub(crate) fn convex_mask(hidden: usize, device: &Device) -> ConvexMask {
    (
        Conv2dConfig::new([hidden, 256], [3, 3]).init(device),
        NoParameters,
        Conv2dConfig::new([256, STRIDE * STRIDE * 9], [1, 1]).init(device),
    )
}

/// Fine flow as a convex combination of coarse neighbours.
pub(crate) fn convex_upsample(mask: &ConvexMask, hidden: &Tensor<4>, flow: Tensor<4>) -> Tensor<4> {
    let weights = mask.0.forward(hidden.clone(), Activation::Relu);
    let weights = mask.2.forward(weights, Activation::Identity);
    tensor::convex_upsample(flow, weights, MASK_SCALE, STRIDE)
}

/// Fine flow by bilinear interpolation, corners on corners (`upflow8`).
pub(crate) fn bilinear_upsample(flow: Tensor<4>) -> Tensor<4> {
    let [_, _, height, width] = flow.dims();
    let rows = interpolation(height, &flow.device());
    let columns = interpolation(width, &flow.device());
    let [batch, channels, _, _] = flow.dims();
    let along = |matrix: Tensor<2>| {
        let [fine, coarse] = matrix.dims();
        matrix.reshape([1, 1, fine, coarse]).expand([batch, channels, fine, coarse])
    };
    along(rows).matmul(flow).matmul(along(columns).swap_dims(2, 3)) * STRIDE as f64
}

/// Weight of each coarse position at each fine one: `[STRIDE * coarse, coarse]`.
fn interpolation(coarse: usize, device: &Device) -> Tensor<2> {
    let fine = coarse * STRIDE;
    let step = (coarse - 1) as f64 / (fine - 1) as f64;
    let weight = |i: usize| {
        let at = (i / coarse) as f64 * step;
        (1.0 - (at - (i % coarse) as f64).abs()).max(0.0) as f32
    };
    let weights: Vec<f32> = (0..fine * coarse).map(weight).collect();
    Tensor::<1>::from_floats(weights.as_slice(), device).reshape([fine, coarse])
}
