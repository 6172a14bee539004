//! Vectors of `f32` whose width is chosen at run time.
//!
//! A kernel is written once over [`Simd`] and compiled for each instruction set; [`dispatch!`] picks the widest one that
//! the processor has. Every lane operation is the IEEE one with fused multiply-add, so an element of a result depends
//! on the order of its own operations only, never on the width.

/// One instruction set. The functions are `unsafe` because they may be called only where the processor has it.
pub(crate) trait Simd: Copy + Send + Sync + 'static {
    /// A vector.
    type Vector: Copy;
    /// Elements of a vector.
    const LANES: usize;
    /// Rows of a register tile of three vectors each: as many as the registers hold.
    const TILE_ROWS: usize;

    /// All lanes `x`.
    unsafe fn splat(x: f32) -> Self::Vector;
    /// Reads `LANES` elements.
    unsafe fn load(from: *const f32) -> Self::Vector;
    /// Reads the first `count` elements; the other lanes are zero and their memory is not touched.
    unsafe fn load_first(from: *const f32, count: usize) -> Self::Vector;
    /// Writes `LANES` elements.
    unsafe fn store(to: *mut f32, v: Self::Vector);
    /// Writes the first `count` lanes; memory beyond is not touched.
    unsafe fn store_first(to: *mut f32, v: Self::Vector, count: usize);
    /// `a * b + c`, rounded once.
    unsafe fn mul_add(a: Self::Vector, b: Self::Vector, c: Self::Vector) -> Self::Vector;
    /// `a + b`.
    unsafe fn add(a: Self::Vector, b: Self::Vector) -> Self::Vector;
    /// `a - b`.
    unsafe fn sub(a: Self::Vector, b: Self::Vector) -> Self::Vector;
    /// `a * b`.
    unsafe fn mul(a: Self::Vector, b: Self::Vector) -> Self::Vector;
    /// `a / b`.
    unsafe fn div(a: Self::Vector, b: Self::Vector) -> Self::Vector;
    /// The smaller of each lane; `b` where one of them is not a number.
    unsafe fn min(a: Self::Vector, b: Self::Vector) -> Self::Vector;
    /// The larger of each lane; `b` where one of them is not a number.
    unsafe fn max(a: Self::Vector, b: Self::Vector) -> Self::Vector;
    /// `then` where `v` is positive, zero elsewhere.
    unsafe fn where_positive(v: Self::Vector, then: Self::Vector) -> Self::Vector;
    /// The sum of all lanes.
    unsafe fn sum(v: Self::Vector) -> f32;

    /// `p * 2^n`, where `t` is `n + 1.5 * 2^23` and `p` and the result are normal numbers.
    unsafe fn times_power_of_two(p: Self::Vector, t: Self::Vector) -> Self::Vector;

    /// Writes element `i` of every `from`, of which there are `LANES`, to `to + i * step`, for `LANES` elements.
    #[inline(always)]
    unsafe fn transpose(from: &[*const f32; MOST_LANES], to: *mut f32, step: usize) {
        for (column, from) in from.iter().take(Self::LANES).enumerate() {
            for row in 0..Self::LANES {
                // SAFETY: the caller gives this memory.
                unsafe { *to.add(row * step + column) = *from.add(row) }
            }
        }
    }

    /// Element `4 i + j` of the four vectors, one after another, becomes lane `i` of vector `j`.
    #[inline(always)]
    unsafe fn deinterleave(v: [Self::Vector; 4]) -> [Self::Vector; 4] {
        let mut elements = [0.0; 4 * MOST_LANES];
        let mut sorted = [0.0; 4 * MOST_LANES];
        // SAFETY: both arrays hold four vectors.
        unsafe {
            for (j, v) in v.into_iter().enumerate() {
                Self::store(elements[j * Self::LANES..].as_mut_ptr(), v);
            }
            for (i, four) in elements[..4 * Self::LANES].chunks_exact(4).enumerate() {
                for j in 0..4 {
                    sorted[j * Self::LANES + i] = four[j];
                }
            }
            let mut out = v;
            for (j, out) in out.iter_mut().enumerate() {
                *out = Self::load(sorted[j * Self::LANES..].as_ptr());
            }
            out
        }
    }

    /// The inverse of [`Simd::deinterleave`].
    #[inline(always)]
    unsafe fn interleave(v: [Self::Vector; 4]) -> [Self::Vector; 4] {
        let mut elements = [0.0; 4 * MOST_LANES];
        let mut mixed = [0.0; 4 * MOST_LANES];
        // SAFETY: both arrays hold four vectors.
        unsafe {
            for (j, v) in v.into_iter().enumerate() {
                Self::store(elements[j * Self::LANES..].as_mut_ptr(), v);
            }
            for (i, four) in mixed[..4 * Self::LANES].chunks_exact_mut(4).enumerate() {
                for j in 0..4 {
                    four[j] = elements[j * Self::LANES + i];
                }
            }
            let mut out = v;
            for (j, out) in out.iter_mut().enumerate() {
                *out = Self::load(mixed[j * Self::LANES..].as_ptr());
            }
            out
        }
    }
}

/// [`Simd::LANES`] at most.
pub(crate) const MOST_LANES: usize = 16;

/// Lanes of plain `f32`, for processors without the instruction sets below.
#[derive(Clone, Copy)]
pub(crate) struct Portable;

impl Simd for Portable {
    type Vector = [f32; 8];
    const LANES: usize = 8;
    const TILE_ROWS: usize = 4;

    #[inline(always)]
    unsafe fn splat(x: f32) -> [f32; 8] {
        [x; 8]
    }

    #[inline(always)]
    unsafe fn load(from: *const f32) -> [f32; 8] {
        // SAFETY: the caller gives LANES readable elements.
        unsafe { from.cast::<[f32; 8]>().read_unaligned() }
    }

    #[inline(always)]
    unsafe fn load_first(from: *const f32, count: usize) -> [f32; 8] {
        // SAFETY: the caller gives `count` readable elements.
        std::array::from_fn(|i| if i < count { unsafe { *from.add(i) } } else { 0.0 })
    }

    #[inline(always)]
    unsafe fn store(to: *mut f32, v: [f32; 8]) {
        // SAFETY: the caller gives LANES writable elements.
        unsafe { to.cast::<[f32; 8]>().write_unaligned(v) }
    }

    #[inline(always)]
    unsafe fn store_first(to: *mut f32, v: [f32; 8], count: usize) {
        for (i, x) in v.into_iter().enumerate().take(count) {
            // SAFETY: the caller gives `count` writable elements.
            unsafe { *to.add(i) = x }
        }
    }

    #[inline(always)]
    unsafe fn mul_add(a: [f32; 8], b: [f32; 8], c: [f32; 8]) -> [f32; 8] {
        std::array::from_fn(|i| a[i].mul_add(b[i], c[i]))
    }

    #[inline(always)]
    unsafe fn add(a: [f32; 8], b: [f32; 8]) -> [f32; 8] {
        std::array::from_fn(|i| a[i] + b[i])
    }

    #[inline(always)]
    unsafe fn sub(a: [f32; 8], b: [f32; 8]) -> [f32; 8] {
        std::array::from_fn(|i| a[i] - b[i])
    }

    #[inline(always)]
    unsafe fn mul(a: [f32; 8], b: [f32; 8]) -> [f32; 8] {
        std::array::from_fn(|i| a[i] * b[i])
    }

    #[inline(always)]
    unsafe fn div(a: [f32; 8], b: [f32; 8]) -> [f32; 8] {
        std::array::from_fn(|i| a[i] / b[i])
    }

    #[inline(always)]
    unsafe fn min(a: [f32; 8], b: [f32; 8]) -> [f32; 8] {
        std::array::from_fn(|i| if a[i] < b[i] { a[i] } else { b[i] })
    }

    #[inline(always)]
    unsafe fn max(a: [f32; 8], b: [f32; 8]) -> [f32; 8] {
        std::array::from_fn(|i| if a[i] > b[i] { a[i] } else { b[i] })
    }

    #[inline(always)]
    unsafe fn where_positive(v: [f32; 8], then: [f32; 8]) -> [f32; 8] {
        std::array::from_fn(|i| if v[i] > 0.0 { then[i] } else { 0.0 })
    }

    #[inline(always)]
    unsafe fn sum(v: [f32; 8]) -> f32 {
        v.iter().sum()
    }

    #[inline(always)]
    unsafe fn times_power_of_two(p: [f32; 8], t: [f32; 8]) -> [f32; 8] {
        // The lowest bits of `t` are those of `n`: shifted, they are added to the exponent.
        std::array::from_fn(|i| f32::from_bits(p[i].to_bits().wrapping_add(t[i].to_bits() << 23)))
    }
}

#[cfg(target_arch = "x86_64")]
mod x86 {
    use std::arch::x86_64::*;

    use super::Simd;

    /// AVX2 with fused multiply-add.
    #[derive(Clone, Copy)]
    pub(crate) struct Avx2;

    #[inline(always)]
    unsafe fn first(count: usize) -> __m256i {
        // SAFETY: only called where AVX2 is there.
        unsafe {
            let lane = _mm256_setr_epi32(0, 1, 2, 3, 4, 5, 6, 7);
            _mm256_cmpgt_epi32(_mm256_set1_epi32(count as i32), lane)
        }
    }

    // SAFETY (of every block below): the trait's contract, the caller has checked the instruction set and the memory.
    #[allow(clippy::undocumented_unsafe_blocks)] // said once, above
    impl Simd for Avx2 {
        type Vector = __m256;
        const LANES: usize = 8;
        const TILE_ROWS: usize = 4;

        #[inline(always)]
        unsafe fn splat(x: f32) -> __m256 {
            unsafe { _mm256_set1_ps(x) }
        }

        #[inline(always)]
        unsafe fn load(from: *const f32) -> __m256 {
            unsafe { _mm256_loadu_ps(from) }
        }

        #[inline(always)]
        unsafe fn load_first(from: *const f32, count: usize) -> __m256 {
            unsafe { _mm256_maskload_ps(from, first(count)) }
        }

        #[inline(always)]
        unsafe fn store(to: *mut f32, v: __m256) {
            unsafe { _mm256_storeu_ps(to, v) }
        }

        #[inline(always)]
        unsafe fn store_first(to: *mut f32, v: __m256, count: usize) {
            unsafe { _mm256_maskstore_ps(to, first(count), v) }
        }

        #[inline(always)]
        unsafe fn mul_add(a: __m256, b: __m256, c: __m256) -> __m256 {
            unsafe { _mm256_fmadd_ps(a, b, c) }
        }

        #[inline(always)]
        unsafe fn add(a: __m256, b: __m256) -> __m256 {
            unsafe { _mm256_add_ps(a, b) }
        }

        #[inline(always)]
        unsafe fn sub(a: __m256, b: __m256) -> __m256 {
            unsafe { _mm256_sub_ps(a, b) }
        }

        #[inline(always)]
        unsafe fn mul(a: __m256, b: __m256) -> __m256 {
            unsafe { _mm256_mul_ps(a, b) }
        }

        #[inline(always)]
        unsafe fn div(a: __m256, b: __m256) -> __m256 {
            unsafe { _mm256_div_ps(a, b) }
        }

        #[inline(always)]
        unsafe fn min(a: __m256, b: __m256) -> __m256 {
            unsafe { _mm256_min_ps(a, b) }
        }

        #[inline(always)]
        unsafe fn max(a: __m256, b: __m256) -> __m256 {
            unsafe { _mm256_max_ps(a, b) }
        }

        #[inline(always)]
        unsafe fn where_positive(v: __m256, then: __m256) -> __m256 {
            unsafe { _mm256_and_ps(_mm256_cmp_ps::<_CMP_GT_OQ>(v, _mm256_setzero_ps()), then) }
        }

        #[inline(always)]
        unsafe fn sum(v: __m256) -> f32 {
            let mut lanes = [0.0_f32; 8];
            unsafe { _mm256_storeu_ps(lanes.as_mut_ptr(), v) }
            lanes.iter().sum()
        }

        #[inline(always)]
        unsafe fn times_power_of_two(p: __m256, t: __m256) -> __m256 {
            unsafe {
                let exponent = _mm256_slli_epi32::<23>(_mm256_castps_si256(t));
                _mm256_castsi256_ps(_mm256_add_epi32(_mm256_castps_si256(p), exponent))
            }
        }
    }

    /// AVX-512 foundation.
    #[derive(Clone, Copy)]
    pub(crate) struct Avx512;

    #[allow(clippy::undocumented_unsafe_blocks)] // as for Avx2
    impl Simd for Avx512 {
        type Vector = __m512;
        const LANES: usize = 16;
        const TILE_ROWS: usize = 8;

        #[inline(always)]
        unsafe fn splat(x: f32) -> __m512 {
            unsafe { _mm512_set1_ps(x) }
        }

        #[inline(always)]
        unsafe fn load(from: *const f32) -> __m512 {
            unsafe { _mm512_loadu_ps(from) }
        }

        #[inline(always)]
        unsafe fn load_first(from: *const f32, count: usize) -> __m512 {
            unsafe { _mm512_maskz_loadu_ps(((1_u32 << count) - 1) as __mmask16, from) }
        }

        #[inline(always)]
        unsafe fn store(to: *mut f32, v: __m512) {
            unsafe { _mm512_storeu_ps(to, v) }
        }

        #[inline(always)]
        unsafe fn store_first(to: *mut f32, v: __m512, count: usize) {
            unsafe { _mm512_mask_storeu_ps(to, ((1_u32 << count) - 1) as __mmask16, v) }
        }

        #[inline(always)]
        unsafe fn mul_add(a: __m512, b: __m512, c: __m512) -> __m512 {
            unsafe { _mm512_fmadd_ps(a, b, c) }
        }

        #[inline(always)]
        unsafe fn add(a: __m512, b: __m512) -> __m512 {
            unsafe { _mm512_add_ps(a, b) }
        }

        #[inline(always)]
        unsafe fn sub(a: __m512, b: __m512) -> __m512 {
            unsafe { _mm512_sub_ps(a, b) }
        }

        #[inline(always)]
        unsafe fn mul(a: __m512, b: __m512) -> __m512 {
            unsafe { _mm512_mul_ps(a, b) }
        }

        #[inline(always)]
        unsafe fn div(a: __m512, b: __m512) -> __m512 {
            unsafe { _mm512_div_ps(a, b) }
        }

        #[inline(always)]
        unsafe fn min(a: __m512, b: __m512) -> __m512 {
            unsafe { _mm512_min_ps(a, b) }
        }

        #[inline(always)]
        unsafe fn max(a: __m512, b: __m512) -> __m512 {
            unsafe { _mm512_max_ps(a, b) }
        }

        #[inline(always)]
        unsafe fn where_positive(v: __m512, then: __m512) -> __m512 {
            unsafe { _mm512_maskz_mov_ps(_mm512_cmp_ps_mask::<_CMP_GT_OQ>(v, _mm512_setzero_ps()), then) }
        }

        #[inline(always)]
        unsafe fn sum(v: __m512) -> f32 {
            unsafe { _mm512_reduce_add_ps(v) }
        }

        #[inline(always)]
        unsafe fn times_power_of_two(p: __m512, t: __m512) -> __m512 {
            unsafe {
                let exponent = _mm512_slli_epi32::<23>(_mm512_castps_si512(t));
                _mm512_castsi512_ps(_mm512_add_epi32(_mm512_castps_si512(p), exponent))
            }
        }

        #[inline(always)]
        unsafe fn transpose(from: &[*const f32; 16], to: *mut f32, step: usize) {
            unsafe {
                // Interleaving every fourth row, then what that gives, brings all rows' elements together.
                let mut quarters = [[_mm512_setzero_ps(); 4]; 4];
                for j in 0..4 {
                    let (a, b) = (_mm512_loadu_ps(from[j]), _mm512_loadu_ps(from[j + 4]));
                    let (c, d) = (_mm512_loadu_ps(from[j + 8]), _mm512_loadu_ps(from[j + 12]));
                    quarters[j] = Self::interleave([a, b, c, d]);
                }
                for k in 0..4 {
                    let [a, b, c, d] = quarters;
                    let rows = Self::interleave([a[k], b[k], c[k], d[k]]);
                    for m in 0..4 {
                        _mm512_storeu_ps(to.add((4 * k + m) * step), rows[m]);
                    }
                }
            }
        }

        #[inline(always)]
        unsafe fn deinterleave([a, b, c, d]: [__m512; 4]) -> [__m512; 4] {
            unsafe {
                // Eight lanes of the first two vectors, then eight of the last two.
                let every_fourth =
                    _mm512_setr_epi32(0, 4, 8, 12, 16, 20, 24, 28, 0, 4, 8, 12, 16, 20, 24, 28);
                let mut sorted = [a; 4];
                // Not `from_fn`: a closure is not always compiled for the instruction set of its surroundings.
                for j in 0..4 {
                    let index = _mm512_add_epi32(every_fourth, _mm512_set1_epi32(j as i32));
                    let low = _mm512_permutex2var_ps(a, index, b);
                    sorted[j] = _mm512_mask_blend_ps(0xFF00, low, _mm512_permutex2var_ps(c, index, d));
                }
                sorted
            }
        }

        #[inline(always)]
        unsafe fn interleave([a, b, c, d]: [__m512; 4]) -> [__m512; 4] {
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
}

#[cfg(target_arch = "x86_64")]
pub(crate) use x86::{Avx2, Avx512};

/// The instruction sets a kernel can be compiled for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Isa {
    Portable,
    #[cfg(target_arch = "x86_64")]
    Avx2,
    #[cfg(target_arch = "x86_64")]
    Avx512,
}

impl Isa {
    /// Every instruction set of this processor, narrowest first.
    pub(crate) fn available() -> Vec<Isa> {
        let mut isas = vec![Isa::Portable];
        #[cfg(target_arch = "x86_64")]
        {
            if is_x86_feature_detected!("avx2") && is_x86_feature_detected!("fma") {
                isas.push(Isa::Avx2);
            }
            if is_x86_feature_detected!("avx512f") {
                isas.push(Isa::Avx512);
            }
        }
        isas
    }

    /// [`Simd::LANES`].
    pub(crate) fn lanes(self) -> usize {
        match self {
            Isa::Portable => Portable::LANES,
            #[cfg(target_arch = "x86_64")]
            Isa::Avx2 => Avx2::LANES,
            #[cfg(target_arch = "x86_64")]
            Isa::Avx512 => Avx512::LANES,
        }
    }

    /// [`Simd::TILE_ROWS`].
    pub(crate) fn tile_rows(self) -> usize {
        match self {
            Isa::Portable => Portable::TILE_ROWS,
            #[cfg(target_arch = "x86_64")]
            Isa::Avx2 => Avx2::TILE_ROWS,
            #[cfg(target_arch = "x86_64")]
            Isa::Avx512 => Avx512::TILE_ROWS,
        }
    }

    /// The widest instruction set of this processor.
    pub(crate) fn best() -> Isa {
        static BEST: std::sync::OnceLock<Isa> = std::sync::OnceLock::new();
        *BEST.get_or_init(|| Isa::available().pop().unwrap_or(Isa::Portable))
    }
}

/// Defines `$name(isa, arguments)` that runs the generic kernel `$kernel::<S>(arguments)` compiled for `isa`.
///
/// The value of `isa` must come from [`Isa::available`], which is what makes the call safe.
macro_rules! dispatch {
    ($(#[$doc:meta])* $vis:vis fn $name:ident = $kernel:ident($($arg:ident: $ty:ty),* $(,)?)) => {
        $(#[$doc])*
        $vis unsafe fn $name(isa: $crate::simd::Isa, $($arg: $ty),*) {
            #[cfg(target_arch = "x86_64")]
            #[target_feature(enable = "avx512f")]
            unsafe fn avx512($($arg: $ty),*) {
                // SAFETY: the caller's promise, passed on.
                unsafe { $kernel::<$crate::simd::Avx512>($($arg),*) }
            }
            #[cfg(target_arch = "x86_64")]
            #[target_feature(enable = "avx2,fma")]
            unsafe fn avx2($($arg: $ty),*) {
                // SAFETY: the caller's promise, passed on.
                unsafe { $kernel::<$crate::simd::Avx2>($($arg),*) }
            }
            // SAFETY: `isa` is one of this processor's; the rest is the caller's promise.
            unsafe {
                match isa {
                    $crate::simd::Isa::Portable => $kernel::<$crate::simd::Portable>($($arg),*),
                    #[cfg(target_arch = "x86_64")]
                    $crate::simd::Isa::Avx2 => avx2($($arg),*),
                    #[cfg(target_arch = "x86_64")]
                    $crate::simd::Isa::Avx512 => avx512($($arg),*),
                }
            }
        }
    };
}
pub(crate) use dispatch;

#[cfg(test)]
mod tests {
    use super::*;

    dispatch! {
        fn mix = mix_kernel(elements: &[f32], apart: &mut [f32], together: &mut [f32])
    }

    unsafe fn mix_kernel<S: Simd>(elements: &[f32], apart: &mut [f32], together: &mut [f32]) {
        // SAFETY: the slices hold four vectors of any instruction set.
        unsafe {
            let at = |j: usize| j * S::LANES;
            let load = |j: usize| S::load(elements[at(j)..].as_ptr());
            let sorted = S::deinterleave([load(0), load(1), load(2), load(3)]);
            let mixed = S::interleave(sorted);
            for j in 0..4 {
                S::store(apart[at(j)..].as_mut_ptr(), sorted[j]);
                S::store(together[at(j)..].as_mut_ptr(), mixed[j]);
            }
        }
    }

    dispatch! {
        fn turn = turn_kernel(from: &[*const f32; MOST_LANES], to: &mut [f32], step: usize)
    }

    unsafe fn turn_kernel<S: Simd>(from: &[*const f32; MOST_LANES], to: &mut [f32], step: usize) {
        // SAFETY: the slices are long enough for any instruction set.
        unsafe { S::transpose(from, to.as_mut_ptr(), step) }
    }

    #[test]
    fn rows_become_columns() {
        let elements: Vec<f32> = (0..MOST_LANES * 20).map(|i| i as f32).collect();
        let from: [*const f32; MOST_LANES] = std::array::from_fn(|i| elements[i * 20..].as_ptr());
        for isa in Isa::available() {
            let mut to = vec![-1.0; MOST_LANES * 17];
            // SAFETY: `isa` is available.
            unsafe { turn(isa, &from, &mut to, 17) }
            for (i, &found) in to.iter().enumerate() {
                let (row, column) = (i / 17, i % 17);
                let inside = row < isa.lanes() && column < isa.lanes();
                assert_eq!(found, if inside { elements[column * 20 + row] } else { -1.0 }, "{isa:?}");
            }
        }
    }

    #[test]
    fn every_fourth_element_goes_to_a_vector_of_its_own_and_back() {
        for isa in Isa::available() {
            let lanes = isa.lanes();
            let elements: Vec<f32> = (0..4 * lanes).map(|i| i as f32).collect();
            let (mut apart, mut together) = (vec![0.0; 4 * lanes], vec![0.0; 4 * lanes]);
            // SAFETY: `isa` is available.
            unsafe { mix(isa, &elements, &mut apart, &mut together) }
            for (at, &element) in apart.iter().enumerate() {
                assert_eq!(element, (4 * (at % lanes) + at / lanes) as f32, "{isa:?}");
            }
            assert_eq!(together, elements, "{isa:?}");
        }
    }
}
