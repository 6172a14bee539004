/// An instruction set for `f32` vectors: a value that exists only where the processor has it.
///
/// Methods are inlined into their caller, which must be compiled for the instruction set: see [`crate::dispatch!`].
pub trait Simd: Copy + Send + Sync + 'static {
    /// [`Self::LANES`] numbers.
    type Vector: Copy;
    /// [`Self::LANES`] truth values.
    type Mask: Copy;
    /// Numbers in a vector.
    const LANES: usize;
    /// Rows of a register tile of three vectors each: as many as the registers hold.
    const TILE_ROWS: usize;

    /// Prefetches the cache line at `item`.
    fn prefetch<T>(self, item: &T);

    /// The same value in every lane.
    fn splat(self, x: f32) -> Self::Vector;

    /// Reads `LANES` elements.
    ///
    /// # Safety
    /// `LANES` elements are readable.
    unsafe fn load(self, from: *const f32) -> Self::Vector;

    /// Reads the first `count` (at most `LANES`) elements; the other lanes are zero and their memory is not touched.
    ///
    /// # Safety
    /// `count` elements are readable.
    unsafe fn load_first(self, from: *const f32, count: usize) -> Self::Vector;

    /// Writes `LANES` elements.
    ///
    /// # Safety
    /// `LANES` elements are writable.
    unsafe fn store(self, to: *mut f32, v: Self::Vector);

    /// Writes the first `count` (at most `LANES`) lanes; memory beyond is not touched.
    ///
    /// # Safety
    /// `count` elements are writable.
    unsafe fn store_first(self, to: *mut f32, v: Self::Vector, count: usize);

    /// Reads the first `LANES` elements of a slice. Panics when it is shorter.
    #[inline(always)]
    fn read(self, from: &[f32]) -> Self::Vector {
        assert!(from.len() >= Self::LANES);
        // SAFETY: the slice holds a vector.
        unsafe { self.load(from.as_ptr()) }
    }

    /// Writes a vector to the first `LANES` elements of a slice. Panics when it is shorter.
    #[inline(always)]
    fn write(self, v: Self::Vector, to: &mut [f32]) {
        assert!(to.len() >= Self::LANES);
        // SAFETY: the slice holds a vector.
        unsafe { self.store(to.as_mut_ptr(), v) }
    }

    /// Reads as many elements as the slice has, at most `LANES`; the other lanes are zero.
    #[inline(always)]
    fn read_first(self, from: &[f32]) -> Self::Vector {
        if from.len() >= Self::LANES {
            return self.read(from);
        }
        // SAFETY: the slice holds as many elements.
        unsafe { self.load_first(from.as_ptr(), from.len()) }
    }

    /// Writes as many lanes as the slice has elements, at most `LANES`.
    #[inline(always)]
    fn write_first(self, v: Self::Vector, to: &mut [f32]) {
        if to.len() >= Self::LANES {
            return self.write(v, to);
        }
        // SAFETY: the slice holds as many elements.
        unsafe { self.store_first(to.as_mut_ptr(), v, to.len()) }
    }

    fn add(self, a: Self::Vector, b: Self::Vector) -> Self::Vector;
    fn sub(self, a: Self::Vector, b: Self::Vector) -> Self::Vector;
    fn mul(self, a: Self::Vector, b: Self::Vector) -> Self::Vector;
    fn div(self, a: Self::Vector, b: Self::Vector) -> Self::Vector;
    /// `a * b + c`, rounded once.
    fn mul_add(self, a: Self::Vector, b: Self::Vector, c: Self::Vector) -> Self::Vector;
    /// `c - a * b`, rounded once.
    fn neg_mul_add(self, a: Self::Vector, b: Self::Vector, c: Self::Vector) -> Self::Vector;
    /// The smaller of two; `b` when either is NaN.
    fn min(self, a: Self::Vector, b: Self::Vector) -> Self::Vector;
    /// The larger of two; `b` when either is NaN.
    fn max(self, a: Self::Vector, b: Self::Vector) -> Self::Vector;
    /// The square root, rounded correctly.
    fn sqrt(self, a: Self::Vector) -> Self::Vector;
    /// `-|a|`.
    fn negative(self, a: Self::Vector) -> Self::Vector;
    /// Both numbers of each lane in bfloat16, `first` in the lower half: [`Pair`](crate::Pair)s in the lanes of a vector.
    fn pair(self, first: Self::Vector, second: Self::Vector) -> Self::Vector;
    /// The first numbers of the pairs in a vector.
    fn firsts(self, pairs: Self::Vector) -> Self::Vector;
    /// The second numbers of the pairs in a vector.
    fn seconds(self, pairs: Self::Vector) -> Self::Vector;
    /// `a * 2^n`, where `rounded` is `n + 1.5 * 2^23`; `a` and the result must be normal numbers.
    fn scale_by_power_of_two(self, a: Self::Vector, rounded: Self::Vector) -> Self::Vector;

    /// `a >= b`; false when either is NaN.
    fn at_least(self, a: Self::Vector, b: Self::Vector) -> Self::Mask;
    /// `a > b`; false when either is NaN.
    fn greater(self, a: Self::Vector, b: Self::Vector) -> Self::Mask;
    fn and(self, a: Self::Mask, b: Self::Mask) -> Self::Mask;
    /// `a` and not `b`.
    fn and_not(self, a: Self::Mask, b: Self::Mask) -> Self::Mask;
    /// `a` where `mask` holds, `b` elsewhere.
    fn select(self, mask: Self::Mask, a: Self::Vector, b: Self::Vector) -> Self::Vector;
    /// The mask as bits: lane `i` is bit `i`.
    fn bits(self, mask: Self::Mask) -> u16;

    /// The sum of all lanes; its last bits depend on the instruction set.
    fn sum(self, v: Self::Vector) -> f32;

    /// The sum of each row: elements 8 apart are added first, then those 4, 2 and 1 apart. Unlike [`Simd::sum`], the same bits on
    /// every instruction set.
    #[inline(always)]
    fn sum_rows(self, rows: &[[f32; MAX_LANES]; MAX_LANES]) -> [f32; MAX_LANES] {
        let mut sums = [0.0; MAX_LANES];
        for (sum, row) in sums.iter_mut().zip(rows) {
            let mut row = *row;
            for apart in [8, 4, 2, 1] {
                for i in 0..apart {
                    row[i] += row[i + apart];
                }
            }
            *sum = row[0];
        }
        sums
    }

    /// Transposes a square: element `i` of each of the `LANES` vectors in `from` goes to row `i` of the target, `step` apart.
    ///
    /// # Safety
    /// `LANES` elements of every source are readable, and `LANES` rows of the target are writable.
    #[inline(always)]
    unsafe fn transpose(self, from: &[*const f32; MAX_LANES], to: *mut f32, step: usize) {
        for (column, from) in from.iter().take(Self::LANES).enumerate() {
            for row in 0..Self::LANES {
                // SAFETY: the caller guarantees this memory.
                unsafe { *to.add(row * step + column) = *from.add(row) }
            }
        }
    }

    /// Element `4 i + j` of the four vectors, one after another, becomes lane `i` of vector `j`.
    #[inline(always)]
    fn deinterleave(self, v: [Self::Vector; 4]) -> [Self::Vector; 4] {
        let mut elements = [0.0; 4 * MAX_LANES];
        let mut sorted = [0.0; 4 * MAX_LANES];
        for (j, v) in v.into_iter().enumerate() {
            self.write(v, &mut elements[j * Self::LANES..]);
        }
        for (i, four) in elements[..4 * Self::LANES].chunks_exact(4).enumerate() {
            for j in 0..4 {
                sorted[j * Self::LANES + i] = four[j];
            }
        }
        let mut out = v;
        for (j, out) in out.iter_mut().enumerate() {
            *out = self.read(&sorted[j * Self::LANES..]);
        }
        out
    }

    /// The inverse of [`Simd::deinterleave`].
    #[inline(always)]
    fn interleave(self, v: [Self::Vector; 4]) -> [Self::Vector; 4] {
        let mut elements = [0.0; 4 * MAX_LANES];
        let mut mixed = [0.0; 4 * MAX_LANES];
        for (j, v) in v.into_iter().enumerate() {
            self.write(v, &mut elements[j * Self::LANES..]);
        }
        for (i, four) in mixed[..4 * Self::LANES].chunks_exact_mut(4).enumerate() {
            for j in 0..4 {
                four[j] = elements[j * Self::LANES + i];
            }
        }
        let mut out = v;
        for (j, out) in out.iter_mut().enumerate() {
            *out = self.read(&mixed[j * Self::LANES..]);
        }
        out
    }
}

/// Upper bound of [`Simd::LANES`].
pub const MAX_LANES: usize = 16;

/// Methods of [`Simd`] that are an expression each.
macro_rules! each {
    ($($name:ident($($arg:ident: $type:ty),*) -> $result:ty = $expression:expr;)*) => {
        $(
            #[inline(always)]
            fn $name(self, $($arg: $type),*) -> $result {
                $expression
            }
        )*
    };
}
pub(crate) use each;

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Isa, Portable, dispatch};

    dispatch! {
        fn mix = mix_kernel(elements: &[f32], apart: &mut [f32], together: &mut [f32])
    }

    fn mix_kernel<S: Simd>(s: S, elements: &[f32], apart: &mut [f32], together: &mut [f32]) {
        let read = |j: usize| s.read(&elements[j * S::LANES..]);
        let sorted = s.deinterleave([read(0), read(1), read(2), read(3)]);
        let mixed = s.interleave(sorted);
        for j in 0..4 {
            s.write(sorted[j], &mut apart[j * S::LANES..]);
            s.write(mixed[j], &mut together[j * S::LANES..]);
        }
    }

    #[test]
    fn deinterleaving_round_trips() {
        for isa in Isa::to_test() {
            let lanes = isa.lanes();
            let elements: Vec<f32> = (0..4 * lanes).map(|i| i as f32).collect();
            let (mut apart, mut together) = (vec![0.0; 4 * lanes], vec![0.0; 4 * lanes]);
            mix(isa, &elements, &mut apart, &mut together);
            for (at, &element) in apart.iter().enumerate() {
                assert_eq!(element, (4 * (at % lanes) + at / lanes) as f32, "{isa:?}");
            }
            assert_eq!(together, elements, "{isa:?}");
        }
    }

    dispatch! {
        fn transpose = transpose_kernel(from: &[[f32; MAX_LANES]; MAX_LANES], to: &mut [f32], step: usize)
    }

    fn transpose_kernel<S: Simd>(s: S, from: &[[f32; MAX_LANES]; MAX_LANES], to: &mut [f32], step: usize) {
        assert!(step >= MAX_LANES && to.len() >= MAX_LANES * step);
        // SAFETY: sources and target are long enough for any instruction set.
        unsafe { s.transpose(&from.each_ref().map(|row| row.as_ptr()), to.as_mut_ptr(), step) }
    }

    #[test]
    fn rows_become_columns() {
        let from: [[f32; MAX_LANES]; MAX_LANES] =
            std::array::from_fn(|row| std::array::from_fn(|column| (row * 20 + column) as f32));
        for isa in Isa::to_test() {
            let mut to = vec![-1.0; MAX_LANES * 17];
            transpose(isa, &from, &mut to, 17);
            for (i, &found) in to.iter().enumerate() {
                let (row, column) = (i / 17, i % 17);
                let inside = row < isa.lanes() && column < isa.lanes();
                assert_eq!(found, if inside { from[column][row] } else { -1.0 }, "{isa:?}");
            }
        }
    }

    dispatch! {
        fn copy_first = copy_first_kernel(from: &[f32], to: &mut [f32])
    }

    fn copy_first_kernel<S: Simd>(s: S, from: &[f32], to: &mut [f32]) {
        s.write_first(s.read_first(from), to);
    }

    #[test]
    fn a_short_slice_is_read_and_written_as_far_as_it_goes() {
        let elements: Vec<f32> = (1..=20).map(|i| i as f32).collect();
        for isa in Isa::to_test() {
            for (read, written) in (0..20).flat_map(|read| (0..20).map(move |written| (read, written))) {
                let mut to = [-1.0; 20];
                copy_first(isa, &elements[..read], &mut to[..written]);
                for (i, &found) in to.iter().enumerate() {
                    let expected = match i {
                        _ if i >= written || i >= isa.lanes() => -1.0,
                        _ if i >= read => 0.0,
                        _ => elements[i],
                    };
                    assert_eq!(found, expected, "{isa:?}: {read} read, {written} written");
                }
            }
        }
    }

    dispatch! {
        fn sum_rows = sum_rows_kernel(rows: &[[f32; MAX_LANES]; MAX_LANES]) -> [f32; MAX_LANES]
    }

    fn sum_rows_kernel<S: Simd>(s: S, rows: &[[f32; MAX_LANES]; MAX_LANES]) -> [f32; MAX_LANES] {
        s.sum_rows(rows)
    }

    #[test]
    fn sums_of_rows_have_the_same_bits_on_every_instruction_set() {
        let rows: [[f32; MAX_LANES]; MAX_LANES] = std::array::from_fn(|row| {
            std::array::from_fn(|column| ((row * 31 + column * 7) % 23) as f32 / 7.0 - 1.0)
        });
        let expected = sum_rows(Isa::Portable(Portable), &rows);
        for (row, sum) in rows.iter().zip(expected) {
            assert!((row.iter().sum::<f32>() - sum).abs() < 1e-5);
        }
        for isa in Isa::to_test() {
            assert_eq!(sum_rows(isa, &rows).map(f32::to_bits), expected.map(f32::to_bits), "{isa:?}");
        }
    }

    dispatch! {
        fn all_operations = all_operations_kernel(values: &[[f32; MAX_LANES]; 3], out: &mut Vec<[f32; MAX_LANES]>)
    }

    fn all_operations_kernel<S: Simd>(s: S, values: &[[f32; MAX_LANES]; 3], out: &mut Vec<[f32; MAX_LANES]>) {
        let mut apply = |operation: &dyn Fn(S::Vector, S::Vector, S::Vector) -> S::Vector| {
            let mut row = [0.0; MAX_LANES];
            for first in (0..MAX_LANES).step_by(S::LANES) {
                let [a, b, c] = values.each_ref().map(|row| s.read(&row[first..]));
                s.write(operation(a, b, c), &mut row[first..]);
            }
            out.push(row);
        };
        apply(&|a, b, _| s.add(a, b));
        apply(&|a, b, _| s.sub(a, b));
        apply(&|a, b, _| s.mul(a, b));
        apply(&|a, b, _| s.div(a, b));
        apply(&|a, b, c| s.mul_add(a, b, c));
        apply(&|a, b, c| s.neg_mul_add(a, b, c));
        apply(&|a, b, _| s.min(a, b));
        apply(&|a, b, _| s.max(a, b));
        apply(&|a, _, _| s.sqrt(a));
        apply(&|a, _, _| s.negative(a));
        apply(&|a, b, c| s.select(s.at_least(a, b), a, c));
        apply(&|a, b, c| s.select(s.greater(a, b), a, c));
        apply(&|a, b, c| s.select(s.and(s.at_least(a, b), s.at_least(b, c)), a, c));
        apply(&|a, b, c| s.select(s.and_not(s.at_least(a, b), s.at_least(b, c)), a, c));
        let mut bits = 0;
        for first in (0..MAX_LANES).step_by(S::LANES) {
            let [a, b, _] = values.each_ref().map(|row| s.read(&row[first..]));
            bits |= u32::from(s.bits(s.at_least(a, b))) << first;
        }
        out.push([bits as f32; MAX_LANES]);
    }

    /// On numbers, zeros of both signs, infinities and NaN in every position.
    #[test]
    fn every_operation_gives_the_same_bits_on_every_instruction_set() {
        let kinds = [1.5, -0.3, 0.0, -0.0, f32::NAN, f32::INFINITY, f32::NEG_INFINITY, 1e-40, 3e38];
        for turn in 0..kinds.len() * kinds.len() {
            let (second, third) = (turn % kinds.len(), turn / kinds.len());
            let values = [
                std::array::from_fn(|i| kinds[i % kinds.len()]),
                std::array::from_fn(|i| kinds[(i + second) % kinds.len()]),
                std::array::from_fn(|i| kinds[(i + third) % kinds.len()]),
            ];
            let mut expected = Vec::new();
            all_operations(Isa::Portable(Portable), &values, &mut expected);
            for isa in Isa::to_test() {
                let mut found = Vec::new();
                all_operations(isa, &values, &mut found);
                for (operation, (found, expected)) in found.iter().zip(&expected).enumerate() {
                    for (found, expected) in found.iter().zip(expected) {
                        // The sign and payload of a NaN result depend on the processor.
                        let same =
                            found.to_bits() == expected.to_bits() || found.is_nan() && expected.is_nan();
                        assert!(same, "{isa:?}, operation {operation}: {found} for {expected} of {values:?}");
                    }
                }
            }
        }
    }
}
