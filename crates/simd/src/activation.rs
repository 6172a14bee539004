//! Activation functions applied to a sum before it is stored, and their derivatives.

use rayon::prelude::*;

use crate::functions::{erf, exp, tanh};
use crate::{Isa, Simd, copy_pieces, dispatch};

/// A function applied to each element.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default)]
pub enum Activation {
    /// The identity.
    #[default]
    Identity,
    /// `max(x, 0)`.
    Relu,
    /// `max(x, 0.1 x)`: PyTorch's `LeakyReLU(0.1)`, which FlowNet and its successors use.
    LeakyRelu,
    /// `x (1 + erf(x / sqrt 2)) / 2`, the exact form, which PyTorch's `gelu` computes by default.
    Gelu,
    /// The hyperbolic tangent.
    Tanh,
    /// `1 / (1 + exp(-x))`.
    Sigmoid,
}

impl Activation {
    /// Slope of LeakyRelu below zero.
    pub const LEAK: f32 = 0.1;

    /// The activation of `x` in f64: the definition.
    pub fn reference(self, x: f64) -> f64 {
        match self {
            Activation::Identity => x,
            Activation::Relu if x < 0.0 => 0.0,
            Activation::Relu => x,
            Activation::LeakyRelu if x < 0.0 => f64::from(Self::LEAK) * x,
            Activation::LeakyRelu => x,
            Activation::Gelu => 0.5 * x * (1.0 + libm::erf(x / std::f64::consts::SQRT_2)),
            Activation::Tanh => x.tanh(),
            Activation::Sigmoid => 1.0 / (1.0 + (-x).exp()),
        }
    }

    /// The derivative at `x` in f64; at 0 that of Relu is 0 and that of LeakyRelu 0.1, as in PyTorch.
    pub fn reference_derivative(self, x: f64) -> f64 {
        match self {
            Activation::Identity => 1.0,
            Activation::Relu => f64::from(u8::from(x > 0.0)),
            Activation::LeakyRelu if x > 0.0 => 1.0,
            Activation::LeakyRelu => f64::from(Self::LEAK),
            Activation::Gelu => {
                let cumulative = 0.5 * (1.0 + libm::erf(x / std::f64::consts::SQRT_2));
                let density = (-0.5 * x * x).exp() / (2.0 * std::f64::consts::PI).sqrt();
                cumulative + x * density
            }
            Activation::Tanh => 1.0 - x.tanh().powi(2),
            Activation::Sigmoid => {
                let y = self.reference(x);
                y * (1.0 - y)
            }
        }
    }

    /// Which values the derivative needs.
    pub fn keeps(self) -> Keeps {
        match self {
            Activation::Identity => Keeps::Nothing,
            Activation::Relu | Activation::LeakyRelu | Activation::Tanh | Activation::Sigmoid => {
                Keeps::Output
            }
            Activation::Gelu => Keeps::Sum,
        }
    }

    /// The activation of each lane; absolute error under 1e-6 (times `|x|` for Gelu).
    #[inline(always)]
    pub fn apply<S: Simd>(self, s: S, x: S::Vector) -> S::Vector {
        match self {
            Activation::Identity => x,
            Activation::Relu => s.max(s.splat(0.0), x),
            Activation::LeakyRelu => s.max(s.mul(s.splat(Self::LEAK), x), x),
            Activation::Gelu => {
                let half = s.mul(s.splat(0.5), x);
                s.mul_add(half, erf(s, s.mul(s.splat(std::f32::consts::FRAC_1_SQRT_2), x)), half)
            }
            Activation::Tanh => tanh(s, x),
            Activation::Sigmoid => s.mul_add(s.splat(0.5), tanh(s, s.mul(s.splat(0.5), x)), s.splat(0.5)),
        }
    }

    /// The gradient of each lane times the derivative (absolute error under 1e-6); `kept` holds the values that
    /// [`Self::keeps`] names.
    #[inline(always)]
    fn backward<S: Simd>(self, s: S, grad: S::Vector, kept: S::Vector) -> S::Vector {
        let one = s.splat(1.0);
        match self {
            Activation::Identity => grad,
            Activation::Relu => s.select(s.greater(kept, s.splat(0.0)), grad, s.splat(0.0)),
            Activation::LeakyRelu => {
                s.select(s.greater(kept, s.splat(0.0)), grad, s.mul(s.splat(Self::LEAK), grad))
            }
            Activation::Gelu => {
                let half = s.splat(0.5);
                let sum = s.mul(s.splat(std::f32::consts::FRAC_1_SQRT_2), kept);
                let cumulative = s.mul_add(half, erf(s, sum), half);
                let density = s.mul(s.splat(DENSITY_AT_ZERO), exp(s, s.mul(s.splat(-1.0), s.mul(sum, sum))));
                s.mul(grad, s.mul_add(kept, density, cumulative))
            }
            Activation::Tanh => s.mul(grad, s.sub(one, s.mul(kept, kept))),
            Activation::Sigmoid => s.mul(grad, s.mul(kept, s.sub(one, kept))),
        }
    }
}

/// The density of the normal distribution at 0: `1 / sqrt(2 pi)`.
const DENSITY_AT_ZERO: f32 = 0.398_942_3;
/// Smaller gradients count as zero, as they change no weight. They would become subnormal numbers in the layers before, which many
/// processors multiply a hundred times slower.
const LEAST_GRADIENT: f32 = 1e-24;
/// Elements that one task handles.
const PIECE: usize = 16 << 10;

/// The values from which the derivative of an activation is computed.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Keeps {
    /// None: the derivative is constant.
    Nothing,
    /// The output of the activation.
    Output,
    /// The input of the activation.
    Sum,
}

dispatch! {
    /// `row = activation(row + residual)`. Panics when the residual is shorter than the row.
    pub fn activate = activate_kernel(activation: Activation, residual: Option<&[f32]>, row: &mut [f32])
}

#[inline(always)]
fn activate_kernel<S: Simd>(s: S, activation: Activation, residual: Option<&[f32]>, row: &mut [f32]) {
    assert!(residual.is_none_or(|residual| residual.len() >= row.len()), "addends of {activation:?}");
    let mut first = 0;
    for row in row.chunks_mut(S::LANES) {
        // SAFETY: the chunk lies in the row, and the residual is at least as long as the row.
        unsafe {
            let mut x = s.load_first(row.as_ptr(), row.len());
            if let Some(residual) = residual {
                x = s.add(x, s.load_first(residual[first..].as_ptr(), row.len()));
            }
            s.store_first(row.as_mut_ptr(), activation.apply(s, x), row.len());
        }
        first += S::LANES;
    }
}

/// `sums = activation(sums + residual)`. Panics when the lengths differ.
pub fn activated(activation: Activation, sums: &[f32], residual: Option<&[f32]>) -> Vec<f32> {
    let isa = Isa::best();
    assert!(residual.is_none_or(|residual| residual.len() == sums.len()), "addends of {activation:?}");
    copy_pieces(sums, PIECE, |number, out| {
        activate(isa, activation, residual.map(|residual| &residual[number * PIECE..]), out);
    })
}

/// Multiplies gradients of an activation's outputs by its derivative; `kept` holds the values that
/// [`Activation::keeps`] names. Products of a size below 1e-24 become zeros. Panics when the lengths differ.
pub fn activation_backward(activation: Activation, kept: &[f32], grad: &mut [f32]) {
    let isa = Isa::best();
    assert_eq!(kept.len(), grad.len(), "gradients of {activation:?}");
    let pieces = grad.par_chunks_mut(PIECE).zip(kept.par_chunks(PIECE));
    pieces.for_each(|(grad, kept)| backward(isa, activation, kept, grad));
}

dispatch! {
    /// One piece of [`activation_backward`].
    fn backward = backward_kernel(activation: Activation, kept: &[f32], grad: &mut [f32])
}

#[inline(always)]
fn backward_kernel<S: Simd>(s: S, activation: Activation, kept: &[f32], grad: &mut [f32]) {
    assert_eq!(kept.len(), grad.len());
    for (grad, kept) in grad.chunks_mut(S::LANES).zip(kept.chunks(S::LANES)) {
        // SAFETY: both chunks have the same length.
        unsafe {
            let kept = s.load_first(kept.as_ptr(), kept.len());
            let values = s.load_first(grad.as_ptr(), grad.len());
            let product = activation.backward(s, values, kept);
            // NaN is not small.
            let small = s.greater(s.negative(product), s.splat(-LEAST_GRADIENT));
            let product = s.select(small, s.splat(0.0), product);
            s.store_first(grad.as_mut_ptr(), product, grad.len());
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const ALL: [Activation; 6] = [
        Activation::Identity,
        Activation::Relu,
        Activation::LeakyRelu,
        Activation::Gelu,
        Activation::Tanh,
        Activation::Sigmoid,
    ];

    /// Otherwise a diverged network would look fine.
    #[test]
    fn nan_stays_nan() {
        for activation in ALL {
            for isa in Isa::to_test() {
                let mut out = [f32::NAN; 19];
                activate(isa, activation, None, &mut out);
                assert!(out.iter().all(|x| x.is_nan()), "{activation:?} {isa:?}");
                assert!(activation.reference(f64::NAN).is_nan(), "{activation:?}");
            }
        }
    }

    #[test]
    fn tiny_gradients_are_zeros_and_nan_stays() {
        for isa in Isa::to_test() {
            let mut grad = [-1e-20, -1e-25, 1e-30, f32::NAN, f32::MIN_POSITIVE / 4.0];
            backward(isa, Activation::Relu, &[1.0; 5], &mut grad);
            assert!(grad[3].is_nan(), "{isa:?}");
            assert_eq!([grad[0], grad[1], grad[2], grad[4]], [-1e-20, 0.0, 0.0, 0.0], "{isa:?}");
        }
    }

    #[test]
    fn vectors_compute_the_derivative() {
        let x: Vec<f32> = (-20_000..=20_000).map(|i| i as f32 * 1e-3).chain([1e4, -1e4]).collect();
        for activation in ALL {
            let kept: Vec<f32> = match activation.keeps() {
                Keeps::Output => x.iter().map(|&x| activation.reference(f64::from(x)) as f32).collect(),
                Keeps::Sum | Keeps::Nothing => x.clone(),
            };
            for isa in Isa::to_test() {
                let mut grad = vec![-2.0; x.len()];
                backward(isa, activation, &kept, &mut grad);
                for (&x, &found) in x.iter().zip(&grad) {
                    let expected = -2.0 * activation.reference_derivative(f64::from(x));
                    assert!(
                        (f64::from(found) - expected).abs() < 2e-6,
                        "{activation:?} {isa:?} ({x}): {found} for {expected}"
                    );
                }
            }
        }
    }

    #[test]
    fn the_derivative_is_that_of_the_function() {
        for activation in ALL {
            for x in [-3.1, -0.7, -1e-3, 0.2, 1.9, 6.0] {
                let step = 1e-5;
                let slope = (activation.reference(x + step) - activation.reference(x - step)) / (2.0 * step);
                assert!((activation.reference_derivative(x) - slope).abs() < 1e-8, "{activation:?} ({x})");
            }
        }
    }

    #[test]
    fn vectors_compute_the_definition() {
        let x: Vec<f32> =
            (-40_000..=40_000).map(|i| i as f32 * 5e-4).chain([1e4, -1e4, 1e30, -1e30]).collect();
        for activation in ALL {
            for isa in Isa::to_test() {
                let mut out = vec![0.0; x.len()];
                activate(isa, activation, Some(&x), &mut out);
                for (&x, &found) in x.iter().zip(&out) {
                    let expected = activation.reference(f64::from(x));
                    let allowed = 1e-6 * if activation == Activation::Gelu { x.abs().max(1.0) } else { 1.0 };
                    let error = (f64::from(found) - expected).abs();
                    assert!(
                        error <= f64::from(allowed).max(1e-7 * expected.abs()),
                        "{activation:?} {isa:?} ({x}): {found} for {expected}"
                    );
                }
            }
        }
    }
}
