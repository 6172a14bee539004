//! The strain loss: how far the derivatives of the flow are from those of the true flow.

use burn::tensor::Tensor;

use super::inputs::sum;

/// Key of its weight in the section `loss` of a configuration, and name in logs.
pub(crate) const NAME: &str = "strain";
/// One line on what it is.
pub(crate) const DESCRIPTION: &str = "absolute error of the flow's differences between neighbouring pixels";

/// `difference` is prediction minus truth, `[batch, 2, height, width]`: the absolute differences of its right and lower neighbours, summed
/// over both directions and both components, at pixels that count (1 in `counts`, `[batch, 1, height, width]`) with their neighbour, and
/// divided by the number of pixels of all images.
pub(super) fn strain(difference: &Tensor<4>, counts: &Tensor<4>) -> Tensor<1> {
    let [batch, _, height, width] = difference.dims();
    let mut total = Tensor::zeros([1], &difference.device());
    for (dim, size) in [(3, width), (2, height)] {
        if size > 1 {
            let [after, before] = [1, 0].map(|from| difference.clone().narrow(dim, from, size - 1));
            let [count_after, count_before] = [1, 0].map(|from| counts.clone().narrow(dim, from, size - 1));
            total = total + sum((after - before).abs() * (count_after * count_before));
        }
    }
    total / (batch * height * width) as f64
}
