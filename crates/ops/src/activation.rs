//! What is applied to a sum before it is stored, and the vectors that compute it.

use burn::backend::Backend;
use burn::backend::tensor::FloatTensor;

use crate::simd::{Simd, dispatch};

/// A pointwise function.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default)]
pub enum Activation {
    /// Nothing.
    #[default]
    Identity,
    /// `max(x, 0)`.
    Relu,
    /// `x (1 + erf(x / sqrt 2)) / 2`, the exact form, which PyTorch's `gelu` computes by default.
    Gelu,
    /// The hyperbolic tangent.
    Tanh,
    /// `1 / (1 + exp(-x))`.
    Sigmoid,
}

impl Activation {
    /// The definition, in f64.
    pub fn reference(self, x: f64) -> f64 {
        match self {
            Activation::Identity => x,
            Activation::Relu => x.max(0.0),
            Activation::Gelu => 0.5 * x * (1.0 + libm::erf(x / std::f64::consts::SQRT_2)),
            Activation::Tanh => x.tanh(),
            Activation::Sigmoid => 1.0 / (1.0 + (-x).exp()),
        }
    }

    /// Each lane's value; absolute error under 1e-6 (times `|x|` for Gelu).
    ///
    /// # Safety
    /// The processor has the instruction set `S`.
    #[inline(always)]
    pub(crate) unsafe fn apply<S: Simd>(self, x: S::Vector) -> S::Vector {
        // SAFETY: the caller's promise.
        unsafe {
            match self {
                Activation::Identity => x,
                Activation::Relu => S::max(x, S::splat(0.0)),
                Activation::Gelu => {
                    let half = S::mul(S::splat(0.5), x);
                    S::mul_add(half, erf::<S>(S::mul(S::splat(std::f32::consts::FRAC_1_SQRT_2), x)), half)
                }
                Activation::Tanh => tanh::<S>(x),
                Activation::Sigmoid => {
                    S::mul_add(S::splat(0.5), tanh::<S>(S::mul(S::splat(0.5), x)), S::splat(0.5))
                }
            }
        }
    }
}

/// The activation by the backend's own operations, each with its gradient.
pub(crate) fn activate_tensor<B: Backend>(x: FloatTensor<B>, activation: Activation) -> FloatTensor<B> {
    match activation {
        Activation::Identity => x,
        Activation::Relu => B::relu(x),
        Activation::Gelu => B::gelu(x),
        Activation::Tanh => B::float_tanh(x),
        Activation::Sigmoid => B::sigmoid(x),
    }
}

dispatch! {
    /// `activation(row + residual)`.
    ///
    /// # Safety
    /// `isa` is available; the residual is as long as the row.
    pub(crate) fn activate = activate_kernel(activation: Activation, residual: Option<&[f32]>, row: &mut [f32])
}

#[inline(always)]
unsafe fn activate_kernel<S: Simd>(activation: Activation, residual: Option<&[f32]>, row: &mut [f32]) {
    let mut first = 0;
    for row in row.chunks_mut(S::LANES) {
        // SAFETY: the chunk, and as many elements of the residual, are readable.
        unsafe {
            let mut x = S::load_first(row.as_ptr(), row.len());
            if let Some(residual) = residual {
                x = S::add(x, S::load_first(residual[first..].as_ptr(), row.len()));
            }
            S::store_first(row.as_mut_ptr(), activation.apply::<S>(x), row.len());
        }
        first += S::LANES;
    }
}

/// `x P(x^2) / Q(x^2)` on `[-limit, limit]`, beyond it constant.
#[inline(always)]
unsafe fn odd_rational<S: Simd>(x: S::Vector, limit: f32, p: &[f32], q: &[f32]) -> S::Vector {
    // SAFETY: the caller's promise.
    unsafe {
        let x = S::max(S::min(x, S::splat(limit)), S::splat(-limit));
        let square = S::mul(x, x);
        let polynomial = |coefficients: &[f32]| {
            let mut sum = S::splat(0.0);
            for &coefficient in coefficients.iter().rev() {
                sum = S::mul_add(sum, square, S::splat(coefficient));
            }
            sum
        };
        S::div(S::mul(x, polynomial(p)), polynomial(q))
    }
}

// Coefficients: least squares of the relative error on Chebyshev nodes, weights adapted toward the smallest maximum.

// As fitted: the first coefficient happens to be near a constant, and shorter decimals are the same f32.
#[allow(clippy::approx_constant, clippy::excessive_precision)]
#[inline(always)]
unsafe fn erf<S: Simd>(x: S::Vector) -> S::Vector {
    const P: [f32; 7] = [
        1.128_379_2,
        1.851_696_7e-1,
        5.427_476_8e-2,
        3.843_385_3e-3,
        3.779_338_1e-4,
        4.640_337e-6,
        -1.296_659e-8,
    ];
    const Q: [f32; 6] = [1.0, 4.974_357_5e-1, 1.139_111_8e-1, 1.544_373_6e-2, 1.304_061_6e-3, 6.269_159_3e-5];
    // SAFETY: the caller's promise.
    unsafe { odd_rational::<S>(x, 3.95, &P, &Q) }
}

#[allow(clippy::excessive_precision)] // as fitted
#[inline(always)]
unsafe fn tanh<S: Simd>(x: S::Vector) -> S::Vector {
    const P: [f32; 7] = [
        1.0,
        1.385_251_6e-1,
        4.089_900_8e-3,
        3.290_623_9e-5,
        4.543_530_4e-8,
        -3.134_689e-11,
        2.523_938_5e-14,
    ];
    const Q: [f32; 5] = [1.0, 4.718_585e-1, 2.804_273_4e-2, 4.342_709_4e-4, 1.662_464_9e-6];
    // SAFETY: the caller's promise.
    unsafe { odd_rational::<S>(x, 9.1, &P, &Q) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::simd::Isa;

    #[test]
    fn vectors_compute_the_definition() {
        let x: Vec<f32> =
            (-40_000..=40_000).map(|i| i as f32 * 5e-4).chain([1e4, -1e4, 1e30, -1e30]).collect();
        for activation in
            [Activation::Identity, Activation::Relu, Activation::Gelu, Activation::Tanh, Activation::Sigmoid]
        {
            for isa in Isa::available() {
                let mut out = vec![0.0; x.len()];
                // SAFETY: `isa` is available.
                unsafe { activate(isa, activation, Some(&x), &mut out) }
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
