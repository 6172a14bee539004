//! Left sides of products in the order in which the kernels read them.

use std::ops::Range;

use rayon::prelude::*;

use crate::{Isa, MAX_LANES, Pair, Precision, Simd, dispatch};

/// The left sides of one or more products with as many rows each: blocks of a register tile's rows (the last may have fewer), each
/// stored as `[depth, rows of the block]`, in `f32` or as [`Pair`]s of neighbouring factors of a row.
#[derive(Debug, Clone, PartialEq)]
pub struct Packed {
    elements: Elements,
    /// The elements of each matrix.
    parts: Vec<Range<usize>>,
}

#[derive(Debug, Clone, PartialEq)]
enum Elements {
    F32(Vec<f32>),
    Bf16(Vec<Pair>),
}

/// A matrix of a [`Packed`], or its last rows.
#[derive(Debug, Clone, Copy)]
pub enum Left<'a> {
    /// A number for each factor.
    F32(&'a [f32]),
    /// A pair for every two factors of a row; a missing last one is zero.
    Bf16(&'a [Pair]),
}

impl<'a> Left<'a> {
    /// What is multiplied.
    pub fn precision(self) -> Precision {
        match self {
            Left::F32(_) => Precision::F32,
            Left::Bf16(_) => Precision::Bf16,
        }
    }

    /// Without the first `rows` of `depth` factors, which must be whole blocks.
    pub fn after_rows(self, rows: usize, depth: usize) -> Self {
        let skipped = rows * self.precision().packed(depth);
        match self {
            Left::F32(numbers) => Left::F32(&numbers[skipped..]),
            Left::Bf16(pairs) => Left::Bf16(&pairs[skipped..]),
        }
    }

    /// Number of elements.
    pub(crate) fn len(self) -> usize {
        match self {
            Left::F32(numbers) => numbers.len(),
            Left::Bf16(pairs) => pairs.len(),
        }
    }
}

/// The memory of one part, to be packed by the task that it belongs to.
enum PartMut<'a> {
    F32(&'a mut [f32]),
    Bf16(&'a mut [Pair]),
}

impl Packed {
    /// A matrix `[rows, depth]`. Panics when its length is not a multiple of `depth`.
    pub fn rows(isa: Isa, precision: Precision, matrix: &[f32], depth: usize) -> Self {
        assert!(matrix.len().is_multiple_of(depth.max(1)), "rows of {depth}");
        Self::parts(isa, precision, matrix.len() / depth.max(1), &[depth], |_, to| to.copy_from_slice(matrix))
    }

    /// A matrix of `rows` rows for each of `depths`: `fill` writes the one of a number, `[rows, depth]`, in one of several tasks.
    pub fn parts(
        isa: Isa,
        precision: Precision,
        rows: usize,
        depths: &[usize],
        fill: impl Fn(usize, &mut [f32]) + Sync,
    ) -> Self {
        Self::fill(precision, rows, depths, |number, part| {
            let depth = depths[number];
            let mut matrix = vec![0.0; rows * depth];
            fill(number, &mut matrix);
            if matrix.is_empty() {
                return;
            }
            let block = isa.tile_rows();
            let blocks = matrix.chunks(block * depth);
            match part {
                PartMut::F32(part) => {
                    let blocks = part.chunks_mut(block * depth).zip(blocks);
                    blocks.for_each(|(to, from)| pack_block(isa, from, depth, to));
                }
                PartMut::Bf16(part) => {
                    let blocks = part.chunks_mut(block * depth.div_ceil(2)).zip(blocks);
                    blocks.for_each(|(to, from)| pack_block_of_pairs(from, depth, to));
                }
            }
        })
    }

    /// The transpose of `[depth, rows]`, without transposing it first. Panics when the length is not a multiple of `rows`.
    pub fn columns(isa: Isa, precision: Precision, matrix: &[f32], rows: usize) -> Self {
        assert!(matrix.len().is_multiple_of(rows.max(1)), "columns of {rows}");
        let depth = matrix.len() / rows.max(1);
        let block = isa.tile_rows();
        Self::fill(precision, rows, &[depth], |_, part| {
            if matrix.is_empty() {
                return;
            }
            match part {
                PartMut::F32(part) => {
                    part.par_chunks_mut(block * depth).enumerate().for_each(|(number, to)| {
                        let (first, rows_here) = (number * block, to.len() / depth);
                        for (to, plane) in to.chunks_exact_mut(rows_here).zip(matrix.chunks_exact(rows)) {
                            to.copy_from_slice(&plane[first..first + rows_here]);
                        }
                    });
                }
                PartMut::Bf16(part) => {
                    let steps = depth.div_ceil(2);
                    part.par_chunks_mut(block * steps).enumerate().for_each(|(number, to)| {
                        let (first, rows_here) = (number * block, to.len() / steps);
                        for (to, planes) in to.chunks_exact_mut(rows_here).zip(matrix.chunks(2 * rows)) {
                            let (one, other) = planes.split_at(rows);
                            for (row, to) in to.iter_mut().enumerate() {
                                let second = other.get(first + row).copied().unwrap_or(0.0);
                                *to = Pair::new(one[first + row], second);
                            }
                        }
                    });
                }
            }
        })
    }

    fn fill(
        precision: Precision,
        rows: usize,
        depths: &[usize],
        fill: impl Fn(usize, PartMut) + Sync,
    ) -> Self {
        let mut end = 0;
        let part = |depth: &usize| {
            let start = end;
            end += rows * precision.packed(*depth);
            start..end
        };
        let parts: Vec<Range<usize>> = depths.iter().map(part).collect();
        let elements = match precision {
            Precision::F32 => {
                let mut numbers = vec![0.0; end];
                let memory = split(&mut numbers, &parts).into_par_iter().enumerate();
                memory.for_each(|(number, part)| fill(number, PartMut::F32(part)));
                Elements::F32(numbers)
            }
            Precision::Bf16 => {
                let mut pairs = vec![Pair::default(); end];
                let memory = split(&mut pairs, &parts).into_par_iter().enumerate();
                memory.for_each(|(number, part)| fill(number, PartMut::Bf16(part)));
                Elements::Bf16(pairs)
            }
        };
        Self { elements, parts }
    }

    /// Numbers in any order, for kernels that are not products.
    pub fn of_numbers(numbers: Vec<f32>) -> Self {
        Self { parts: std::iter::once(0..numbers.len()).collect(), elements: Elements::F32(numbers) }
    }

    /// What [`Self::of_numbers`] was given. Panics when these are pairs.
    pub fn numbers(&self) -> &[f32] {
        match &self.elements {
            Elements::F32(numbers) => numbers,
            Elements::Bf16(_) => panic!("numbers, not pairs of them"),
        }
    }

    /// The matrix of a number. Panics when there is none.
    pub fn part(&self, number: usize) -> Left<'_> {
        let part = self.parts[number].clone();
        match &self.elements {
            Elements::F32(numbers) => Left::F32(&numbers[part]),
            Elements::Bf16(pairs) => Left::Bf16(&pairs[part]),
        }
    }

    /// What is multiplied.
    pub fn precision(&self) -> Precision {
        match self.elements {
            Elements::F32(_) => Precision::F32,
            Elements::Bf16(_) => Precision::Bf16,
        }
    }
}

/// The memory of each part; they follow one another.
fn split<'a, T>(mut rest: &'a mut [T], parts: &[Range<usize>]) -> Vec<&'a mut [T]> {
    let mut memory = Vec::with_capacity(parts.len());
    for part in parts {
        let (own, others) = rest.split_at_mut(part.len());
        memory.push(own);
        rest = others;
    }
    memory
}

/// One block of pairs.
fn pack_block_of_pairs(from: &[f32], depth: usize, to: &mut [Pair]) {
    let rows = from.len() / depth;
    for (row, factors) in from.chunks_exact(depth).enumerate() {
        for (to, two) in to[row..].iter_mut().step_by(rows).zip(factors.chunks(2)) {
            *to = Pair::new(two[0], two.get(1).copied().unwrap_or(0.0));
        }
    }
}

dispatch! {
    /// One block of numbers.
    fn pack_block = pack_block_kernel(from: &[f32], depth: usize, to: &mut [f32])
}

#[inline(always)]
fn pack_block_kernel<S: Simd>(s: S, from: &[f32], depth: usize, to: &mut [f32]) {
    let rows = from.len() / depth;
    let mut first = 0;
    if rows * 2 == S::LANES {
        // Two vectors of each row make a square.
        let mut square = [0.0; MAX_LANES * MAX_LANES];
        while first + 2 * S::LANES <= depth {
            let mut sources = [std::ptr::null(); MAX_LANES];
            for row in 0..rows {
                let values = &from[row * depth + first..][..2 * S::LANES];
                sources[row] = values.as_ptr();
                sources[rows + row] = values[S::LANES..].as_ptr();
            }
            // SAFETY: each source is one vector long, and the square holds its columns.
            unsafe { s.transpose(&sources, square.as_mut_ptr(), S::LANES) }
            let (left, right) = to[first * rows..][..2 * S::LANES * rows].split_at_mut(S::LANES * rows);
            let halves = left.chunks_exact_mut(rows).zip(right.chunks_exact_mut(rows));
            for ((left, right), values) in halves.zip(square.chunks_exact(S::LANES)) {
                left.copy_from_slice(&values[..rows]);
                right.copy_from_slice(&values[rows..]);
            }
            first += 2 * S::LANES;
        }
    }
    for (row, values) in from.chunks_exact(depth).enumerate() {
        for (i, &value) in values.iter().enumerate().skip(first) {
            to[i * rows + row] = value;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// `[rows, depth]`, each number its own.
    fn matrix(rows: usize, depth: usize) -> Vec<f32> {
        (0..rows * depth).map(|i| i as f32 / 4.0).collect()
    }

    fn transposed(matrix: &[f32], depth: usize) -> Vec<f32> {
        (0..depth).flat_map(|k| matrix.iter().skip(k).step_by(depth).copied()).collect()
    }

    #[test]
    fn each_factor_lies_at_its_place() {
        for isa in Isa::to_test() {
            let tile = isa.tile_rows();
            for (rows, depth) in [(1, 1), (tile, 2 * isa.lanes()), (2 * tile + 3, 37), (tile - 1, 2)] {
                let numbers = matrix(rows, depth);
                let block = |row: usize| (row / tile, row % tile, tile.min(rows - row / tile * tile));
                let packed = Packed::rows(isa, Precision::F32, &numbers, depth);
                let Left::F32(found) = packed.part(0) else { panic!("numbers") };
                for (row, k) in (0..rows).flat_map(|row| (0..depth).map(move |k| (row, k))) {
                    let (number, within, height) = block(row);
                    let at = number * tile * depth + k * height + within;
                    assert_eq!(found[at], numbers[row * depth + k], "{isa:?}: row {row}, factor {k}");
                }
                let packed = Packed::rows(isa, Precision::Bf16, &numbers, depth);
                let Left::Bf16(found) = packed.part(0) else { panic!("pairs") };
                let steps = depth.div_ceil(2);
                for (row, k) in (0..rows).flat_map(|row| (0..steps).map(move |k| (row, k))) {
                    let (number, within, height) = block(row);
                    let at = number * tile * steps + k * height + within;
                    let factor = |k: usize| if k < depth { numbers[row * depth + k] } else { 0.0 };
                    let expected = Pair::new(factor(2 * k), factor(2 * k + 1));
                    assert_eq!(found[at], expected, "{isa:?}: row {row}, pair {k}");
                }
            }
        }
    }

    #[test]
    fn columns_are_the_rows_of_the_transpose() {
        for isa in Isa::to_test() {
            for (precision, rows, depth) in
                [(Precision::F32, 21, 5), (Precision::Bf16, 21, 5), (Precision::Bf16, 8, 6)]
            {
                let numbers = matrix(rows, depth);
                let columns = Packed::columns(isa, precision, &transposed(&numbers, depth), rows);
                assert_eq!(columns, Packed::rows(isa, precision, &numbers, depth), "{isa:?} {precision:?}");
            }
        }
    }

    #[test]
    fn parts_are_packed_one_by_one() {
        let isa = Isa::best();
        for precision in [Precision::F32, Precision::Bf16] {
            let depths = [4, 7, 0, 3];
            let fill = |number: usize, to: &mut [f32]| to.copy_from_slice(&matrix(10, depths[number]));
            let packed = Packed::parts(isa, precision, 10, &depths, fill);
            for (number, depth) in depths.into_iter().enumerate() {
                let alone = Packed::rows(isa, precision, &matrix(10, depth), depth);
                match (packed.part(number), alone.part(0)) {
                    (Left::F32(found), Left::F32(expected)) => assert_eq!(found, expected),
                    (Left::Bf16(found), Left::Bf16(expected)) => assert_eq!(found, expected),
                    parts => panic!("{parts:?}"),
                }
            }
        }
    }
}
