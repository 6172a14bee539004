//! Elementary functions of vectors: the same bits on every instruction set.

use crate::Simd;

/// `1.5 * 2^23`: adding it rounds a small number to an integer, left in the low bits of the sum.
const ROUNDER: f32 = 12_582_912.0;

/// `2^x` for `|x| < 126`, to a relative error of 3e-7.
#[inline(always)]
pub fn exp2<S: Simd>(s: S, x: S::Vector) -> S::Vector {
    /// Polynomial for `2^f` on `-0.5..=0.5`, constant term first; made by `tools/exp2_coefficients.py`.
    const TERMS: [f32; 6] = [1.0, 6.931_469_4e-1, 2.402_212e-1, 5.550_713e-2, 9.675_541e-3, 1.327_647_2e-3];
    let rounder = s.splat(ROUNDER);
    let rounded = s.add(x, rounder);
    let fraction = s.sub(x, s.sub(rounded, rounder));
    let mut power = s.splat(TERMS[5]);
    for &term in TERMS[..5].iter().rev() {
        power = s.mul_add(power, fraction, s.splat(term));
    }
    s.scale_by_power_of_two(power, rounded)
}

/// `exp(x)` for `x` of at most 0, relative error under 3e-7; under -87 it is `exp(-87)`, which a sum does not notice. NaN
/// stays NaN.
#[inline(always)]
pub fn exp<S: Simd>(s: S, x: S::Vector) -> S::Vector {
    /// Least squares of the relative error on Chebyshev nodes of half a power of two to each side.
    const TERMS: [f32; 6] = [1.0, 1.0, 0.5, 1.0 / 6.0, 1.0 / 24.0, 1.0 / 120.0];
    let x = s.max(s.splat(-87.0), x);
    // 0 where `x` is NaN: the power of two is added to the exponent bits, and could make a number of a NaN.
    let number = s.min(x, s.splat(0.0));
    let rounded = s.mul_add(number, s.splat(std::f32::consts::LOG2_E), s.splat(ROUNDER));
    let n = s.sub(rounded, s.splat(ROUNDER));
    // ln 2 in two parts: the first times n is exact.
    let r = s.mul_add(n, s.splat(-355.0 / 512.0), x);
    let r = s.mul_add(n, s.splat(2.121_944_4e-4), r);
    let mut sum = s.splat(1.0 / 720.0);
    for &term in TERMS.iter().rev() {
        sum = s.mul_add(sum, r, s.splat(term));
    }
    s.scale_by_power_of_two(sum, rounded)
}

/// `x P(x^2) / Q(x^2)` on `[-limit, limit]`, beyond it constant.
#[inline(always)]
fn odd_rational<S: Simd>(s: S, x: S::Vector, limit: f32, p: &[f32], q: &[f32]) -> S::Vector {
    let x = s.max(s.splat(-limit), s.min(s.splat(limit), x));
    let square = s.mul(x, x);
    let polynomial = |coefficients: &[f32]| {
        let mut sum = s.splat(0.0);
        for &coefficient in coefficients.iter().rev() {
            sum = s.mul_add(sum, square, s.splat(coefficient));
        }
        sum
    };
    s.div(s.mul(x, polynomial(p)), polynomial(q))
}

// Coefficients: least squares of the relative error on Chebyshev nodes, weights adapted toward the smallest maximum.

#[expect(clippy::approx_constant, reason = "the first coefficient happens to be near one")]
#[expect(clippy::excessive_precision, reason = "as fitted")]
#[inline(always)]
pub(crate) fn erf<S: Simd>(s: S, x: S::Vector) -> S::Vector {
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
    odd_rational(s, x, 3.95, &P, &Q)
}

#[expect(clippy::excessive_precision, reason = "as fitted")]
#[inline(always)]
pub(crate) fn tanh<S: Simd>(s: S, x: S::Vector) -> S::Vector {
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
    odd_rational(s, x, 9.1, &P, &Q)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Isa, Portable, dispatch};

    dispatch! {
        fn exponentials = exponentials_kernel(x: &mut [f32])
    }

    fn exponentials_kernel<S: Simd>(s: S, x: &mut [f32]) {
        for x in x.chunks_exact_mut(S::LANES) {
            let powers = exp(s, s.read(x));
            s.write(powers, x);
        }
    }

    #[test]
    fn exp_is_right_to_three_in_ten_million_and_leaves_what_is_not_a_number() {
        for isa in Isa::to_test() {
            let x: Vec<f32> = (0..8000).map(|i| i as f32 * -0.01).collect();
            let mut found = x.clone();
            exponentials(isa, &mut found);
            for (x, found) in x.iter().zip(found) {
                let error = (f64::from(found) / f64::from(*x).exp() - 1.0).abs();
                assert!(error < 3e-7, "{isa:?}: exp({x}): relative error {error:e}");
            }
            // Payloads of every bit that the power of two could be added to.
            let mut nans: Vec<f32> = (0..64).map(|i| f32::from_bits(0x7FC0_0000 | 1 << (i % 22))).collect();
            exponentials(isa, &mut nans);
            assert!(nans.iter().all(|x| x.is_nan()), "{isa:?}");
        }
    }

    #[test]
    fn exp2_is_right_to_three_in_ten_million_and_exact_at_integers() {
        let exp2 = |x: f32| exp2(Portable, Portable.splat(x))[0];
        for i in -20_000..=0 {
            let x = i as f32 * 0.001;
            let truth = libm::exp2(f64::from(x));
            let error = (f64::from(exp2(x)) / truth - 1.0).abs();
            assert!(error < 3e-7, "2^{x}: relative error {error:e}");
        }
        for n in -20..=0 {
            assert_eq!(exp2(n as f32), libm::exp2f(n as f32));
        }
    }
}
