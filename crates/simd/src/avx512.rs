use std::arch::x86_64::*;

use crate::bf16::UPPER;
use crate::vector::each;
use crate::{Avx2, MAX_LANES, Simd};

/// AVX-512 (F, BW, DQ, VL), and all of AVX2.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Avx512(());

impl Avx512 {
    /// Proof that the processor has every feature that [`crate::dispatch!`] compiles for.
    pub fn detect() -> Option<Self> {
        (Avx2::detect().is_some()
            && is_x86_feature_detected!("avx512f")
            && is_x86_feature_detected!("avx512bw")
            && is_x86_feature_detected!("avx512dq")
            && is_x86_feature_detected!("avx512vl"))
        .then_some(Self(()))
    }
}

/// [`crate::bf16::rounded`] in each lane.
#[inline(always)]
fn rounded(_: Avx512, x: __m512) -> __m512i {
    // SAFETY: the token is the proof.
    unsafe {
        let bits = _mm512_castps_si512(x);
        let last = _mm512_and_si512(_mm512_srli_epi32::<16>(bits), _mm512_set1_epi32(1));
        let up = _mm512_add_epi32(_mm512_add_epi32(bits, _mm512_set1_epi32(0x7FFF)), last);
        let small = _mm512_cmp_ps_mask::<_CMP_LT_OQ>(_mm512_abs_ps(x), _mm512_set1_ps(f32::MIN_POSITIVE));
        let nan = _mm512_cmp_ps_mask::<_CMP_UNORD_Q>(x, x);
        let rounded = _mm512_mask_and_epi32(up, small, bits, _mm512_set1_epi32(i32::MIN));
        let rounded = _mm512_mask_or_epi32(rounded, nan, bits, _mm512_set1_epi32(0x0040_0000));
        _mm512_and_si512(rounded, _mm512_set1_epi32(UPPER as i32))
    }
}

// SAFETY of every block below: `self` exists only if `detect` found the instructions; the caller vouches for the memory.
#[expect(clippy::undocumented_unsafe_blocks, reason = "stated once, above")]
impl Simd for Avx512 {
    type Vector = __m512;
    type Mask = __mmask16;
    const LANES: usize = 16;
    const TILE_ROWS: usize = 8;

    #[inline(always)]
    fn prefetch<T>(self, item: &T) {
        unsafe { _mm_prefetch::<_MM_HINT_T0>(std::ptr::from_ref(item).cast()) }
    }

    each! {
        splat(x: f32) -> __m512 = unsafe { _mm512_set1_ps(x) };
        add(a: __m512, b: __m512) -> __m512 = unsafe { _mm512_add_ps(a, b) };
        sub(a: __m512, b: __m512) -> __m512 = unsafe { _mm512_sub_ps(a, b) };
        mul(a: __m512, b: __m512) -> __m512 = unsafe { _mm512_mul_ps(a, b) };
        div(a: __m512, b: __m512) -> __m512 = unsafe { _mm512_div_ps(a, b) };
        mul_add(a: __m512, b: __m512, c: __m512) -> __m512 = unsafe { _mm512_fmadd_ps(a, b, c) };
        neg_mul_add(a: __m512, b: __m512, c: __m512) -> __m512 = unsafe { _mm512_fnmadd_ps(a, b, c) };
        min(a: __m512, b: __m512) -> __m512 = unsafe { _mm512_min_ps(a, b) };
        max(a: __m512, b: __m512) -> __m512 = unsafe { _mm512_max_ps(a, b) };
        sqrt(a: __m512) -> __m512 = unsafe { _mm512_sqrt_ps(a) };
        negative(a: __m512) -> __m512 = unsafe { _mm512_or_ps(a, _mm512_set1_ps(-0.0)) };
        at_least(a: __m512, b: __m512) -> __mmask16 = unsafe { _mm512_cmp_ps_mask::<_CMP_GE_OQ>(a, b) };
        greater(a: __m512, b: __m512) -> __mmask16 = unsafe { _mm512_cmp_ps_mask::<_CMP_GT_OQ>(a, b) };
        and(a: __mmask16, b: __mmask16) -> __mmask16 = a & b;
        and_not(a: __mmask16, b: __mmask16) -> __mmask16 = a & !b;
        select(mask: __mmask16, a: __m512, b: __m512) -> __m512 = unsafe { _mm512_mask_blend_ps(mask, b, a) };
        firsts(pairs: __m512) -> __m512 = unsafe {
            _mm512_castsi512_ps(_mm512_slli_epi32::<16>(_mm512_castps_si512(pairs)))
        };
        seconds(pairs: __m512) -> __m512 = unsafe {
            _mm512_and_ps(pairs, _mm512_castsi512_ps(_mm512_set1_epi32(UPPER as i32)))
        };
        bits(mask: __mmask16) -> u16 = mask;
        sum(v: __m512) -> f32 = unsafe { _mm512_reduce_add_ps(v) };
    }

    #[inline(always)]
    fn pair(self, first: __m512, second: __m512) -> __m512 {
        unsafe {
            let first = _mm512_srli_epi32::<16>(rounded(self, first));
            _mm512_castsi512_ps(_mm512_or_si512(first, rounded(self, second)))
        }
    }

    #[inline(always)]
    unsafe fn load(self, from: *const f32) -> __m512 {
        unsafe { _mm512_loadu_ps(from) }
    }

    #[inline(always)]
    unsafe fn load_first(self, from: *const f32, count: usize) -> __m512 {
        unsafe { _mm512_maskz_loadu_ps(((1_u32 << count) - 1) as __mmask16, from) }
    }

    #[inline(always)]
    unsafe fn store(self, to: *mut f32, v: __m512) {
        unsafe { _mm512_storeu_ps(to, v) }
    }

    #[inline(always)]
    unsafe fn store_first(self, to: *mut f32, v: __m512, count: usize) {
        unsafe { _mm512_mask_storeu_ps(to, ((1_u32 << count) - 1) as __mmask16, v) }
    }

    #[inline(always)]
    fn scale_by_power_of_two(self, a: __m512, rounded: __m512) -> __m512 {
        unsafe {
            let exponent = _mm512_slli_epi32::<23>(_mm512_castps_si512(rounded));
            _mm512_castsi512_ps(_mm512_add_epi32(_mm512_castps_si512(a), exponent))
        }
    }

    #[inline(always)]
    fn sum_rows(self, rows: &[[f32; MAX_LANES]; MAX_LANES]) -> [f32; MAX_LANES] {
        unsafe {
            // Each step adds the halves of what is left of two rows, and puts the sums of both into one vector.
            let mut halves = [_mm512_setzero_ps(); 8];
            for i in 0..8 {
                let (a, b) = (self.read(&rows[2 * i]), self.read(&rows[2 * i + 1]));
                let (low, high) = (_mm512_shuffle_f32x4::<0x44>(a, b), _mm512_shuffle_f32x4::<0xEE>(a, b));
                halves[i] = _mm512_add_ps(low, high);
            }
            let mut quarters = [_mm512_setzero_ps(); 4];
            for i in 0..4 {
                let (a, b) = (halves[2 * i], halves[2 * i + 1]);
                let (low, high) = (_mm512_shuffle_f32x4::<0x88>(a, b), _mm512_shuffle_f32x4::<0xDD>(a, b));
                quarters[i] = _mm512_add_ps(low, high);
            }
            let mut pairs = [_mm512_setzero_ps(); 2];
            for i in 0..2 {
                let (a, b) = (quarters[2 * i], quarters[2 * i + 1]);
                let (low, high) = (_mm512_shuffle_ps::<0x44>(a, b), _mm512_shuffle_ps::<0xEE>(a, b));
                pairs[i] = _mm512_add_ps(low, high);
            }
            let [a, b] = pairs;
            let (low, high) = (_mm512_shuffle_ps::<0x88>(a, b), _mm512_shuffle_ps::<0xDD>(a, b));
            // Row 4 m + k is element 4 k + m.
            let order = _mm512_setr_epi32(0, 4, 8, 12, 1, 5, 9, 13, 2, 6, 10, 14, 3, 7, 11, 15);
            let mut sums = [0.0; MAX_LANES];
            self.write(_mm512_permutexvar_ps(order, _mm512_add_ps(low, high)), &mut sums);
            sums
        }
    }

    #[inline(always)]
    unsafe fn transpose(self, from: &[*const f32; MAX_LANES], to: *mut f32, step: usize) {
        unsafe {
            // Interleaving every fourth row, twice, brings the elements of all rows together.
            let mut quarters = [[_mm512_setzero_ps(); 4]; 4];
            for j in 0..4 {
                let (a, b) = (_mm512_loadu_ps(from[j]), _mm512_loadu_ps(from[j + 4]));
                let (c, d) = (_mm512_loadu_ps(from[j + 8]), _mm512_loadu_ps(from[j + 12]));
                quarters[j] = self.interleave([a, b, c, d]);
            }
            for k in 0..4 {
                let [a, b, c, d] = quarters;
                let rows = self.interleave([a[k], b[k], c[k], d[k]]);
                for m in 0..4 {
                    _mm512_storeu_ps(to.add((4 * k + m) * step), rows[m]);
                }
            }
        }
    }

    #[inline(always)]
    fn deinterleave(self, [a, b, c, d]: [__m512; 4]) -> [__m512; 4] {
        unsafe {
            // Eight lanes of the first two vectors, then eight of the last two.
            let every_fourth = _mm512_setr_epi32(0, 4, 8, 12, 16, 20, 24, 28, 0, 4, 8, 12, 16, 20, 24, 28);
            let mut sorted = [a; 4];
            // Not `from_fn`: a closure is not always compiled for the instruction set of its caller.
            for j in 0..4 {
                let index = _mm512_add_epi32(every_fourth, _mm512_set1_epi32(j as i32));
                let low = _mm512_permutex2var_ps(a, index, b);
                sorted[j] = _mm512_mask_blend_ps(0xFF00, low, _mm512_permutex2var_ps(c, index, d));
            }
            sorted
        }
    }

    #[inline(always)]
    fn interleave(self, [a, b, c, d]: [__m512; 4]) -> [__m512; 4] {
        unsafe {
            let alternate = _mm512_setr_epi32(0, 16, 0, 16, 1, 17, 1, 17, 2, 18, 2, 18, 3, 19, 3, 19);
            let mut mixed = [a; 4];
            for k in 0..4 {
                let index = _mm512_add_epi32(alternate, _mm512_set1_epi32(4 * k as i32));
                let first = _mm512_permutex2var_ps(a, index, b);
                mixed[k] = _mm512_mask_blend_ps(0xCCCC, first, _mm512_permutex2var_ps(c, index, d));
            }
            mixed
        }
    }
}
