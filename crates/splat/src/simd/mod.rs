//! Sixteen pixels side by side, on whatever the processor has. Every instruction set gives the same bits: each
//! operation is rounded once, multiply-adds are fused everywhere, and nothing is reordered.

#[cfg(target_arch = "x86_64")]
mod avx2;
#[cfg(target_arch = "x86_64")]
mod avx512;
mod portable;

#[cfg(target_arch = "x86_64")]
pub(crate) use avx2::Avx2;
#[cfg(target_arch = "x86_64")]
pub(crate) use avx512::Avx512;
pub(crate) use portable::Portable;

/// Lanes of a vector: the width of a tile.
pub(crate) const LANES: usize = 16;

/// Sixteen numbers in memory, aligned for whole-vector access.
#[derive(Debug, Clone, Copy, PartialEq)]
#[repr(C, align(64))]
pub(crate) struct Row(pub [f32; LANES]);

impl Row {
    /// `0, 1, ... 15`.
    pub const INDEX: Self = Self([0., 1., 2., 3., 4., 5., 6., 7., 8., 9., 10., 11., 12., 13., 14., 15.]);
}

/// An instruction set, as a value that exists only where the processor has it.
pub(crate) trait InstructionSet: Copy + Send + Sync {
    /// Sixteen `f32`.
    type Vector: Copy;
    /// Sixteen truth values.
    type Mask: Copy;

    /// Asks for the cache line at `item`, which will be used soon.
    fn prefetch<T>(self, item: &T);

    /// The same value in every lane.
    fn splat(self, value: f32) -> Self::Vector;
    fn load(self, row: &Row) -> Self::Vector;
    fn store(self, vector: Self::Vector, row: &mut Row);

    fn add(self, a: Self::Vector, b: Self::Vector) -> Self::Vector;
    fn sub(self, a: Self::Vector, b: Self::Vector) -> Self::Vector;
    fn mul(self, a: Self::Vector, b: Self::Vector) -> Self::Vector;
    /// `a * b + c`, rounded once.
    fn mul_add(self, a: Self::Vector, b: Self::Vector, c: Self::Vector) -> Self::Vector;
    /// `c - a * b`, rounded once.
    fn neg_mul_add(self, a: Self::Vector, b: Self::Vector, c: Self::Vector) -> Self::Vector;
    /// The smaller; `b` when either is NaN.
    fn min(self, a: Self::Vector, b: Self::Vector) -> Self::Vector;
    /// The larger; `b` when either is NaN.
    fn max(self, a: Self::Vector, b: Self::Vector) -> Self::Vector;
    /// `-|a|`.
    fn negative(self, a: Self::Vector) -> Self::Vector;
    /// `a * 2^n`, where `rounded` is `n + ROUNDER`, while the result is a normal number.
    fn scale(self, a: Self::Vector, rounded: Self::Vector) -> Self::Vector;

    /// `a >= b`; false when either is NaN.
    fn at_least(self, a: Self::Vector, b: Self::Vector) -> Self::Mask;
    fn and(self, a: Self::Mask, b: Self::Mask) -> Self::Mask;
    /// `a` and not `b`.
    fn and_not(self, a: Self::Mask, b: Self::Mask) -> Self::Mask;
    /// `a` where `mask` holds, `b` elsewhere.
    fn select(self, mask: Self::Mask, a: Self::Vector, b: Self::Vector) -> Self::Vector;
    /// Lane `i` is bit `i`.
    fn bits(self, mask: Self::Mask) -> u16;

    /// `2^x` for `|x| < 126`, to a relative error of 3e-7.
    #[inline(always)]
    fn exp2(self, x: Self::Vector) -> Self::Vector {
        let rounder = self.splat(ROUNDER);
        let rounded = self.add(x, rounder);
        let fraction = self.sub(x, self.sub(rounded, rounder));
        let mut power = self.splat(EXP2[5]);
        for coefficient in EXP2[..5].iter().rev() {
            power = self.mul_add(power, fraction, self.splat(*coefficient));
        }
        self.scale(power, rounded)
    }
}

/// `1.5 * 2^23`: adding it rounds a small number to an integer, left in the low bits of the sum.
const ROUNDER: f32 = 12_582_912.0;

/// Polynomial for `2^f` on `-0.5..=0.5`, constant term first; made by `tools/exp2_coefficients.py`.
const EXP2: [f32; 6] = [1.0, 6.931_469_4e-1, 2.402_212e-1, 5.550_713e-2, 9.675_541e-3, 1.327_647_2e-3];

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn exp2_is_right_to_three_in_ten_million_and_exact_at_integers() {
        let exp2 = |x: f32| {
            let mut row = Row([0.0; LANES]);
            Portable.store(Portable.exp2(Portable.splat(x)), &mut row);
            row.0[0]
        };
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
