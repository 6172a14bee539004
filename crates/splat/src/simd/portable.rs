use std::array;

use super::{InstructionSet, LANES, Row};

/// Plain Rust: what the compiler makes of sixteen-element loops.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Portable;

impl InstructionSet for Portable {
    type Vector = [f32; LANES];
    type Mask = [bool; LANES];

    #[inline(always)]
    fn prefetch<T>(self, _item: &T) {}

    #[inline(always)]
    fn splat(self, value: f32) -> [f32; LANES] {
        [value; LANES]
    }

    #[inline(always)]
    fn load(self, row: &Row) -> [f32; LANES] {
        row.0
    }

    #[inline(always)]
    fn store(self, vector: [f32; LANES], row: &mut Row) {
        row.0 = vector;
    }

    #[inline(always)]
    fn add(self, a: [f32; LANES], b: [f32; LANES]) -> [f32; LANES] {
        array::from_fn(|i| a[i] + b[i])
    }

    #[inline(always)]
    fn sub(self, a: [f32; LANES], b: [f32; LANES]) -> [f32; LANES] {
        array::from_fn(|i| a[i] - b[i])
    }

    #[inline(always)]
    fn mul(self, a: [f32; LANES], b: [f32; LANES]) -> [f32; LANES] {
        array::from_fn(|i| a[i] * b[i])
    }

    #[inline(always)]
    fn mul_add(self, a: [f32; LANES], b: [f32; LANES], c: [f32; LANES]) -> [f32; LANES] {
        array::from_fn(|i| a[i].mul_add(b[i], c[i]))
    }

    #[inline(always)]
    fn neg_mul_add(self, a: [f32; LANES], b: [f32; LANES], c: [f32; LANES]) -> [f32; LANES] {
        array::from_fn(|i| (-a[i]).mul_add(b[i], c[i]))
    }

    #[inline(always)]
    fn min(self, a: [f32; LANES], b: [f32; LANES]) -> [f32; LANES] {
        array::from_fn(|i| if a[i] < b[i] { a[i] } else { b[i] })
    }

    #[inline(always)]
    fn max(self, a: [f32; LANES], b: [f32; LANES]) -> [f32; LANES] {
        array::from_fn(|i| if a[i] > b[i] { a[i] } else { b[i] })
    }

    #[inline(always)]
    fn negative(self, a: [f32; LANES]) -> [f32; LANES] {
        array::from_fn(|i| -a[i].abs())
    }

    #[inline(always)]
    fn scale(self, a: [f32; LANES], rounded: [f32; LANES]) -> [f32; LANES] {
        array::from_fn(|i| f32::from_bits(a[i].to_bits().wrapping_add(rounded[i].to_bits() << 23)))
    }

    #[inline(always)]
    fn at_least(self, a: [f32; LANES], b: [f32; LANES]) -> [bool; LANES] {
        array::from_fn(|i| a[i] >= b[i])
    }

    #[inline(always)]
    fn and(self, a: [bool; LANES], b: [bool; LANES]) -> [bool; LANES] {
        array::from_fn(|i| a[i] & b[i])
    }

    #[inline(always)]
    fn and_not(self, a: [bool; LANES], b: [bool; LANES]) -> [bool; LANES] {
        array::from_fn(|i| a[i] & !b[i])
    }

    #[inline(always)]
    fn select(self, mask: [bool; LANES], a: [f32; LANES], b: [f32; LANES]) -> [f32; LANES] {
        array::from_fn(|i| if mask[i] { a[i] } else { b[i] })
    }

    #[inline(always)]
    fn bits(self, mask: [bool; LANES]) -> u16 {
        (0..LANES).fold(0, |bits, i| bits | u16::from(mask[i]) << i)
    }
}
