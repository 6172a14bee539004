//! Common part of MIGAR and IGVAR (the paper's section IV-B3): total variation inside a mask, weighted by the first frame.

use burn::tensor::Tensor;

use super::config::LossConfig;
use super::entry::{Border, MaskReading};
use super::inputs::sum;
use super::sobel::sobel;

/// `G` of the paper's equation 13: the magnitude of the standard Sobel gradient of a frame `[batch, 3, height, width]`, averaged
/// over the colour channels, `[batch, 1, height, width]`.
fn gradient_magnitude(frame: Tensor<4>, border: Border) -> Tensor<4> {
    let [along_x, along_y] = sobel(frame, border);
    (along_x.square() + along_y.square()).sqrt().mean_dim(1)
}

/// `w = base^-G` of the paper's equation 15 as `exp(-G ln base)`, from the logarithm of the base (`[batch, 1, 1, 1]`): with
/// frames in 0..255, MIGAR's base overflows `f32` if the mean of `G` exceeds 88. Weights below 1e-45 become zero.
fn weights(gradient: Tensor<4>, log_base: Tensor<4>) -> Tensor<4> {
    (-gradient * log_base).exp()
}

/// `M_total` of the paper's equation 16 from `M_bg`, both `[batch, 1, height, width]` with zeros and ones.
pub(super) fn total_mask(foreground: Tensor<4>, reading: MaskReading, border: Border) -> Tensor<4> {
    let [along_x, along_y] = sobel(foreground.clone(), border);
    let kept = match reading {
        MaskReading::Interior => along_x.equal_elem(0.0).bool_and(along_y.equal_elem(0.0)),
        MaskReading::Literal => along_x.greater_elem(0.0).bool_and(along_y.greater_elem(0.0)),
    };
    foreground * kept.float()
}

/// `R_wpp(u) + R_wpp(v)` of the paper's equation 17 for one prediction (`[batch, 2, height, width]`): the flow is set to zero
/// outside `mask`; its absolute standard Sobel derivatives are multiplied by `weights`, summed over both directions and both
/// components, and averaged over all pixels of all images. `mask` and `weights` are `[batch, 1, height, width]`.
pub(super) fn weighted_variation(
    flow: Tensor<4>,
    mask: Tensor<4>,
    weights: Tensor<4>,
    border: Border,
) -> Tensor<1> {
    let [batch, _, height, width] = flow.dims();
    let [along_x, along_y] = sobel(flow * mask, border);
    sum((along_x.abs() + along_y.abs()) * weights) / (batch * height * width) as f64
}

/// Weights of the pixels, `[batch, 1, height, width]`, and the logarithm of their base, `[batch, 1, 1, 1]`.
pub(super) fn pixel_weights(
    log_base: fn(Tensor<4>, &Tensor<4>) -> Tensor<4>,
    config: &LossConfig,
    first_frame: &Tensor<4>,
    foreground: &Tensor<4>,
) -> (Tensor<4>, Tensor<4>) {
    let gradient = gradient_magnitude(first_frame.clone(), config.border) * config.image_max;
    let log_base = log_base(gradient.clone(), foreground);
    (weights(gradient, log_base.clone()), log_base)
}
