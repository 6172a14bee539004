//! From the flow that is refined to the flow of every pixel.

use burn::module::Module;
use burn::tensor::{Device, Tensor};
use srflow_nn::layers::{Conv2d, Conv2dConfig, NoParameters};
use srflow_ops::Activation;
use srflow_ops::upsample::tensor;

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

    /// Fine flow as a convex combination of coarse neighbours.
    pub(crate) fn upsample(&self, hidden: &Tensor<4>, flow: Tensor<4>) -> Tensor<4> {
        let weights = self.conv1.forward(hidden.clone(), Activation::Relu);
        let weights = self.conv2.forward(weights, Activation::Identity);
        tensor::convex_upsample(flow, weights, 1.0, STRIDE)
    }
}

/// Fine flow by bilinear interpolation, corners on corners (`upflow8`).
pub(crate) fn bilinear_upsample(flow: Tensor<4>) -> Tensor<4> {
    let [_, _, height, width] = flow.dims();
    resize_bilinear(flow, [height, width].map(|side| side * STRIDE)) * STRIDE as f64
}

/// Maps of another height and width by bilinear interpolation, corners on corners
/// (`F.interpolate(..., mode="bilinear", align_corners=True)`).
pub(crate) fn resize_bilinear(x: Tensor<4>, [height, width]: [usize; 2]) -> Tensor<4> {
    let [batch, channels, old_height, old_width] = x.dims();
    let along = |new: usize, old: usize| {
        interpolation(new, old, &x.device()).reshape([1, 1, new, old]).expand([batch, channels, new, old])
    };
    let columns = along(width, old_width).swap_dims(2, 3);
    along(height, old_height).matmul(x).matmul(columns)
}

/// Weight of each old position at each new one: `[new, old]`.
fn interpolation(new: usize, old: usize, device: &Device) -> Tensor<2> {
    let step = (old - 1) as f64 / (new - 1).max(1) as f64;
    let weight = |i: usize| {
        let at = (i / old) as f64 * step;
        (1.0 - (at - (i % old) as f64).abs()).max(0.0) as f32
    };
    let weights: Vec<f32> = (0..new * old).map(weight).collect();
    Tensor::<1>::from_floats(weights.as_slice(), device).reshape([new, old])
}
