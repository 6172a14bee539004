//! Products of bfloat16 by AMX (Intel SDM volume 2, `TDPBF16PS`): an instruction multiplies matrices of up to 16 x 32 and 32 x 16 factors,
//! as many as 32 vector instructions do.
//!
//! Its sums have an order of their own. Of each [`BLOCK`] of pairs, and of half a block at the end, first the pairs of even numbers are
//! summed, then those of odd ones: the first factors' products apart from the second factors', each product added and rounded to `f32`;
//! both sums are added to each other and then to what was there before. Subnormal numbers are zeros. Up to half a block of pairs remains
//! for AVX512-BF16.

use std::arch::asm;
use std::arch::x86_64::{__cpuid_count, __m512};
use std::marker::PhantomData;
use std::sync::OnceLock;

use crate::bf16::{self, numbers_of_exponents, without_subnormal};
use crate::{Avx512, Avx512Bf16, Isa, MAX_LANES, Multiply, Pair, Simd};

/// Pairs of factors that are transposed together.
pub(crate) const BLOCK: usize = 2 * MAX_LANES;
/// Pairs of factors after which AMX pays.
pub(crate) const LEAST: usize = BLOCK / 2;
/// Rows of a block of the left side. A tile holds one block or two.
pub(crate) const ROWS: usize = 8;
/// Rows of a tile of two blocks.
pub(crate) const MOST_ROWS: usize = 2 * ROWS;

/// Proof that the processor has AMX with bfloat16, that the system lets this process use it, and that it sums as described above.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Amx(Avx512Bf16);

impl Amx {
    /// Where `isa` is AVX-512 with AVX512-BF16, and there is AMX as well.
    #[inline]
    pub(crate) fn of(isa: Isa) -> Option<Self> {
        static FOUND: OnceLock<bool> = OnceLock::new();
        let pairs = Avx512Bf16::of(isa)?;
        // SAFETY: the processor and the permission are checked before an instruction of AMX runs.
        let found =
            FOUND.get_or_init(|| is_supported() && is_permitted() && unsafe { is_as_described(Self(pairs)) });
        found.then_some(Self(pairs))
    }

    /// The instruction set that it extends.
    #[inline(always)]
    pub(crate) fn pairs(self) -> Avx512Bf16 {
        self.0
    }
}

fn is_supported() -> bool {
    const BF16_AND_TILES: u32 = 1 << 22 | 1 << 24;
    const EXTENDED_FEATURES: u32 = 7;
    __cpuid_count(0, 0).eax >= EXTENDED_FEATURES
        && __cpuid_count(EXTENDED_FEATURES, 0).edx & BF16_AND_TILES == BF16_AND_TILES
}

/// Asks the system for the registers of AMX, which every process has to.
#[cfg(target_os = "linux")]
fn is_permitted() -> bool {
    const ARCH_REQ_XCOMP_PERM: libc::c_ulong = 0x1023;
    const XFEATURE_XTILEDATA: libc::c_ulong = 18;
    // SAFETY: the call changes nothing but the permission of this process.
    unsafe { libc::syscall(libc::SYS_arch_prctl, ARCH_REQ_XCOMP_PERM, XFEATURE_XTILEDATA) == 0 }
}

#[cfg(not(target_os = "linux"))]
fn is_permitted() -> bool {
    false
}

/// Shapes of the tile registers: their rows, and the bytes of a row.
#[repr(C, align(64))]
struct Shapes {
    palette: u8,
    start_row: u8,
    reserved: [u8; 14],
    bytes: [u16; 16],
    rows: [u8; 16],
}

impl Shapes {
    /// For so many rows of the left side. 0 to 2: sums of three vectors of columns. 3: the left side. 4 and 5: the right side. 6 and 7: both
    /// sides of half a block.
    const fn of_rows(rows: usize) -> Self {
        let (rows, half) = (rows as u8, (MAX_LANES / 2) as u8);
        let all = MAX_LANES as u8;
        Self {
            palette: 1,
            start_row: 0,
            reserved: [0; 14],
            bytes: [64, 64, 64, 64, 64, 64, 32, 64, 0, 0, 0, 0, 0, 0, 0, 0],
            rows: [rows, rows, rows, rows, all, all, rows, half, 0, 0, 0, 0, 0, 0, 0, 0],
        }
    }
}

static OF_ONE_BLOCK: Shapes = Shapes::of_rows(ROWS);
static OF_TWO_BLOCKS: Shapes = Shapes::of_rows(MOST_ROWS);

/// The registers of AMX of this thread, set up for [`accumulate`] with `R` rows, [`ROWS`] or [`MOST_ROWS`], until this is dropped: there is one at a
/// time. The compiler does not use them.
pub(crate) struct Tiles<const R: usize>(PhantomData<*mut ()>);

impl<const R: usize> Tiles<R> {
    pub(crate) fn new(_: Amx) -> Self {
        const { assert!(R == ROWS || R == MOST_ROWS) };
        let shapes = if R == ROWS { &raw const OF_ONE_BLOCK } else { &raw const OF_TWO_BLOCKS };
        // SAFETY: the token is the proof of AMX; the shapes are valid.
        unsafe { asm!("ldtilecfg [{}]", in(reg) shapes, options(nostack, preserves_flags, readonly)) };
        Self(PhantomData)
    }
}

impl<const R: usize> Drop for Tiles<R> {
    fn drop(&mut self) {
        // SAFETY: they were set up.
        unsafe { asm!("tilerelease", options(nostack, preserves_flags, nomem)) };
    }
}

/// Pairs of [`arrange`]d rows: those of `depth` in whole and half blocks.
pub(crate) fn arranged(depth: usize) -> usize {
    depth / LEAST * LEAST
}

/// Arranges `R` rows of a left side, one or two blocks of `[depth, ROWS]`, as tiles: of each [`BLOCK`] of pairs the even pairs of
/// each row, then the odd ones, each row 16 pairs long; of half a block 8, and 8 that are not used.
///
/// # Safety
/// `left` has `depth` times `R` elements; `to` has room for [`arranged`] pairs of as many rows, rounded up to a whole
/// block.
#[inline(always)]
pub(crate) unsafe fn arrange<const R: usize>(s: Avx512, left: *const f32, depth: usize, to: *mut f32) {
    for first in (0..arranged(depth)).step_by(BLOCK) {
        let vectors = if first + BLOCK <= depth { MAX_LANES } else { MAX_LANES / 2 };
        let to = |odd: usize| to.wrapping_add((first + odd * MAX_LANES) * R);
        // SAFETY: guaranteed by the caller. The pairs past the end are read in place of others.
        unsafe {
            if R == ROWS {
                // A vector has two pairs of each row: an even and an odd one.
                let sources = std::array::from_fn(|i| left.add((first + 2 * (i % vectors)) * ROWS));
                s.transpose(&sources, to(0), MAX_LANES);
                continue;
            }
            for odd in 0..2 {
                let mut both = [[0.0; MOST_ROWS]; MAX_LANES];
                for (i, both) in both.iter_mut().enumerate() {
                    let pair = left.add((first + 2 * (i % vectors) + odd) * ROWS);
                    both.as_mut_ptr().copy_from_nonoverlapping(pair, ROWS);
                    both.as_mut_ptr().add(ROWS).copy_from_nonoverlapping(pair.add(depth * ROWS), ROWS);
                }
                s.transpose(&both.each_ref().map(|both| both.as_ptr()), to(odd), MAX_LANES);
            }
        }
    }
}

macro_rules! load {
    ($tile:literal, $from:expr, $step:expr) => {
        asm!(
            concat!("tileloadd tmm", $tile, ", [{} + {}*1]"),
            in(reg) $from, in(reg) $step, options(nostack, preserves_flags, readonly)
        )
    };
}

macro_rules! store {
    ($tile:literal, $to:expr, $step:expr) => {
        asm!(
            concat!("tilestored [{} + {}*1], tmm", $tile),
            in(reg) $to, in(reg) $step, options(nostack, preserves_flags)
        )
    };
}

macro_rules! multiply {
    ($sums:literal, $left:literal, $right:literal) => {
        asm!(
            concat!("tdpbf16ps tmm", $sums, ", tmm", $left, ", tmm", $right),
            options(nostack, preserves_flags, nomem)
        )
    };
}

/// `values += left * right` for `R` rows of three vectors and the first [`arranged`] pairs of `depth`. `left` was
/// [`arrange`]d; `right` has rows of `3 * 16` pairs.
///
/// # Safety
/// `left` and `right` have so many rows, `values` all sums; the tiles are set up on this thread.
#[inline(always)]
pub(crate) unsafe fn accumulate<const R: usize>(
    _: &Tiles<R>,
    left: *const f32,
    right: *const f32,
    depth: usize,
    values: *mut f32,
) {
    const WIDTH: usize = 3 * MAX_LANES;
    const VECTOR: usize = size_of::<[f32; MAX_LANES]>();
    const ROW: usize = size_of::<[f32; WIDTH]>();
    // SAFETY: guaranteed by the caller.
    unsafe {
        load!(0, values, ROW);
        load!(1, values.add(MAX_LANES), ROW);
        load!(2, values.add(2 * MAX_LANES), ROW);
        // The right side in two registers in turn: one is loaded while the other is multiplied.
        macro_rules! add_half {
            ($left:literal, $from:expr, [$one:literal $two:literal $three:literal], $right:expr) => {
                let right: *const f32 = $right;
                load!($left, $from, VECTOR);
                load!($one, right, 2 * ROW);
                multiply!(0, $left, $one);
                load!($two, right.add(MAX_LANES), 2 * ROW);
                multiply!(1, $left, $two);
                load!($three, right.add(2 * MAX_LANES), 2 * ROW);
                multiply!(2, $left, $three);
            };
        }
        let whole = depth / BLOCK * BLOCK;
        for first in (0..whole).step_by(BLOCK) {
            let (left, right) = (left.add(first * R), right.add(first * WIDTH));
            add_half!(3, left, [4 5 4], right);
            add_half!(3, left.add(MAX_LANES * R), [5 4 5], right.add(WIDTH));
        }
        if whole < arranged(depth) {
            let (left, right) = (left.add(whole * R), right.add(whole * WIDTH));
            add_half!(6, left, [7 7 7], right);
            add_half!(6, left.add(MAX_LANES * R), [7 7 7], right.add(WIDTH));
        }
        store!(0, values, ROW);
        store!(1, values.add(MAX_LANES), ROW);
        store!(2, values.add(2 * MAX_LANES), ROW);
    }
}

/// `sum` plus the products of `pairs`: the definition.
pub(crate) fn add_products(mut sum: f32, pairs: &[(Pair, Pair)]) -> f32 {
    let mut rest = pairs;
    while rest.len() >= LEAST {
        let (block, others) = rest.split_at(if rest.len() >= BLOCK { BLOCK } else { LEAST });
        for odd in 0..2 {
            let mut sums = [0.0_f32; 2];
            for (left, right) in block.iter().skip(odd).step_by(2) {
                for (sum, (a, b)) in sums.iter_mut().zip(left.factors().into_iter().zip(right.factors())) {
                    *sum = without_subnormal(a.mul_add(b, *sum));
                }
            }
            sum = without_subnormal(without_subnormal(sum) + without_subnormal(sums[0] + sums[1]));
        }
        rest = others;
    }
    rest.iter().fold(sum, |sum, (left, right)| bf16::add_products(sum, *left, *right))
}

/// Whether the instructions sum as [`add_products`] does, on numbers where other orders differ.
#[target_feature(enable = "avx512bf16,avx512f,avx512bw,avx512dq,avx512vl,avx2,fma,bmi1,bmi2,popcnt")]
unsafe fn is_as_described(amx: Amx) -> bool {
    const DEPTH: usize = BLOCK + LEAST;
    const WIDTH: usize = 3 * MAX_LANES;
    let s = amx.pairs().avx512();
    let mut next = numbers_of_exponents();
    // Ordinary numbers, then products and sums around the smallest normal one.
    [[120, 120, 115], [61, 61, 0]].into_iter().all(|[of_left, of_right, of_sums]| {
        let mut pairs = |count: usize, lowest: u32| {
            (0..count).map(|_| Pair::new(next(lowest), next(lowest))).collect::<Vec<Pair>>()
        };
        let (left, right) = (pairs(DEPTH * MOST_ROWS, of_left), pairs(DEPTH * WIDTH, of_right));
        let start: Vec<f32> = (0..MOST_ROWS * WIDTH).map(|_| next(of_sums)).collect();
        let mut found = [start.clone(), start.clone()];
        let mut tiles = vec![0.0_f32; 2 * BLOCK * MOST_ROWS];
        let (left_start, right_start) = (left.as_ptr().cast::<f32>(), right.as_ptr().cast());
        // SAFETY: the token is the proof of the instructions; all slices have the lengths that are asked for.
        unsafe {
            arrange::<MOST_ROWS>(s, left_start, DEPTH, tiles.as_mut_ptr());
            accumulate(
                &Tiles::<MOST_ROWS>::new(amx),
                tiles.as_ptr(),
                right_start,
                DEPTH,
                found[0].as_mut_ptr(),
            );
            for block in 0..2 {
                arrange::<ROWS>(s, left_start.add(block * DEPTH * ROWS), DEPTH, tiles.as_mut_ptr());
                let found = found[1][block * ROWS * WIDTH..].as_mut_ptr();
                accumulate(&Tiles::<ROWS>::new(amx), tiles.as_ptr(), right_start, DEPTH, found);
            }
        }
        (0..MOST_ROWS * WIDTH).all(|i| {
            let (row, column) = (i / WIDTH, i % WIDTH);
            let left = &left[row / ROWS * DEPTH * ROWS + row % ROWS..];
            let products: Vec<(Pair, Pair)> =
                (0..DEPTH).map(|k| (left[k * ROWS], right[k * WIDTH + column])).collect();
            let expected = add_products(start[i], &products).to_bits();
            found.iter().all(|found| found[i].to_bits() == expected)
        })
    })
}

/// As AVX512-BF16, where tiles do not fit.
impl Multiply<Avx512> for Amx {
    const FACTORS: usize = 2;

    #[inline(always)]
    fn add(self, s: Avx512, left: __m512, right: __m512, sums: __m512) -> __m512 {
        self.0.add(s, left, right, sums)
    }

    #[inline(always)]
    fn pair(self, s: Avx512, first: __m512, second: __m512) -> __m512 {
        self.0.pair(s, first, second)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn amx_is_used_where_the_processor_and_the_system_have_it() {
        let isa = Isa::best();
        if Avx512Bf16::of(isa).is_none() || !is_supported() || !is_permitted() {
            println!("skipped: amx: not on this machine");
            return;
        }
        assert!(Amx::of(isa).is_some(), "it does not sum as described");
    }
}
