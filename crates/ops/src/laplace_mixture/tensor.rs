//! On tensors: [`negative_log_likelihood`] with its gradients.

use burn::tensor::Tensor;

use super::LogScaleRange;
use crate::flex::CpuTensor;
use crate::operation::{Backprop, Operation, apply};

/// Of difference, log weights and log scales.
#[derive(Debug, Clone)]
pub(super) struct NegativeLogLikelihood(pub(super) LogScaleRange);

impl Operation<3> for NegativeLogLikelihood {
    fn cpu(&self, [difference, log_weights, log_scales]: [CpuTensor; 3]) -> Vec<CpuTensor> {
        let pixels = difference.map_shape().pixels();
        let values = super::negative_log_likelihood(
            difference.slice(),
            log_weights.slice(),
            log_scales.slice(),
            pixels,
            self.0,
        );
        vec![difference.like(values)]
    }

    fn cpu_backward(&self, back: Backprop<CpuTensor>) -> [Option<CpuTensor>; 3] {
        let ([difference, log_weights, log_scales], grad) = back.into_parts();
        let pixels = difference.map_shape().pixels();
        super::negative_log_likelihood_backward(
            difference.slice(),
            log_weights.slice(),
            log_scales.slice(),
            grad.slice(),
            pixels,
            self.0,
        )
        .map(|values| Some(difference.like(values)))
    }
}

/// `-ln p(difference)` for each component, see [`super::negative_log_likelihood`]; all `[batch, 2, height, width]`. Panics when the sizes do not
/// fit.
pub fn negative_log_likelihood(
    difference: Tensor<4>,
    log_weights: Tensor<4>,
    log_scales: Tensor<4>,
    range: LogScaleRange,
) -> Tensor<4> {
    let dims @ [_, channels, ..] = difference.dims();
    assert_eq!(channels, 2, "negative_log_likelihood: two components");
    assert_eq!([log_weights.dims(), log_scales.dims()], [dims; 2], "negative_log_likelihood: two of each");
    let inputs = [difference, log_weights, log_scales].map(Tensor::into_dispatch);
    apply(NegativeLogLikelihood(range), inputs)
}
