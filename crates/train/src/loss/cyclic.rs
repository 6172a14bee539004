//! The cyclic loss of SSA (Alkaddour, Tariq and Dhall 2022, <https://arxiv.org/abs/2105.01256>): frame 1, warped by the flow,
//! should look like frame 2. It needs no true flow.

use burn::tensor::Tensor;
use srflow_ops::warp::tensor::warp_replicated;

use super::inputs::{LossInputs, sum};

/// Key of its weight in the section `loss` of a configuration, and name in logs.
pub(crate) const NAME: &str = "cyclic";
/// One line on what it is.
pub(crate) const DESCRIPTION: &str = "Huber distance of frame 2 from frame 1 warped by the flow; SSA's";

/// Mean Huber distance (quadratic up to 1) over all values of all pixels, for frames in 0 to `image_max`. A pixel `p` of frame 2
/// is compared with `p - flow(p)` in frame 1, as in the authors' program; outside of the frame, with the nearest pixel inside.
pub(super) fn cyclic(flow: Tensor<4>, inputs: &LossInputs, image_max: f64) -> Tensor<1> {
    let [batch, channels, height, width] = inputs.first_frame.dims();
    let warped = warp_replicated(inputs.first_frame.clone(), -flow);
    let difference = (warped - inputs.second_frame.clone()).abs() * image_max;
    let quadratic = difference.clone().clamp_max(1.0);
    sum(quadratic.clone() * (difference - quadratic * 0.5)) / (batch * channels * height * width) as f64
}
