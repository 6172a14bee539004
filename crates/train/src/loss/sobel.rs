//! The Sobel operator on tensors.

use burn::tensor::Tensor;
use burn::tensor::ops::PadMode;

use super::entry::Border;

/// The standard 3x3 Sobel derivatives of each channel of an image `[batch, channels, height, width]` along x and along y, each
/// of the same shape. They are not normalised: 8 times the derivative per pixel.
pub(super) fn sobel(image: Tensor<4>, border: Border) -> [Tensor<4>; 2] {
    let [_, _, height, width] = image.dims();
    let outside = match border {
        Border::Replicate => PadMode::Edge,
        Border::Zero => PadMode::Constant(0.0),
    };
    let image = image.pad((1, 1, 1, 1), outside);
    // Differences before sums: differences of nearly equal values are exact.
    let columns = |x: &Tensor<4>| [0, 1, 2].map(|from| x.clone().narrow(3, from, width));
    let rows = |x: &Tensor<4>| [0, 1, 2].map(|from| x.clone().narrow(2, from, height));
    let smooth = |[before, at, after]: [Tensor<4>; 3]| before + at * 2.0 + after;
    let [left, _, right] = columns(&image);
    let [above, _, below] = rows(&image);
    [smooth(rows(&(right - left))), smooth(columns(&(below - above)))]
}
