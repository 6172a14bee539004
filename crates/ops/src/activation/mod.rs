//! What is applied to a sum before it is stored, and the vectors that compute it.

use burn::backend::Backend;
use burn::backend::tensor::FloatTensor;
use rayon::prelude::*;

use crate::shared_mut::SharedMut;
use crate::simd::{Isa, Simd, dispatch};

pub mod tensor;

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

    /// The derivative, in f64; that of Relu at 0 is 0, as in PyTorch.
    pub fn reference_derivative(self, x: f64) -> f64 {
        match self {
            Activation::Identity => 1.0,
            Activation::Relu => f64::from(u8::from(x > 0.0)),
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

    /// What its derivative is computed from.
    pub(crate) fn keeps(self) -> Keeps {
        match self {
            Activation::Identity => Keeps::Nothing,
            Activation::Relu | Activation::Tanh | Activation::Sigmoid => Keeps::Output,
            Activation::Gelu => Keeps::Sum,
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
                Activation::Relu => S::max(S::splat(0.0), x),
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

    /// Each lane's gradient times the derivative, whose absolute error is under 1e-6; `kept` is what [`Self::keeps`] says.
    ///
    /// # Safety
    /// The processor has the instruction set `S`.
    #[inline(always)]
    unsafe fn backward<S: Simd>(self, grad: S::Vector, kept: S::Vector) -> S::Vector {
        // SAFETY: the caller's promise.
        unsafe {
            let one = S::splat(1.0);
            match self {
                Activation::Identity => grad,
                Activation::Relu => S::where_positive(kept, grad),
                Activation::Gelu => {
                    let half = S::splat(0.5);
                    let sum = S::mul(S::splat(std::f32::consts::FRAC_1_SQRT_2), kept);
                    let cumulative = S::mul_add(half, erf::<S>(sum), half);
                    let density =
                        S::mul(S::splat(DENSITY_AT_ZERO), exp::<S>(S::mul(S::splat(-1.0), S::mul(sum, sum))));
                    S::mul(grad, S::mul_add(kept, density, cumulative))
                }
                Activation::Tanh => S::mul(grad, S::sub(one, S::mul(kept, kept))),
                Activation::Sigmoid => S::mul(grad, S::mul(kept, S::sub(one, kept))),
            }
        }
    }
}

/// Of the normal distribution: `1 / sqrt(2 pi)`.
const DENSITY_AT_ZERO: f32 = 0.398_942_3;
/// Elements of a piece of work.
const PIECE: usize = 16 << 10;

/// What the derivative of an activation is computed from.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Keeps {
    Nothing,
    /// What the activation gave.
    Output,
    /// What it was given.
    Sum,
}

/// The activation by the backend's own operations.
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

/// `activation(sums + residual)`. Panics when there are not as many of one as of the other.
pub(crate) fn activated(activation: Activation, sums: &[f32], residual: Option<&[f32]>) -> Vec<f32> {
    let isa = Isa::best();
    assert!(residual.is_none_or(|residual| residual.len() == sums.len()), "addends of {activation:?}");
    let fill = |target: SharedMut| {
        sums.par_chunks(PIECE).enumerate().for_each(|(number, sums)| {
            let first = number * PIECE;
            let residual = residual.map(|residual| &residual[first..first + sums.len()]);
            // SAFETY: inside, and this task's alone; `isa` is available.
            unsafe {
                let out = std::slice::from_raw_parts_mut(target.at(first), sums.len());
                out.copy_from_slice(sums);
                activate(isa, activation, residual, out);
            }
        });
    };
    // SAFETY: the pieces cover everything.
    unsafe { SharedMut::fill_new(sums.len(), fill) }
}

/// Turns the gradients of what an activation gave into those of what it was given; `kept` is what
/// [`Activation::keeps`] says. Panics when there are not as many of one as of the other.
pub(crate) fn activation_backward(activation: Activation, kept: &[f32], grad: &mut [f32]) {
    let isa = Isa::best();
    assert_eq!(kept.len(), grad.len(), "gradients of {activation:?}");
    grad.par_chunks_mut(PIECE).zip(kept.par_chunks(PIECE)).for_each(|(grad, kept)| {
        // SAFETY: `isa` is available; both are of one length.
        unsafe { backward(isa, activation, kept, grad) }
    });
}

dispatch! {
    /// See [`activation_backward`].
    ///
    /// # Safety
    /// `isa` is available; `kept` is as long as `grad`.
    fn backward = backward_kernel(activation: Activation, kept: &[f32], grad: &mut [f32])
}

#[inline(always)]
unsafe fn backward_kernel<S: Simd>(activation: Activation, kept: &[f32], grad: &mut [f32]) {
    for (grad, kept) in grad.chunks_mut(S::LANES).zip(kept.chunks(S::LANES)) {
        // SAFETY: the chunks are readable and writable.
        unsafe {
            let kept = S::load_first(kept.as_ptr(), kept.len());
            let values = S::load_first(grad.as_ptr(), grad.len());
            S::store_first(grad.as_mut_ptr(), activation.backward::<S>(values, kept), grad.len());
        }
    }
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
        let x = S::max(S::splat(-limit), S::min(S::splat(limit), x));
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

/// `exp(x)` for `x` of at most 0, relative error under 2e-7; under -87 it is `exp(-87)`, which a sum does not notice.
#[inline(always)]
pub(crate) unsafe fn exp<S: Simd>(x: S::Vector) -> S::Vector {
    /// Added to a small number, it leaves the nearest integer in the lowest bits.
    const ROUND: f32 = 12_582_912.0;
    /// Least squares of the relative error on Chebyshev nodes of half a power of two to each side.
    const TERMS: [f32; 6] = [1.0, 1.0, 0.5, 1.0 / 6.0, 1.0 / 24.0, 1.0 / 120.0];
    // SAFETY: the caller's promise.
    unsafe {
        let x = S::max(x, S::splat(-87.0));
        let t = S::mul_add(x, S::splat(std::f32::consts::LOG2_E), S::splat(ROUND));
        let n = S::sub(t, S::splat(ROUND));
        // ln 2 in two parts: the first times n is exact.
        let r = S::mul_add(n, S::splat(-355.0 / 512.0), x);
        let r = S::mul_add(n, S::splat(2.121_944_4e-4), r);
        let mut sum = S::splat(1.0 / 720.0);
        for &term in TERMS.iter().rev() {
            sum = S::mul_add(sum, r, S::splat(term));
        }
        S::times_power_of_two(sum, t)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::simd::Isa;

    /// Or a network that has gone wrong would look well.
    #[test]
    fn what_is_not_a_number_stays_so() {
        for activation in
            [Activation::Identity, Activation::Relu, Activation::Gelu, Activation::Tanh, Activation::Sigmoid]
        {
            for isa in Isa::available() {
                let mut out = [f32::NAN; 19];
                // SAFETY: `isa` is available.
                unsafe { activate(isa, activation, None, &mut out) }
                assert!(out.iter().all(|x| x.is_nan()), "{activation:?} {isa:?}");
            }
        }
    }

    #[test]
    fn vectors_compute_the_derivative() {
        let x: Vec<f32> = (-20_000..=20_000).map(|i| i as f32 * 1e-3).chain([1e4, -1e4]).collect();
        for activation in
            [Activation::Identity, Activation::Relu, Activation::Gelu, Activation::Tanh, Activation::Sigmoid]
        {
            let kept: Vec<f32> = match activation.keeps() {
                Keeps::Output => x.iter().map(|&x| activation.reference(f64::from(x)) as f32).collect(),
                Keeps::Sum | Keeps::Nothing => x.clone(),
            };
            for isa in Isa::available() {
                let mut grad = vec![-2.0; x.len()];
                // SAFETY: `isa` is available.
                unsafe { backward(isa, activation, &kept, &mut grad) }
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
        for activation in [Activation::Relu, Activation::Gelu, Activation::Tanh, Activation::Sigmoid] {
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
