//! Activations and their derivatives composed of a backend's own operations.

use std::f64::consts::{FRAC_1_SQRT_2, FRAC_2_SQRT_PI};

use burn::backend::Backend;
use burn::backend::tensor::FloatTensor;

use super::Activation;
use super::tensor::{Activate, ActivatedSum};
use crate::operation::{Backprop, Composition};

impl Composition<2> for ActivatedSum {
    fn composed<B: Backend>(&self, [a, b]: [FloatTensor<B>; 2]) -> Vec<FloatTensor<B>> {
        vec![activate_tensor::<B>(B::float_add(a, b), self.0)]
    }

    fn composed_backward<B: Backend>(&self, back: Backprop<FloatTensor<B>>) -> [Option<FloatTensor<B>>; 2] {
        let ([], grad) = back.into_parts();
        [Some(grad.clone()), Some(grad)]
    }
}

impl Composition<1> for Activate {
    fn composed<B: Backend>(&self, [x]: [FloatTensor<B>; 1]) -> Vec<FloatTensor<B>> {
        vec![activate_tensor::<B>(x, self.0)]
    }

    fn composed_backward<B: Backend>(&self, back: Backprop<FloatTensor<B>>) -> [Option<FloatTensor<B>>; 1] {
        let ([kept], grad) = back.into_parts();
        [Some(activate_tensor_backward::<B>(grad, kept, self.0))]
    }
}

pub(crate) fn activate_tensor<B: Backend>(x: FloatTensor<B>, activation: Activation) -> FloatTensor<B> {
    match activation {
        Activation::Identity => x,
        Activation::Relu => B::relu(x),
        Activation::LeakyRelu => B::leaky_relu(x, Activation::LEAK.into()),
        Activation::Gelu => B::gelu(x),
        Activation::Tanh => B::float_tanh(x),
        Activation::Sigmoid => B::sigmoid(x),
    }
}

/// Gradient of the activation's input; `kept` holds the values that [`Activation::keeps`] names.
pub(super) fn activate_tensor_backward<B: Backend>(
    grad: FloatTensor<B>,
    kept: FloatTensor<B>,
    activation: Activation,
) -> FloatTensor<B> {
    match activation {
        Activation::Identity => grad,
        Activation::Relu => B::relu_backward(kept, grad),
        Activation::LeakyRelu => {
            let everywhere = B::float_mul_scalar(grad.clone(), Activation::LEAK.into());
            let above_zero = B::float_mul_scalar(grad, (1.0 - Activation::LEAK).into());
            B::float_add(everywhere, B::relu_backward(kept, above_zero))
        }
        Activation::Gelu => {
            // Burn's own derivative is that of the tanh approximation.
            let half_squares = B::float_mul(kept.clone(), kept.clone());
            let density = B::float_exp(B::float_mul_scalar(half_squares, (-0.5).into()));
            let density = B::float_mul_scalar(density, (0.5 * FRAC_2_SQRT_PI * FRAC_1_SQRT_2).into());
            let erf = B::float_erf(B::float_mul_scalar(kept.clone(), FRAC_1_SQRT_2.into()));
            let cumulative = B::float_mul_scalar(B::float_add_scalar(erf, 1.0.into()), 0.5.into());
            B::float_mul(grad, B::float_add(cumulative, B::float_mul(kept, density)))
        }
        Activation::Tanh => {
            let squares = B::float_mul(kept.clone(), kept);
            B::float_mul(grad, B::float_add_scalar(B::float_neg(squares), 1.0.into()))
        }
        Activation::Sigmoid => B::sigmoid_backward(kept, grad),
    }
}
