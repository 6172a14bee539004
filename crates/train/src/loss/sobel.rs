//! The Sobel operator on tensors.

use burn::tensor::Tensor;
use burn::tensor::ops::PadMode;

use super::Border;

/// The standard 3x3 Sobel derivatives of each channel along x and along y, of the image's size. They are not normalised: 8
/// times the derivative by the pixel.
pub(super) fn sobel(image: Tensor<4>, border: Border) -> [Tensor<4>; 2] {
    let [_, _, height, width] = image.dims();
    let outside = match border {
        Border::Replicate => PadMode::Edge,
        Border::Zero => PadMode::Constant(0.0),
    };
    let image = image.pad((1, 1, 1, 1), outside);
    let [left, centre, right] = [0, 1, 2].map(|from| image.clone().narrow(3, from, width));
    let rows = |x: &Tensor<4>| [0, 1, 2].map(|from| x.clone().narrow(2, from, height));
    let [above, beside, below] = rows(&(right.clone() - left.clone()));
    let along_x = above + beside * 2.0 + below;
    let [above, _, below] = rows(&(left + centre * 2.0 + right));
    [along_x, below - above]
}
