use std::array;

use crate::Simd;
use crate::bf16::{UPPER, rounded};
use crate::vector::each;

/// Plain Rust: loops over eight elements, which the compiler vectorizes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Portable;

type F = [f32; 8];
type M = [bool; 8];

impl Simd for Portable {
    type Vector = F;
    type Mask = M;
    const LANES: usize = 8;
    const TILE_ROWS: usize = 4;

    #[inline(always)]
    fn prefetch<T>(self, _item: &T) {}

    #[inline(always)]
    fn splat(self, x: f32) -> [f32; 8] {
        [x; 8]
    }

    #[inline(always)]
    unsafe fn load(self, from: *const f32) -> [f32; 8] {
        // SAFETY: the caller passes LANES readable elements.
        unsafe { from.cast::<[f32; 8]>().read_unaligned() }
    }

    #[inline(always)]
    unsafe fn load_first(self, from: *const f32, count: usize) -> [f32; 8] {
        // SAFETY: the caller passes `count` readable elements.
        array::from_fn(|i| if i < count { unsafe { *from.add(i) } } else { 0.0 })
    }

    #[inline(always)]
    unsafe fn store(self, to: *mut f32, v: [f32; 8]) {
        // SAFETY: the caller passes LANES writable elements.
        unsafe { to.cast::<[f32; 8]>().write_unaligned(v) }
    }

    #[inline(always)]
    unsafe fn store_first(self, to: *mut f32, v: [f32; 8], count: usize) {
        for (i, x) in v.into_iter().enumerate().take(count) {
            // SAFETY: the caller passes `count` writable elements.
            unsafe { *to.add(i) = x }
        }
    }

    #[inline(always)]
    fn scale_by_power_of_two(self, a: F, rounded: F) -> F {
        array::from_fn(|i| f32::from_bits(a[i].to_bits().wrapping_add(rounded[i].to_bits() << 23)))
    }

    each! {
        add(a: F, b: F) -> F = array::from_fn(|i| a[i] + b[i]);
        sub(a: F, b: F) -> F = array::from_fn(|i| a[i] - b[i]);
        mul(a: F, b: F) -> F = array::from_fn(|i| a[i] * b[i]);
        div(a: F, b: F) -> F = array::from_fn(|i| a[i] / b[i]);
        mul_add(a: F, b: F, c: F) -> F = array::from_fn(|i| a[i].mul_add(b[i], c[i]));
        neg_mul_add(a: F, b: F, c: F) -> F = array::from_fn(|i| (-a[i]).mul_add(b[i], c[i]));
        min(a: F, b: F) -> F = array::from_fn(|i| if a[i] < b[i] { a[i] } else { b[i] });
        max(a: F, b: F) -> F = array::from_fn(|i| if a[i] > b[i] { a[i] } else { b[i] });
        sqrt(a: F) -> F = a.map(f32::sqrt);
        negative(a: F) -> F = a.map(|a| -a.abs());
        at_least(a: F, b: F) -> M = array::from_fn(|i| a[i] >= b[i]);
        greater(a: F, b: F) -> M = array::from_fn(|i| a[i] > b[i]);
        and(a: M, b: M) -> M = array::from_fn(|i| a[i] & b[i]);
        and_not(a: M, b: M) -> M = array::from_fn(|i| a[i] & !b[i]);
        select(mask: M, a: F, b: F) -> F = array::from_fn(|i| if mask[i] { a[i] } else { b[i] });
        bits(mask: M) -> u16 = (0..8).fold(0, |bits, i| bits | u16::from(mask[i]) << i);
        sum(v: F) -> f32 = v.iter().sum();
        pair(a: F, b: F) -> F = array::from_fn(|i| f32::from_bits(rounded(a[i]) >> 16 | rounded(b[i])));
        firsts(pairs: F) -> F = pairs.map(|pair| f32::from_bits(pair.to_bits() << 16));
        seconds(pairs: F) -> F = pairs.map(|pair| f32::from_bits(pair.to_bits() & UPPER));
    }
}
