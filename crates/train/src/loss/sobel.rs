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
    // Differences first: of nearly equal values they are exact, and sums of them lose nothing.
    let columns = |x: &Tensor<4>| [0, 1, 2].map(|from| x.clone().narrow(3, from, width));
    let rows = |x: &Tensor<4>| [0, 1, 2].map(|from| x.clone().narrow(2, from, height));
    let smooth = |[before, at, after]: [Tensor<4>; 3]| before + at * 2.0 + after;
    let [left, _, right] = columns(&image);
    let [above, _, below] = rows(&image);
    [smooth(rows(&(right - left))), smooth(columns(&(below - above)))]
}
