//! Flow Difference Regularization (the paper's section IV-B2).

use burn::tensor::Tensor;

use super::entry::{Border, Regularizer, RegularizerValue};
use super::inputs::sum;

pub(super) const REGULARIZER: Regularizer = Regularizer {
    name: "fdr",
    title: "FDR",
    paper_weight: 0.05,
    description: "flow difference: absolute differences of neighbours on the head",
    value: RegularizerValue::OfFlow(flow_difference),
};

/// The paper's equations 11 and 12 for one prediction (`[batch, 2, height, width]`): the absolute differences to the right and
/// lower neighbours (stride 1) of pixels where `foreground` (`M_bg`, `[batch, 1, height, width]`) is 1, summed over both
/// directions and both components, and divided by the number of pixels of all images. The last column has no right neighbour,
/// the last row no lower one.
fn flow_difference(flow: Tensor<4>, foreground: &Tensor<4>, _: Border) -> Tensor<1> {
    let [batch, _, height, width] = flow.dims();
    let along = |dim: usize, size: usize| {
        let difference = flow.clone().narrow(dim, 1, size - 1) - flow.clone().narrow(dim, 0, size - 1);
        sum(difference.abs() * foreground.clone().narrow(dim, 0, size - 1))
    };
    let mut total = Tensor::zeros([1], &flow.device());
    for (dim, size) in [(3, width), (2, height)] {
        if size > 1 {
            total = total + along(dim, size);
        }
    }
    total / (batch * height * width) as f64
}
