use std::arch::x86_64::*;

use crate::bf16::UPPER;
use crate::vector::each;
use crate::{MAX_LANES, Simd};

/// AVX2 with FMA, BMI and POPCNT.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Avx2(());

impl Avx2 {
    /// Proof that the processor has every feature that [`crate::dispatch!`] compiles for.
    pub fn detect() -> Option<Self> {
        (is_x86_feature_detected!("avx2")
            && is_x86_feature_detected!("fma")
            && is_x86_feature_detected!("bmi1")
            && is_x86_feature_detected!("bmi2")
            && is_x86_feature_detected!("popcnt"))
        .then_some(Self(()))
    }
}

/// A mask of the first `count` lanes.
#[inline(always)]
fn first(_: Avx2, count: usize) -> __m256i {
    // SAFETY: the token is the proof.
    unsafe {
        let lane = _mm256_setr_epi32(0, 1, 2, 3, 4, 5, 6, 7);
        _mm256_cmpgt_epi32(_mm256_set1_epi32(count as i32), lane)
    }
}

/// [`crate::bf16::rounded`] in each lane.
#[inline(always)]
fn rounded(_: Avx2, x: __m256) -> __m256i {
    // SAFETY: the token is the proof.
    unsafe {
        let bits = _mm256_castps_si256(x);
        let last = _mm256_and_si256(_mm256_srli_epi32::<16>(bits), _mm256_set1_epi32(1));
        let up = _mm256_add_epi32(_mm256_add_epi32(bits, _mm256_set1_epi32(0x7FFF)), last);
        let negative = _mm256_set1_ps(-0.0);
        let sign = _mm256_and_ps(x, negative);
        let small =
            _mm256_cmp_ps::<_CMP_LT_OQ>(_mm256_andnot_ps(negative, x), _mm256_set1_ps(f32::MIN_POSITIVE));
        let nan = _mm256_cmp_ps::<_CMP_UNORD_Q>(x, x);
        let quiet = _mm256_or_si256(bits, _mm256_set1_epi32(0x0040_0000));
        let rounded = _mm256_blendv_ps(_mm256_castsi256_ps(up), sign, small);
        let rounded = _mm256_blendv_ps(rounded, _mm256_castsi256_ps(quiet), nan);
        _mm256_and_si256(_mm256_castps_si256(rounded), _mm256_set1_epi32(UPPER as i32))
    }
}

// SAFETY of every block below: `self` exists only if `detect` found the instructions; the caller vouches for the memory.
#[expect(clippy::undocumented_unsafe_blocks, reason = "stated once, above")]
impl Simd for Avx2 {
    type Vector = __m256;
    type Mask = __m256;
    const LANES: usize = 8;
    const TILE_ROWS: usize = 4;

    #[inline(always)]
    fn prefetch<T>(self, item: &T) {
        unsafe { _mm_prefetch::<_MM_HINT_T0>(std::ptr::from_ref(item).cast()) }
    }

    each! {
        splat(x: f32) -> __m256 = unsafe { _mm256_set1_ps(x) };
        add(a: __m256, b: __m256) -> __m256 = unsafe { _mm256_add_ps(a, b) };
        sub(a: __m256, b: __m256) -> __m256 = unsafe { _mm256_sub_ps(a, b) };
        mul(a: __m256, b: __m256) -> __m256 = unsafe { _mm256_mul_ps(a, b) };
        div(a: __m256, b: __m256) -> __m256 = unsafe { _mm256_div_ps(a, b) };
        mul_add(a: __m256, b: __m256, c: __m256) -> __m256 = unsafe { _mm256_fmadd_ps(a, b, c) };
        neg_mul_add(a: __m256, b: __m256, c: __m256) -> __m256 = unsafe { _mm256_fnmadd_ps(a, b, c) };
        min(a: __m256, b: __m256) -> __m256 = unsafe { _mm256_min_ps(a, b) };
        max(a: __m256, b: __m256) -> __m256 = unsafe { _mm256_max_ps(a, b) };
        sqrt(a: __m256) -> __m256 = unsafe { _mm256_sqrt_ps(a) };
        negative(a: __m256) -> __m256 = unsafe { _mm256_or_ps(a, _mm256_set1_ps(-0.0)) };
        at_least(a: __m256, b: __m256) -> __m256 = unsafe { _mm256_cmp_ps::<_CMP_GE_OQ>(a, b) };
        greater(a: __m256, b: __m256) -> __m256 = unsafe { _mm256_cmp_ps::<_CMP_GT_OQ>(a, b) };
        and(a: __m256, b: __m256) -> __m256 = unsafe { _mm256_and_ps(a, b) };
        and_not(a: __m256, b: __m256) -> __m256 = unsafe { _mm256_andnot_ps(b, a) };
        select(mask: __m256, a: __m256, b: __m256) -> __m256 = unsafe { _mm256_blendv_ps(b, a, mask) };
        firsts(pairs: __m256) -> __m256 = unsafe {
            _mm256_castsi256_ps(_mm256_slli_epi32::<16>(_mm256_castps_si256(pairs)))
        };
        seconds(pairs: __m256) -> __m256 = unsafe {
            _mm256_and_ps(pairs, _mm256_castsi256_ps(_mm256_set1_epi32(UPPER as i32)))
        };
        bits(mask: __m256) -> u16 = unsafe { _mm256_movemask_ps(mask) as u16 };
    }

    #[inline(always)]
    fn pair(self, first: __m256, second: __m256) -> __m256 {
        unsafe {
            let first = _mm256_srli_epi32::<16>(rounded(self, first));
            _mm256_castsi256_ps(_mm256_or_si256(first, rounded(self, second)))
        }
    }

    #[inline(always)]
    unsafe fn load(self, from: *const f32) -> __m256 {
        unsafe { _mm256_loadu_ps(from) }
    }

    #[inline(always)]
    unsafe fn load_first(self, from: *const f32, count: usize) -> __m256 {
        unsafe { _mm256_maskload_ps(from, first(self, count)) }
    }

    #[inline(always)]
    unsafe fn store(self, to: *mut f32, v: __m256) {
        unsafe { _mm256_storeu_ps(to, v) }
    }

    #[inline(always)]
    unsafe fn store_first(self, to: *mut f32, v: __m256, count: usize) {
        unsafe { _mm256_maskstore_ps(to, first(self, count), v) }
    }

    #[inline(always)]
    fn scale_by_power_of_two(self, a: __m256, rounded: __m256) -> __m256 {
        unsafe {
            // The lowest bits of `rounded` are those of `n`: shifted, they add to the exponent.
            let exponent = _mm256_slli_epi32::<23>(_mm256_castps_si256(rounded));
            _mm256_castsi256_ps(_mm256_add_epi32(_mm256_castps_si256(a), exponent))
        }
    }

    #[inline(always)]
    fn sum(self, v: __m256) -> f32 {
        let mut lanes = [0.0_f32; 8];
        self.write(v, &mut lanes);
        lanes.iter().sum()
    }

    #[inline(always)]
    fn sum_rows(self, rows: &[[f32; MAX_LANES]; MAX_LANES]) -> [f32; MAX_LANES] {
        unsafe {
            // Each step adds the halves of what is left of two rows, and puts the sums of both into one vector.
            let mut quarters = [_mm256_setzero_ps(); 8];
            for i in 0..8 {
                let (a, b) = (&rows[2 * i], &rows[2 * i + 1]);
                let a = self.add(self.read(a), self.read(&a[8..]));
                let b = self.add(self.read(b), self.read(&b[8..]));
                let (low, high) =
                    (_mm256_permute2f128_ps::<0x20>(a, b), _mm256_permute2f128_ps::<0x31>(a, b));
                quarters[i] = _mm256_add_ps(low, high);
            }
            let mut pairs = [_mm256_setzero_ps(); 4];
            for i in 0..4 {
                let (a, b) = (quarters[2 * i], quarters[2 * i + 1]);
                let (low, high) = (_mm256_shuffle_ps::<0x44>(a, b), _mm256_shuffle_ps::<0xEE>(a, b));
                pairs[i] = _mm256_add_ps(low, high);
            }
            // Rows 0, 2, 4, 6, then 1, 3, 5, 7.
            let order = _mm256_setr_epi32(0, 4, 1, 5, 2, 6, 3, 7);
            let mut sums = [0.0; MAX_LANES];
            for i in 0..2 {
                let (a, b) = (pairs[2 * i], pairs[2 * i + 1]);
                let (low, high) = (_mm256_shuffle_ps::<0x88>(a, b), _mm256_shuffle_ps::<0xDD>(a, b));
                let sorted = _mm256_permutevar8x32_ps(_mm256_add_ps(low, high), order);
                self.write(sorted, &mut sums[8 * i..]);
            }
            sums
        }
    }
}
