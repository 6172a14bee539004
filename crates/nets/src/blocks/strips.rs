//! Maps that are computed a strip of rows at a time, so that what lies between takes the memory of a strip.

use std::collections::VecDeque;
use std::ops::Range;

use burn::tensor::Tensor;

/// Pixels of a strip, about.
const PIXELS: usize = 1 << 17;

/// How maps of one size are divided.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Strips {
    height: usize,
    rows: usize,
}

impl Strips {
    /// For maps of this height and width.
    pub(crate) fn new([height, width]: [usize; 2]) -> Self {
        Self::of_rows(height, (PIXELS / width.max(1)).max(1))
    }

    /// Of so many rows.
    pub(crate) fn of_rows(height: usize, rows: usize) -> Self {
        Self { height, rows }
    }

    /// Whether one strip is all.
    pub(crate) fn whole(self) -> bool {
        self.rows >= self.height
    }

    /// What `of` makes of strips of `inputs` (`[batch, channels, height, width]`), one after the other, each without the rows
    /// beside the strip. It gets the strip's rows with up to `beside` more above and below, as far as its result reaches.
    pub(crate) fn each<const N: usize, const M: usize>(
        self,
        inputs: &[Tensor<4>; N],
        beside: usize,
        mut of: impl FnMut(Range<usize>, [Tensor<4>; N]) -> [Tensor<4>; M],
        mut take: impl FnMut([Tensor<4>; M]),
    ) {
        for first in (0..self.height).step_by(self.rows.max(1)) {
            let rows = self.rows.min(self.height - first);
            let above = first.min(beside);
            let below = beside.min(self.height - first - rows);
            let with_beside = first - above..first + rows + below;
            let strips = inputs.each_ref().map(|x| x.clone().narrow(2, with_beside.start, with_beside.len()));
            take(of(with_beside, strips).map(|x| x.narrow(2, above, rows)));
        }
    }

    /// Like [`map`](Self::map) of one map, without putting the strips together.
    pub(crate) fn divided(self, input: Tensor<4>, of: impl Fn(Tensor<4>) -> Tensor<4>) -> Divided {
        if self.whole() {
            return Divided::of_whole(of(input));
        }
        let mut divided = Divided::default();
        self.each(&[input], 0, |_, [input]| [of(input)], |[strip]| divided.push(strip));
        divided
    }

    /// What `of` makes of `inputs`, as [`each`](Self::each), put together.
    pub(crate) fn map<const N: usize, const M: usize>(
        self,
        inputs: [Tensor<4>; N],
        beside: usize,
        of: impl FnMut(Range<usize>, [Tensor<4>; N]) -> [Tensor<4>; M],
    ) -> [Tensor<4>; M] {
        let mut made = [const { Vec::new() }; M];
        self.each(&inputs, beside, of, |maps| {
            made.iter_mut().zip(maps).for_each(|(made, map)| made.push(map));
        });
        // Memory is needed most when they are put together.
        drop(inputs);
        made.map(|strips| Tensor::cat(strips, 2))
    }

    /// Sums over all strips of what `sum` makes of `of`. Panics without rows.
    pub(crate) fn sums<const N: usize, const M: usize>(
        self,
        inputs: &[Tensor<4>; N],
        beside: usize,
        of: impl FnMut([Tensor<4>; N]) -> Tensor<4>,
        sum: impl Fn(Tensor<4>) -> [Tensor<2>; M],
    ) -> [Tensor<2>; M] {
        let mut of = of;
        let mut parts = [const { Vec::new() }; M];
        self.each(
            inputs,
            beside,
            |_, strips| [of(strips)],
            |[map]| {
                parts.iter_mut().zip(sum(map)).for_each(|(parts, part)| parts.push(part));
            },
        );
        parts.map(|parts| Tensor::stack::<3>(parts, 0).sum_dim(0).squeeze_dim(0))
    }
}

/// A map in strips, each with memory of its own, so that it can be freed a strip at a time.
#[derive(Default)]
pub(crate) struct Divided {
    /// From the top on, with their rows.
    strips: VecDeque<(Range<usize>, Tensor<4>)>,
}

impl Divided {
    /// A map in one piece.
    pub(crate) fn of_whole(map: Tensor<4>) -> Self {
        Self { strips: [(0..map.dims()[2], map)].into() }
    }

    /// Adds rows below the others.
    pub(crate) fn push(&mut self, strip: Tensor<4>) {
        let top = self.strips.back().map_or(0, |(rows, _)| rows.end);
        // A copy, as the strip may be a part of a larger one, all of which would be kept.
        self.strips.push_back((top..top + strip.dims()[2], strip.mul_scalar(1.0)));
    }

    /// Some rows. Panics when there are none.
    pub(crate) fn rows(&self, rows: Range<usize>) -> Tensor<4> {
        let parts = self.strips.iter().filter_map(|(own, strip)| {
            let (start, end) = (rows.start.max(own.start), rows.end.min(own.end));
            (start < end).then(|| strip.clone().narrow(2, start - own.start, end - start))
        });
        let mut parts: Vec<Tensor<4>> = parts.collect();
        if parts.len() == 1 { parts.remove(0) } else { Tensor::cat(parts, 2) }
    }

    /// Frees strips of which no row is at `row` or below.
    pub(crate) fn free_above(&mut self, row: usize) {
        while self.strips.front().is_some_and(|(rows, _)| rows.end <= row) {
            self.strips.pop_front();
        }
    }

    /// All rows.
    pub(crate) fn whole(self) -> Tensor<4> {
        let mut strips: Vec<Tensor<4>> = self.strips.into_iter().map(|(_, strip)| strip).collect();
        if strips.len() == 1 { strips.remove(0) } else { Tensor::cat(strips, 2) }
    }
}

#[cfg(test)]
mod tests {
    use burn::tensor::{Device, TensorData};
    use srflow_ops::golden::numbers;

    use super::*;

    /// A mean of three rows, as of a kernel of 3, and a sum.
    #[test]
    fn strips_give_what_the_whole_gives() {
        let values: Vec<f32> = (0..2 * 11 * 3).map(|i| ((i * 37) % 19) as f32).collect();
        let map = Tensor::<4>::from_data(TensorData::new(values, [1, 2, 11, 3]), &Device::flex());
        let smooth = |x: Tensor<4>| {
            let [_, _, rows, _] = x.dims();
            let edge = |row: usize| x.clone().narrow(2, row, 1);
            let padded = Tensor::cat(vec![edge(0), x.clone(), edge(rows - 1)], 2);
            padded.clone().narrow(2, 0, rows) + padded.clone().narrow(2, 1, rows) + padded.narrow(2, 2, rows)
        };
        let whole = smooth(map.clone());
        let total: f32 = numbers(whole.clone()).iter().sum();
        for rows in [1, 2, 4, 10, 11, 100] {
            let strips = Strips::of_rows(11, rows);
            assert_eq!(strips.whole(), rows >= 11);
            let [found] = strips.map([map.clone()], 1, |of_map, [x]| {
                assert_eq!(numbers(x.clone()), numbers(map.clone().narrow(2, of_map.start, of_map.len())));
                [smooth(x)]
            });
            assert_eq!(numbers(found), numbers(whole.clone()), "{rows} rows");
            let mut divided = strips.divided(map.clone(), |x| x);
            for first in (0..8).step_by(3) {
                divided.free_above(first);
                let found = numbers(divided.rows(first..first + 3));
                assert_eq!(found, numbers(map.clone().narrow(2, first, 3)), "{rows} rows");
            }
            assert!(
                rows > 5 || divided.strips.len() < 11_usize.div_ceil(rows),
                "{rows} rows: none was freed"
            );
            let sum = |x: Tensor<4>| [x.sum().reshape([1, 1])];
            let inputs = [map.clone()];
            let [found] = strips.sums(&inputs, 1, |[x]| smooth(x), sum);
            assert_eq!(numbers(found), [total], "{rows} rows");
        }
    }
}
