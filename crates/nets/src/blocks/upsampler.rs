//! From the flow that is refined to the flow of every pixel.

use burn::module::Module;
use burn::tensor::{Device, Tensor};
use srflow_nn::layers::{Conv2d, Conv2dConfig, NoParameters};
use srflow_ops::Activation;
use srflow_ops::upsample::tensor;

use super::{Grids, resize};
use crate::recurrent::STRIDE;

/// What the reference multiplies the weights with "to balance gradients".
const MASK_SCALE: f32 = 0.25;

/// Weights of convex upsampling from the hidden state: the sequence `update_block.mask`, or `upsample_weight`.
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

/// `ConvexMask` of RPKNet and DPFlow: weights of convex upsampling from the hidden state.
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

    /// For [`upsample_by`].
    pub(crate) fn weights(&self, hidden: &Tensor<4>) -> Tensor<4> {
        let weights = self.conv1.forward(hidden.clone(), Activation::Relu);
        self.conv2.forward(weights, Activation::Identity)
    }
}

/// Fine flow as a convex combination of coarse neighbours.
pub(crate) fn upsample_by(weights: &Tensor<4>, flow: Tensor<4>) -> Tensor<4> {
    tensor::convex_upsample(flow, weights.clone(), 1.0, STRIDE)
}

/// Fine flow by bilinear interpolation, corners on corners (`upflow8`).
pub(crate) fn bilinear_upsample(flow: Tensor<4>) -> Tensor<4> {
    let [_, _, height, width] = flow.dims();
    resize(flow, [height, width].map(|side| STRIDE * side), Grids::CornersOnCorners) * STRIDE as f64
}
