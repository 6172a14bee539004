//! Upsampling of coarse flow to full resolution.

use burn::module::Module;
use burn::tensor::{Device, Tensor};
use srflow_nn::layers::{Conv2d, Conv2dConfig, NoParameters};
use srflow_ops::Activation;
use srflow_ops::upsample::tensor;

use super::{Grids, resize};
use crate::recurrent::STRIDE;

/// Factor of the weights in the reference, "to balance gradients".
const MASK_SCALE: f32 = 0.25;

/// Computes weights of convex upsampling from the hidden state: the sequence `update_block.mask`, or `upsample_weight`.
pub(crate) type ConvexMask = (Conv2d, NoParameters, Conv2d);

pub(crate) fn convex_mask(hidden: usize, device: &Device) -> ConvexMask {
    (
        Conv2dConfig::new([hidden, 256], [3, 3]).init(device),
        NoParameters,
        Conv2dConfig::new([256, STRIDE * STRIDE * 9], [1, 1]).init(device),
    )
}

/// Upsamples coarse flow `[batch, 2, height, width]` 8 times, each fine pixel as a convex combination of 3x3 coarse neighbours.
pub(crate) fn convex_upsample(mask: &ConvexMask, hidden: &Tensor<4>, flow: Tensor<4>) -> Tensor<4> {
    let weights = mask.0.forward(hidden.clone(), Activation::Relu);
    let weights = mask.2.forward(weights, Activation::Identity);
    tensor::convex_upsample(flow, weights, MASK_SCALE, STRIDE)
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
            conv2: Conv2dConfig::new([2 * hidden, STRIDE * STRIDE * 9], [1, 1]).init(device),
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

/// Upsamples coarse flow 8 times by bilinear interpolation with `align_corners=True` (`upflow8`).
pub(crate) fn bilinear_upsample(flow: Tensor<4>) -> Tensor<4> {
    let [_, _, height, width] = flow.dims();
    resize(flow, [height, width].map(|side| STRIDE * side), Grids::CornersOnCorners) * STRIDE as f64
}
