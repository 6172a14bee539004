//! Who is drawn where, and in which order.

use std::ops::Range;

use crate::projection::{Splat, TileRect};

/// Splats sorted front to back.
#[derive(Debug, Default)]
pub(crate) struct DepthOrder {
    /// Bits of the depth in the high half, index in the low half.
    keys: Vec<u64>,
    scratch: Vec<u64>,
    order: Vec<u32>,
}

impl DepthOrder {
    /// Indices of the splats that are drawn, by depth as `f32`, equal depths by index.
    pub(crate) fn sort(&mut self, splats: &[Splat], rects: &[TileRect]) -> &[u32] {
        self.keys.clear();
        for (index, (splat, rect)) in splats.iter().zip(rects).enumerate() {
            if !rect.is_empty() {
                // The bits of positive floats are ordered as the floats are.
                self.keys.push(u64::from(splat.features[3].to_bits()) << 32 | index as u64);
            }
        }
        sort_by_high_half(&mut self.keys, &mut self.scratch);
        self.order.clear();
        self.order.extend(self.keys.iter().map(|&key| key as u32));
        &self.order
    }
}

/// Stable radix sort, least significant digit first, over those bits of the high halves that differ.
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

/// Splats dealt out to bins in a row (strips of the image, tiles of a strip), each splat to all bins of its span.
#[derive(Debug, Default)]
pub(crate) struct Bins {
    starts: Vec<usize>,
    entries: Vec<u32>,
    listed: bool,
}

impl Bins {
    /// When splats span more bins than this on average, lists would cost more memory than they save time.
    const MAX_MEAN_SPAN: usize = 16;

    /// Deals out `splats`, keeping their order within each bin.
    pub(crate) fn deal(&mut self, splats: &[u32], bins: usize, span: impl Fn(u32) -> Range<u32>) {
        // While dealing, `starts[bin + 1]` is where the next entry of `bin` goes.
        self.starts.clear();
        self.starts.resize(bins + 2, 0);
        for &splat in splats {
            for bin in span(splat) {
                self.starts[bin as usize + 2] += 1;
            }
        }
        for bin in 0..bins {
            self.starts[bin + 2] += self.starts[bin + 1];
        }
        let total = self.starts[bins + 1];
        self.listed = total <= splats.len() * Self::MAX_MEAN_SPAN;
        if !self.listed {
            return;
        }
        self.entries.resize(total, 0);
        for &splat in splats {
            for bin in span(splat) {
                let start = &mut self.starts[bin as usize + 1];
                self.entries[*start] = splat;
                *start += 1;
            }
        }
    }

    /// The splats of `bin`, given those that were dealt out; perhaps others of them too.
    pub(crate) fn get<'a>(&'a self, bin: usize, dealt: &'a [u32]) -> &'a [u32] {
        if self.listed { &self.entries[self.starts[bin]..self.starts[bin + 1]] } else { dealt }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use srflow_field::random::Key;

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
    fn bins_hold_what_spans_them_in_order() {
        let spans = [0..2, 1..4, 3..4, 0..0, 0..4];
        let splats = [4, 2, 1, 0, 3];
        let mut bins = Bins::default();
        for _ in 0..2 {
            bins.deal(&splats, 4, |splat| spans[splat as usize].clone());
            let dealt: Vec<&[u32]> = (0..4).map(|bin| bins.get(bin, &splats)).collect();
            assert_eq!(dealt, [&[4, 0][..], &[4, 1, 0], &[4, 1], &[4, 2, 1]]);
        }
    }

    #[test]
    fn bins_of_very_wide_spans_are_not_listed() {
        let splats: Vec<u32> = (0..10).collect();
        let mut bins = Bins::default();
        bins.deal(&splats, 100, |_| 0..100);
        assert_eq!(bins.get(50, &splats), splats);
        assert!(bins.entries.is_empty());
    }
}
