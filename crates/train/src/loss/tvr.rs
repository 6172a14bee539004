//! Total Variation Regularization (the paper's section IV-B1).

use burn::tensor::Tensor;

use super::entry::{Border, Regularizer, RegularizerValue};
use super::inputs::sum;
use super::sobel::sobel;

pub(super) const REGULARIZER: Regularizer = Regularizer {
    name: "tvr",
    title: "TVR",
    paper_weight: 0.05,
    description: "total variation: absolute Sobel derivatives of the flow, without a mask",
    value: RegularizerValue::OfFlow(total_variation),
};

/// `R(u) + R(v)` of the paper's equations 9 and 10 for one prediction (`[batch, 2, height, width]`): the absolute Sobel
/// derivatives divided by 8, summed over both directions and both components, and averaged over all pixels of all images,
/// without a mask.
fn total_variation(flow: Tensor<4>, _: &Tensor<4>, border: Border) -> Tensor<1> {
    let [batch, _, height, width] = flow.dims();
    let [along_x, along_y] = sobel(flow, border);
    sum(along_x.abs() + along_y.abs()) / (8 * batch * height * width) as f64
}
