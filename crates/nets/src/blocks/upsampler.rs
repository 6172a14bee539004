//! Upsampling of coarse flow to full resolution.

use burn::module::Module;
use burn::tensor::{Device, Tensor};
use srflow_nn::layers::{Conv2d, Conv2dConfig, NoParameters};
use srflow_ops::Activation;
use srflow_ops::upsample::tensor;

use super::{Divided, Grids, Strips, resize};
use crate::recurrent::STRIDE;

/// Coarse pixels per convex combination.
const NEIGHBOURS: usize = 9;
/// Factor of the weights in the reference, "to balance gradients".
const MASK_SCALE: f32 = 0.25;

/// Computes weights of convex upsampling from the hidden state: the sequence `update_block.mask`, `upsample_weight` or
/// `upsampler`.
pub(crate) type ConvexMask = (Conv2d, NoParameters, Conv2d);

pub(crate) fn convex_mask(hidden: usize, device: &Device) -> ConvexMask {
    convex_mask_by(STRIDE, hidden, device)
}

/// A [`convex_mask`] for another upsampling factor and number of input channels.
pub(crate) fn convex_mask_by(factor: usize, inputs: usize, device: &Device) -> ConvexMask {
    (
        Conv2dConfig::new([inputs, 256], [3, 3]).init(device),
        NoParameters,
        Conv2dConfig::new([256, factor * factor * NEIGHBOURS], [1, 1]).init(device),
    )
}

/// Upsamples coarse flow `[batch, 2, height, width]` by the factor of the mask, each fine pixel as a convex combination of 3x3
/// coarse neighbours.
pub(crate) fn convex_upsample(mask: &ConvexMask, hidden: &Tensor<4>, flow: Tensor<4>) -> Tensor<4> {
    scaled_convex_upsample(mask_weights(mask, hidden), flow)
}

/// [`convex_upsample`] with weights computed in strips.
pub(crate) fn convex_upsample_of_strips(
    strips: Strips,
    mask: &ConvexMask,
    hidden: &Divided,
    flow: Tensor<4>,
) -> Tensor<4> {
    let [weights] = strips.map([], 1, |rows, []| [mask_weights(mask, &hidden.rows(rows))]);
    scaled_convex_upsample(weights, flow)
}

fn scaled_convex_upsample(weights: Tensor<4>, flow: Tensor<4>) -> Tensor<4> {
    let factor = (weights.dims()[1] / NEIGHBOURS).isqrt();
    tensor::convex_upsample(flow, weights, MASK_SCALE, factor)
}

/// [`convex_upsample`] by `factor`, without [`MASK_SCALE`] (UniMatch).
pub(crate) fn unscaled_convex_upsample(
    mask: &ConvexMask,
    x: &Tensor<4>,
    flow: Tensor<4>,
    factor: usize,
) -> Tensor<4> {
    tensor::convex_upsample(flow, mask_weights(mask, x), 1.0, factor)
}

fn mask_weights(mask: &ConvexMask, x: &Tensor<4>) -> Tensor<4> {
    mask.2.forward(mask.0.forward(x.clone(), Activation::Relu), Activation::Identity)
}

/// `ConvexMask` of RPKNet and DPFlow: computes weights of convex upsampling from the hidden state.
#[derive(Module, Debug)]
pub(crate) struct WideConvexMask {
    conv1: Conv2d,
    conv2: Conv2d,
}

impl WideConvexMask {
    pub(crate) fn new(hidden: usize, device: &Device) -> Self {
        Self {
            conv1: Conv2dConfig::new([hidden, 2 * hidden], [3, 3]).init(device),
            conv2: Conv2dConfig::new([2 * hidden, STRIDE * STRIDE * NEIGHBOURS], [1, 1]).init(device),
        }
    }

    /// Weights for [`upsample_by`].
    pub(crate) fn weights(&self, hidden: &Tensor<4>) -> Tensor<4> {
        let weights = self.conv1.forward(hidden.clone(), Activation::Relu);
        self.conv2.forward(weights, Activation::Identity)
    }
}

/// Upsamples coarse flow 8 times with precomputed weights; see [`convex_upsample`].
pub(crate) fn upsample_by(weights: &Tensor<4>, flow: Tensor<4>) -> Tensor<4> {
    tensor::convex_upsample(flow, weights.clone(), 1.0, STRIDE)
}

/// Upsamples coarse flow `factor` times by bilinear interpolation with `align_corners=True` (`upflow8`).
pub(crate) fn bilinear_upsample(flow: Tensor<4>, factor: usize) -> Tensor<4> {
    let [_, _, height, width] = flow.dims();
    resize(flow, [height, width].map(|side| factor * side), Grids::CornersOnCorners) * factor as f64
}
