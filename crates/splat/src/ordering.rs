//! Assigning splats to tiles, and sorting them by depth.

use crate::projection::Placement;

/// Splats sorted front to back.
#[derive(Debug, Default)]
pub(crate) struct DepthOrder {
    /// Bits of the depth in the high half, index in the low half.
    keys: Vec<u64>,
    scratch: Vec<u64>,
    drawn: Vec<Drawn>,
}

/// A splat in depth order.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub(crate) struct Drawn {
    /// Index of the splat.
    pub splat: u32,
    /// Rows of tiles, as [`Placement::rows`].
    pub rows: [u16; 2],
    /// Columns of tiles, as [`Placement::columns`].
    pub columns: [u16; 2],
}

impl DepthOrder {
    /// The visible splats, sorted by depth as `f32`, equal depths by index.
    pub(crate) fn sort(&mut self, placements: &[Placement]) -> &[Drawn] {
        self.keys.clear();
        for (index, placement) in placements.iter().enumerate() {
            if !placement.is_hidden() {
                self.keys.push(u64::from(placement.depth_bits) << 32 | index as u64);
            }
        }
        sort_by_high_half(&mut self.keys, &mut self.scratch);
        self.drawn.clear();
        self.drawn.extend(self.keys.iter().map(|&key| {
            let splat = key as u32;
            let Placement { rows, columns, .. } = placements[splat as usize];
            Drawn { splat, rows, columns }
        }));
        &self.drawn
    }
}

/// Stable radix sort, least significant digit first, over the bits of the high halves that differ.
fn sort_by_high_half(keys: &mut Vec<u64>, scratch: &mut Vec<u64>) {
    const DIGIT: u32 = 11;
    let Some(low) = keys.iter().map(|key| key >> 32).min() else { return };
    let span = keys.iter().map(|key| (key >> 32) - low).max().unwrap_or(0);
    scratch.resize(keys.len(), 0);
    for shift in (0..64 - span.leading_zeros()).step_by(DIGIT as usize) {
        let digit = |key: u64| (((key >> 32) - low) >> shift) as usize & ((1 << DIGIT) - 1);
        let mut starts = [0; 1 << DIGIT];
        for &key in &*keys {
            starts[digit(key)] += 1;
        }
        let mut total = 0;
        for start in &mut starts {
            total += std::mem::replace(start, total);
        }
        for &key in &*keys {
            let start = &mut starts[digit(key)];
            scratch[*start] = key;
            *start += 1;
        }
        std::mem::swap(keys, scratch);
    }
}

/// Items assigned to a row of bins (strips of the image, tiles of a strip), each item to all bins of its span.
#[derive(Debug)]
pub(crate) struct Bins<T> {
    /// Bin `b` is `entries[starts[b]..starts[b + 1]]`.
    starts: Vec<usize>,
    entries: Vec<T>,
}

impl<T> Default for Bins<T> {
    fn default() -> Self {
        Self { starts: Vec::new(), entries: Vec::new() }
    }
}

impl<T: Copy + Default> Bins<T> {
    /// If items span more bins than this on average, lists would cost more memory than they save time: every bin then contains
    /// all items.
    const MAX_MEAN_SPAN: usize = 16;

    /// Assigns `items`, each with its span (first bin, and one past the last), keeping their order within each bin. A bin may
    /// contain items that do not span it.
    pub(crate) fn deal(&mut self, bins: usize, items: impl ExactSizeIterator<Item = (T, [u16; 2])> + Clone) {
        // During assignment, `starts[b + 1]` is the position of the next entry of bin `b`; before that, the difference between
        // the numbers of entries of bins `b - 1` and `b - 2`.
        let starts = &mut self.starts;
        starts.clear();
        starts.resize(bins + 3, 0);
        for (_, [first, end]) in items.clone() {
            starts[usize::from(first) + 2] = starts[usize::from(first) + 2].wrapping_add(1);
            starts[usize::from(end) + 2] = starts[usize::from(end) + 2].wrapping_sub(1);
        }
        let (mut count, mut total) = (0_usize, 0);
        for start in &mut starts[2..] {
            count = count.wrapping_add(*start);
            total += count;
            *start = total;
        }
        if total > items.len() * Self::MAX_MEAN_SPAN {
            self.starts.clear();
            self.entries.clear();
            self.entries.extend(items.map(|(item, _)| item));
            return;
        }
        self.entries.resize(total, T::default());
        for (item, [first, end]) in items {
            for start in &mut starts[usize::from(first) + 1..usize::from(end) + 1] {
                self.entries[*start] = item;
                *start += 1;
            }
        }
    }

    /// The items of bin `bin`.
    pub(crate) fn get(&self, bin: usize) -> &[T] {
        if self.starts.is_empty() {
            &self.entries
        } else {
            &self.entries[self.starts[bin]..self.starts[bin + 1]]
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use srflow_core::random::Key;

    #[test]
    fn radix_sort_is_a_stable_sort_of_the_high_half() {
        let mut stream = Key::new(3).stream("keys");
        for bits in [0, 1, 11, 12, 30] {
            let mut keys: Vec<u64> = (0..3000)
                .map(|index| {
                    let high = if bits == 0 { 77 } else { 0x3F00_0000 + (stream.bits() >> (32 - bits)) };
                    u64::from(high) << 32 | index
                })
                .collect();
            let mut expected = keys.clone();
            expected.sort_by_key(|key| key >> 32);
            sort_by_high_half(&mut keys, &mut Vec::new());
            assert_eq!(keys, expected, "{bits} bits");
        }
        sort_by_high_half(&mut Vec::new(), &mut Vec::new());
    }

    #[test]
    fn bins_contain_their_items_in_order() {
        let items = [(4, [0, 4]), (2, [3, 4]), (1, [1, 4]), (0, [0, 2]), (3, [2, 2])];
        let mut bins = Bins::default();
        for _ in 0..2 {
            bins.deal(4, items.iter().copied());
            let dealt: Vec<&[u32]> = (0..4).map(|bin| bins.get(bin)).collect();
            assert_eq!(dealt, [&[4, 0][..], &[4, 1, 0], &[4, 1], &[4, 2, 1]]);
        }
        bins.deal(2, [].into_iter());
        assert!(bins.get(0).is_empty() && bins.get(1).is_empty());
    }

    #[test]
    fn bins_of_very_wide_spans_are_not_listed_one_by_one() {
        let mut bins = Bins::default();
        bins.deal(100, (0..10).map(|item| (item, [0, 100])));
        assert_eq!(bins.entries.len(), 10);
        assert_eq!(bins.get(50), [0, 1, 2, 3, 4, 5, 6, 7, 8, 9]);
    }
}
