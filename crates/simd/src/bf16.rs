//! bfloat16, the upper half of an `f32`: two factors in the room of one, multiplied exactly and summed in `f32`.
//!
//! The sum of a [`Pair`]'s products is defined as the processors with AVX512-BF16 compute it (`VDPBF16PS`, Intel SDM volume 2): the
//! product of the second factors is added first, then that of the first factors, each rounded to the nearest `f32`, and
//! subnormal numbers are zeros. Where the instruction is missing the same bits are computed by two fused multiply-adds. Processors with AMX
//! sum in another order, which [`crate::amx`] defines.

#[cfg(target_arch = "x86_64")]
use std::arch::x86_64::*;
#[cfg(target_arch = "x86_64")]
use std::sync::OnceLock;

#[cfg(target_arch = "x86_64")]
use crate::Avx512;
use crate::{Isa, Simd, dispatch, multiversioned};

/// The numbers that a product multiplies. Sums are `f32` either way.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Precision {
    /// 24 significant bits.
    #[default]
    F32,
    /// 8 significant bits, rounded from `f32`.
    Bf16,
}

impl Precision {
    /// Name as users write it.
    pub fn name(self) -> &'static str {
        match self {
            Self::F32 => "f32",
            Self::Bf16 => "bf16",
        }
    }

    /// Elements that hold so many factors of a sum.
    pub fn packed(self, depth: usize) -> usize {
        match self {
            Self::F32 => depth,
            Self::Bf16 => depth.div_ceil(2),
        }
    }
}

/// Two neighbouring factors of a sum in bfloat16: the first in the lower half.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[repr(transparent)]
pub struct Pair(u32);

impl Pair {
    /// Rounds to the nearest, ties to even; subnormal numbers to zero.
    #[inline(always)]
    pub fn new(first: f32, second: f32) -> Self {
        Self(rounded(first) >> 16 | rounded(second))
    }

    /// Both factors.
    pub fn factors(self) -> [f32; 2] {
        [f32::from_bits(self.0 << 16), f32::from_bits(self.0 & UPPER)]
    }
}

/// The half of an `f32` that is kept.
pub(crate) const UPPER: u32 = 0xFFFF_0000;

/// The bits of the nearest bfloat16 in the upper half.
#[inline(always)]
pub(crate) fn rounded(x: f32) -> u32 {
    let bits = x.to_bits();
    if x.is_nan() {
        return bits & UPPER | 0x0040_0000;
    }
    if x.abs() < f32::MIN_POSITIVE {
        return bits & 0x8000_0000;
    }
    (bits + 0x7FFF + (bits >> 16 & 1)) & UPPER
}

/// `x`, or a zero of its sign if it is subnormal.
pub(crate) fn without_subnormal(x: f32) -> f32 {
    if x.abs() < f32::MIN_POSITIVE { 0.0_f32.copysign(x) } else { x }
}

/// `sum` plus the products of both factors: the definition.
#[cfg_attr(not(target_arch = "x86_64"), allow(dead_code))] // where it is only tested
pub(crate) fn add_products(sum: f32, a: Pair, b: Pair) -> f32 {
    let ([a, c], [b, d]) = (a.factors(), b.factors());
    let sum = without_subnormal(c.mul_add(d, without_subnormal(sum)));
    without_subnormal(a.mul_add(b, sum))
}

dispatch! {
    /// [`pair_neighbours`] by integers.
    fn pair_neighbours_by_integers = pair_neighbours_kernel(numbers: &[f32], pairs: &mut [Pair])
}

/// Rounds each number and the one after it to a pair; the last one's neighbour counts as zero. Panics when there is not a pair for
/// each number.
pub fn pair_neighbours(isa: Isa, numbers: &[f32], pairs: &mut [Pair]) {
    #[cfg(target_arch = "x86_64")]
    if let Some(native) = Avx512Bf16::of(isa) {
        // SAFETY: the token is the proof that the processor has the instructions.
        return unsafe { native_pair_neighbours(native, numbers, pairs) };
    }
    pair_neighbours_by_integers(isa, numbers, pairs);
}

#[inline(always)]
fn pair_neighbours_kernel<S: Simd>(s: S, numbers: &[f32], pairs: &mut [Pair]) {
    each_with_its_neighbour(s, numbers, pairs, |first, second| s.pair(first, second));
}

#[inline(always)]
fn each_with_its_neighbour<S: Simd>(
    s: S,
    numbers: &[f32],
    pairs: &mut [Pair],
    pair: impl Fn(S::Vector, S::Vector) -> S::Vector,
) {
    assert_eq!(numbers.len(), pairs.len(), "a pair for each number");
    let mut at = 0;
    while at + S::LANES < numbers.len() {
        let both = pair(s.read(&numbers[at..]), s.read(&numbers[at + 1..]));
        // SAFETY: as many pairs as lanes follow; a pair has the size and alignment of an `f32`.
        unsafe { s.store(pairs.as_mut_ptr().add(at).cast(), both) }
        at += S::LANES;
    }
    for at in at..numbers.len() {
        pairs[at] = Pair::new(numbers[at], numbers.get(at + 1).copied().unwrap_or(0.0));
    }
}

multiversioned! {
    /// Rounds numbers two by two. Panics when there is not a pair for every two.
    pub fn pair_up(numbers: &[f32], pairs: &mut [Pair]) {
        assert!(numbers.len() == 2 * pairs.len(), "a pair for every two numbers");
        for (pair, two) in pairs.iter_mut().zip(numbers.chunks_exact(2)) {
            *pair = Pair::new(two[0], two[1]);
        }
    }
}

dispatch! {
    /// Rounds rows of `width` numbers, two at a time, to rows of pairs; a missing last row counts as zeros.
    fn pair_rows_by_integers = pair_rows_kernel(rows: &[f32], width: usize, pairs: &mut [Pair])
}

/// Rounds rows of `width` numbers, two at a time, to rows of pairs; a missing last row counts as zeros. Panics when the width is not one of
/// whole vectors, or when there is no room for the pairs.
pub fn pair_rows(isa: Isa, rows: &[f32], width: usize, pairs: &mut [Pair]) {
    #[cfg(target_arch = "x86_64")]
    if let Some(native) = Avx512Bf16::of(isa) {
        // SAFETY: the token is the proof that the processor has the instructions.
        return unsafe { native_pair_rows(native, rows, width, pairs) };
    }
    pair_rows_by_integers(isa, rows, width, pairs);
}

#[inline(always)]
fn pair_rows_kernel<S: Simd>(s: S, rows: &[f32], width: usize, pairs: &mut [Pair]) {
    each_pair_of_rows::<S>(s, rows, width, pairs, |first, second| s.pair(first, second));
}

#[inline(always)]
fn each_pair_of_rows<S: Simd>(
    s: S,
    rows: &[f32],
    width: usize,
    pairs: &mut [Pair],
    pair: impl Fn(S::Vector, S::Vector) -> S::Vector,
) {
    assert!(width > 0 && width.is_multiple_of(S::LANES) && rows.len().is_multiple_of(width));
    let depth = rows.len() / width;
    assert!(pairs.len() >= depth.div_ceil(2) * width, "room for the pairs");
    for (number, rows) in rows.chunks(2 * width).enumerate() {
        for x in (0..width).step_by(S::LANES) {
            let second = if rows.len() > width { s.read(&rows[width + x..]) } else { s.splat(0.0) };
            let both = pair(s.read(&rows[x..]), second);
            // SAFETY: the room was checked; a pair has the size and alignment of an `f32`.
            unsafe { s.store(pairs.as_mut_ptr().add(number * width + x).cast(), both) }
        }
    }
}

/// How the elements of two vectors are multiplied and added to sums: kernels that multiply [`f32`](Numbers) or [`Pair`]s are written
/// once over it. See [`dispatch_pairs!`](crate::dispatch_pairs).
pub trait Multiply<S: Simd>: Copy {
    /// Factors in an element.
    const FACTORS: usize;

    /// What the sums begin with, for a given start.
    #[inline(always)]
    fn begin(self, _: S, start: S::Vector) -> S::Vector {
        start
    }

    /// `sums` plus the products of the elements in each lane.
    fn add(self, s: S, left: S::Vector, right: S::Vector, sums: S::Vector) -> S::Vector;

    /// [`Simd::pair`], with the processor's own rounding where it has that.
    #[inline(always)]
    fn pair(self, s: S, first: S::Vector, second: S::Vector) -> S::Vector {
        s.pair(first, second)
    }
}

/// `f32` times `f32`.
#[derive(Debug, Clone, Copy)]
pub struct Numbers;

impl<S: Simd> Multiply<S> for Numbers {
    const FACTORS: usize = 1;

    #[inline(always)]
    fn add(self, s: S, left: S::Vector, right: S::Vector, sums: S::Vector) -> S::Vector {
        s.mul_add(left, right, sums)
    }
}

/// [`Pair`] times [`Pair`], by two fused multiply-adds.
#[derive(Debug, Clone, Copy)]
pub struct PairsInSteps;

impl<S: Simd> Multiply<S> for PairsInSteps {
    const FACTORS: usize = 2;

    #[inline(always)]
    fn begin(self, s: S, start: S::Vector) -> S::Vector {
        let small = s.greater(s.negative(start), s.splat(-f32::MIN_POSITIVE));
        s.select(small, s.mul(start, s.splat(0.0)), start)
    }

    #[inline(always)]
    fn add(self, s: S, left: S::Vector, right: S::Vector, sums: S::Vector) -> S::Vector {
        let sums = self.begin(s, s.mul_add(s.seconds(left), s.seconds(right), sums));
        self.begin(s, s.mul_add(s.firsts(left), s.firsts(right), sums))
    }
}

#[cfg(target_arch = "x86_64")]
impl Multiply<Avx512> for Avx512Bf16 {
    const FACTORS: usize = 2;

    #[inline(always)]
    fn add(self, _: Avx512, left: __m512, right: __m512, sums: __m512) -> __m512 {
        // SAFETY: the token is the proof; a vector of pairs may be seen as one of numbers of 16 bits.
        unsafe {
            let left = std::mem::transmute::<__m512, __m512bh>(left);
            _mm512_dpbf16_ps(sums, left, std::mem::transmute::<__m512, __m512bh>(right))
        }
    }

    #[inline(always)]
    fn pair(self, _: Avx512, first: __m512, second: __m512) -> __m512 {
        self.pair_lanes(first, second)
    }
}

/// Defines an unsafe `$name(isa, arguments)`, which runs the kernel `$kernel(token, how, arguments)`, generic over [`Simd`] and
/// [`Multiply`], for elements that are [`Pair`]s: with the processor's own instructions where it has them. The caller upholds the
/// kernel's contract. As with [`dispatch!`], the kernel must be `#[inline(always)]`.
#[macro_export]
macro_rules! dispatch_pairs {
    ($(#[$doc:meta])* $vis:vis unsafe fn $name:ident = $kernel:ident($($arg:ident: $ty:ty),* $(,)?)) => {
        $(#[$doc])*
        #[inline]
        $vis unsafe fn $name(isa: $crate::Isa, $($arg: $ty),*) {
            #[cfg(target_arch = "x86_64")]
            #[target_feature(enable = "avx512bf16,avx512f,avx512bw,avx512dq,avx512vl,avx2,fma,bmi1,bmi2,popcnt")]
            unsafe fn native(how: $crate::Avx512Bf16, $($arg: $ty),*) {
                // SAFETY: the contract is passed on to the caller.
                unsafe { $kernel(how.avx512(), how, $($arg),*) }
            }
            #[inline(always)]
            unsafe fn in_steps<S: $crate::Simd>(s: S, $($arg: $ty),*) {
                // SAFETY: as above.
                unsafe { $kernel(s, $crate::PairsInSteps, $($arg),*) }
            }
            $crate::dispatch! { unsafe fn emulated = in_steps($($arg: $ty),*) }
            #[cfg(target_arch = "x86_64")]
            if let Some(how) = $crate::Avx512Bf16::of(isa) {
                // SAFETY: the token is the proof of the instructions; the contract is passed on.
                return unsafe { native(how, $($arg),*) };
            }
            // SAFETY: the contract is passed on.
            unsafe { emulated(isa, $($arg),*) }
        }
    };
}

/// Proof that the processor multiplies pairs itself, exactly as defined here.
#[cfg(target_arch = "x86_64")]
#[derive(Debug, Clone, Copy)]
pub struct Avx512Bf16(Avx512);

#[cfg(target_arch = "x86_64")]
impl Avx512Bf16 {
    /// Where `isa` is AVX-512 and its processor has AVX512-BF16 as well.
    #[inline]
    pub fn of(isa: Isa) -> Option<Self> {
        static AS_DEFINED: OnceLock<bool> = OnceLock::new();
        let Isa::Avx512(avx512) = isa else { return None };
        let found = AS_DEFINED.get_or_init(|| {
            is_x86_feature_detected!("avx512bf16")
                // SAFETY: both instruction sets were detected.
                && unsafe { is_as_defined(Self(avx512)) }
        });
        found.then_some(Self(avx512))
    }

    /// The instruction set that it extends.
    #[inline(always)]
    pub fn avx512(self) -> Avx512 {
        self.0
    }

    #[inline(always)]
    fn pair_lanes(self, first: __m512, second: __m512) -> __m512 {
        // SAFETY: as above.
        unsafe {
            // The lower half has the first factors, the upper one the second.
            let halves: __m512i = std::mem::transmute(_mm512_cvtne2ps_pbh(second, first));
            let low = _mm512_cvtepu16_epi32(_mm512_castsi512_si256(halves));
            let high = _mm512_cvtepu16_epi32(_mm512_extracti64x4_epi64::<1>(halves));
            _mm512_castsi512_ps(_mm512_or_si512(low, _mm512_slli_epi32::<16>(high)))
        }
    }
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx512bf16,avx512f,avx512bw,avx512dq,avx512vl,avx2,fma,bmi1,bmi2,popcnt")]
fn native_pair_rows(native: Avx512Bf16, rows: &[f32], width: usize, pairs: &mut [Pair]) {
    each_pair_of_rows(native.0, rows, width, pairs, |first, second| native.pair_lanes(first, second));
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx512bf16,avx512f,avx512bw,avx512dq,avx512vl,avx2,fma,bmi1,bmi2,popcnt")]
fn native_pair_neighbours(native: Avx512Bf16, numbers: &[f32], pairs: &mut [Pair]) {
    each_with_its_neighbour(native.0, numbers, pairs, |first, second| native.pair_lanes(first, second));
}

/// Numbers of any sign and mantissa, to test instructions with: of one of twelve exponents, from a lowest one on.
#[cfg(target_arch = "x86_64")]
pub(crate) fn numbers_of_exponents() -> impl FnMut(u32) -> f32 {
    let mut bits = 0x9E37_79B9_u32;
    move |lowest| {
        bits ^= bits << 13;
        bits ^= bits >> 17;
        bits ^= bits << 5;
        f32::from_bits(bits & 0x807F_FFFF | (lowest + (bits >> 24) % 12) << 23)
    }
}

/// Whether the instructions compute what [`add_products`] and [`Pair::new`] define, on numbers where other orders and other
/// treatments of subnormal numbers differ.
#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx512bf16,avx512f,avx512bw,avx512dq,avx512vl,avx2,fma,bmi1,bmi2,popcnt")]
fn is_as_defined(native: Avx512Bf16) -> bool {
    const TESTS: usize = 64;
    let s = native.0;
    let mut next = numbers_of_exponents();
    (0..TESTS).all(|test| {
        // Ordinary numbers, then products and sums around the smallest normal one.
        let lowest = if test % 2 == 0 { [120, 120, 115] } else { [61, 61, 0] };
        let mut numbers = |kind: usize| [0; 16].map(|_| next(lowest[kind]));
        let [a, c, b, d, sums] = [numbers(0), numbers(0), numbers(1), numbers(1), numbers(2)];
        let (pairs, others) =
            (native.pair_lanes(s.read(&a), s.read(&c)), native.pair_lanes(s.read(&b), s.read(&d)));
        let (mut found, mut found_pairs) = ([0.0; 16], [0.0; 16]);
        s.write(native.add(s, pairs, others, s.read(&sums)), &mut found);
        s.write(pairs, &mut found_pairs);
        (0..16).all(|i| {
            let (pair, other) = (Pair::new(a[i], c[i]), Pair::new(b[i], d[i]));
            let expected = add_products(sums[i], pair, other);
            found_pairs[i].to_bits() == pair.0 && found[i].to_bits() == expected.to_bits()
        })
    })
}

impl Isa {
    /// Whether products of bfloat16 have sums in the order of AMX, unlike those of other processors: they differ in the last bits.
    pub fn sums_bf16_in_tiles(self) -> bool {
        #[cfg(target_arch = "x86_64")]
        return crate::amx::Amx::of(self).is_some();
        #[cfg(not(target_arch = "x86_64"))]
        false
    }

    /// Whether the processor multiplies bfloat16 by itself, twice as many at once as `f32`: AVX512-BF16.
    pub fn multiplies_bf16(self) -> bool {
        #[cfg(target_arch = "x86_64")]
        return Avx512Bf16::of(self).is_some();
        #[cfg(not(target_arch = "x86_64"))]
        false
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rounding_is_to_the_nearest_even_without_subnormals() {
        for (x, expected) in [
            (1.0, 1.0),
            (1.0 + 1.0 / 256.0, 1.0),
            (1.0 + 3.0 / 256.0, 1.0 + 4.0 / 256.0),
            (1.0 + 1.01 / 256.0, 1.0 + 2.0 / 256.0),
            (-3.3, -3.296_875),
            (f32::MAX, f32::INFINITY),
            (f32::NEG_INFINITY, f32::NEG_INFINITY),
            (f32::MIN_POSITIVE / 2.0, 0.0),
        ] {
            assert_eq!(Pair::new(x, -x).factors(), [expected, -expected], "{x}");
        }
        assert!(Pair::new(f32::from_bits(0x7F80_0001), -f32::NAN).factors().iter().all(|x| x.is_nan()));
    }

    dispatch! {
        fn add_in_steps = add_in_steps_kernel(pairs: &[f32; 48], sums: &mut [f32; 16])
    }

    #[inline(always)]
    fn add_in_steps_kernel<S: Simd>(s: S, pairs: &[f32; 48], sums: &mut [f32; 16]) {
        for x in (0..16).step_by(S::LANES) {
            let begun = PairsInSteps.begin(s, s.read(&sums[x..]));
            let sum = PairsInSteps.add(s, s.read(&pairs[x..]), s.read(&pairs[16 + x..]), begun);
            s.write(sum, &mut sums[x..]);
        }
    }

    /// Also on processors that need not do it in steps.
    #[test]
    fn products_in_steps_have_the_bits_of_the_definition() {
        for scale in [1.0, 1e-19, 3e-20] {
            let number = |i: usize| ((i * 7919 + 3) % 1000) as f32 / 500.0 - 1.0;
            let pair = |i: usize| Pair::new(scale * number(2 * i), scale * number(2 * i + 1));
            let pairs: [Pair; 48] = std::array::from_fn(pair);
            for isa in Isa::to_test() {
                let mut sums: [f32; 16] = std::array::from_fn(|i| scale * scale * number(i + 5));
                let expected: [f32; 16] =
                    std::array::from_fn(|i| add_products(sums[i], pairs[i], pairs[16 + i]));
                add_in_steps(isa, &pairs.map(|pair| f32::from_bits(pair.0)), &mut sums);
                assert_eq!(sums.map(f32::to_bits), expected.map(f32::to_bits), "{isa:?}, {scale}");
            }
        }
    }

    #[test]
    fn neighbours_and_twos_are_paired() {
        let numbers: Vec<f32> = (0..38).map(|i| i as f32 / 8.0 - 1.0).collect();
        for isa in Isa::to_test() {
            let mut pairs = vec![Pair::default(); 38];
            pair_neighbours(isa, &numbers, &mut pairs);
            for (i, pair) in pairs.iter().enumerate() {
                assert_eq!(
                    pair.factors(),
                    [numbers[i], if i < 37 { numbers[i + 1] } else { 0.0 }],
                    "{isa:?}"
                );
            }
        }
        let mut pairs = vec![Pair::default(); 19];
        pair_up(&numbers, &mut pairs);
        assert_eq!(pairs[18].factors(), [numbers[36], numbers[37]]);
        assert_eq!(pairs[0].factors(), [numbers[0], numbers[1]]);
    }

    #[test]
    fn every_instruction_set_rounds_alike() {
        let special = [f32::NAN, f32::from_bits(0xFF80_0001), f32::INFINITY, f32::MAX, -0.0, 1e-40, -1e-39];
        let number = |i: usize| match i % 9 {
            0 => special[i / 9 % special.len()],
            _ => f32::from_bits((i as u32).wrapping_mul(2_654_435_761)),
        };
        let rows: Vec<f32> = (0..5 * 48).map(number).collect();
        for isa in Isa::to_test() {
            let mut pairs = [vec![Pair::default(); 3 * 48], vec![Pair::default(); 3 * 48]];
            pair_rows(isa, &rows, 48, &mut pairs[0]);
            pair_rows_by_integers(isa, &rows, 48, &mut pairs[1]);
            for (at, pair) in pairs[0].iter().enumerate() {
                let (row, x) = (at / 48 * 2, at % 48);
                let second = if row + 1 < 5 { rows[(row + 1) * 48 + x] } else { 0.0 };
                let expected = Pair::new(rows[row * 48 + x], second);
                assert_eq!((*pair, pairs[1][at]), (expected, expected), "{isa:?}: {row} {x}");
            }
        }
    }
}
