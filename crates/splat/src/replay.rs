//! Blending that remembers what it did, for what needs the whole of it: the gradients, and the order of each pixel.

use std::ops::Range;

use srflow_simd::Simd;

use crate::blending::{PREFETCH, Row, Stripes, rows_inside};
use crate::ordering::Drawn;
use crate::projection::{Splat, TILE};

/// The blending of one tile: all rows of pixels that a splat was blended into.
#[derive(Debug, Default)]
pub(crate) struct Replay {
    /// Of each splat that was blended at a pixel, front to back by their centres: its entry of the tile's list, and one past the
    /// last of its rows.
    splats: Vec<(u32, usize)>,
    pub rows: Vec<ReplayRow>,
    /// Number of the row in the tile, of each of `rows`.
    numbers: Vec<u8>,
}

#[derive(Debug, Clone, Copy)]
pub(crate) struct ReplayRow {
    /// Zero where the splat was not blended.
    pub alpha: Row,
    /// In front of the splat, where it was blended.
    pub transmittance: Row,
}

/// The image's part that a tile covers.
#[derive(Clone, Copy)]
pub(crate) struct Place {
    /// Width of the image.
    pub image_width: usize,
    pub left: usize,
    pub top: usize,
    /// Columns and rows inside the image.
    pub width: usize,
    pub height: usize,
}

impl Replay {
    pub(crate) fn clear(&mut self) {
        self.splats.clear();
        self.rows.clear();
        self.numbers.clear();
    }

    /// Adds row number `row` of the splat that is added next.
    #[inline(always)]
    pub(crate) fn push_row(&mut self, replay: ReplayRow, row: usize) {
        self.rows.push(replay);
        self.numbers.push(row as u8);
    }

    /// Adds the splat of an entry of the tile's list, with the rows added since the last one.
    #[inline(always)]
    pub(crate) fn push_splat(&mut self, entry: u32) {
        if self.rows.len() > self.splats.last().map_or(0, |&(_, end)| end) {
            self.splats.push((entry, self.rows.len()));
        }
    }

    /// Blends the splats of `list` (positions in `drawn`), as [`Tile::blend`](crate::blending::Tile::blend). Returns the final
    /// transmittance of each row.
    #[inline(always)]
    pub(crate) fn forward<S: Simd>(
        &mut self,
        s: S,
        splats: &[Splat],
        drawn: &[Drawn],
        list: &[u32],
        place: Place,
    ) -> [Row; TILE] {
        self.clear();
        let mut transmittance = [Row::transparent(place.width); TILE];
        // Bit i: row i has a pixel that is not done.
        let mut live = rows_inside(place.height);
        for (i, &position) in list.iter().enumerate() {
            if let Some(&ahead) = list.get(i + PREFETCH) {
                s.prefetch(&splats[drawn[ahead as usize].splat as usize]);
            }
            let splat = &splats[drawn[position as usize].splat as usize];
            let (stripes, touched) = Stripes::new(s, splat, place.left, place.top);
            let mut rows = touched & live;
            while rows != 0 {
                let row = rows.trailing_zeros() as usize % TILE;
                rows &= rows - 1;
                let mut replay = ReplayRow { alpha: Row::ZERO, transmittance: transmittance[row] };
                let (mut blended, mut done) = (0, true);
                for vector in 0..TILE / S::LANES {
                    let at = vector * S::LANES;
                    let cover = stripes.cover(s, vector, row, s.read(&transmittance[row].0[at..]));
                    let alpha = s.select(cover.blended, cover.alpha, s.splat(0.0));
                    s.write(alpha, &mut replay.alpha.0[at..]);
                    s.write(cover.transmittance, &mut transmittance[row].0[at..]);
                    blended |= s.bits(cover.blended);
                    done &= s.bits(s.at_least(cover.transmittance, s.splat(0.0))) == 0;
                }
                if blended != 0 {
                    self.push_row(replay, row);
                }
                live &= !(u16::from(done) << row);
            }
            self.push_splat(position);
            if live == 0 {
                break;
            }
        }
        for row in &mut transmittance {
            row.0.iter_mut().for_each(|value| *value = value.abs());
        }
        transmittance
    }

    /// Whether no splat was blended.
    pub(crate) fn is_empty(&self) -> bool {
        self.splats.is_empty()
    }

    /// The blended splats, back to front by their centres: entry of the tile's list, and range of rows.
    #[inline(always)]
    pub(crate) fn back_to_front(&self) -> impl Iterator<Item = (u32, Range<usize>)> {
        self.splats.iter().enumerate().rev().map(|(i, &(entry, end))| {
            let first = if i == 0 { 0 } else { self.splats[i - 1].1 };
            (entry, first..end)
        })
    }

    /// The rows of pixels in a range of `rows`: their places in `rows`, and their numbers in the tile.
    #[inline(always)]
    pub(crate) fn rows_of(&self, range: Range<usize>) -> impl Iterator<Item = (usize, usize)> {
        range.clone().zip(&self.numbers[range]).map(|(at, &row)| (at, usize::from(row) % TILE))
    }

    /// Weighted sums of `N` features, from number `first` on, in each row of the tile. `splat_of` gives the splat of an entry of
    /// the tile's list.
    #[inline(always)]
    pub(crate) fn sums<'a, S: Simd, const N: usize>(
        &self,
        s: S,
        splat_of: impl Fn(u32) -> &'a Splat,
        first: usize,
    ) -> [[Row; N]; TILE] {
        let mut sums = [[Row::ZERO; N]; TILE];
        let mut start = 0;
        for &(entry, end) in &self.splats {
            let features = &splat_of(entry).features[first..first + N];
            for (at, row) in self.rows_of(start..end) {
                let replay = &self.rows[at];
                for lane in (0..TILE).step_by(S::LANES) {
                    let weight =
                        s.mul(s.read(&replay.alpha.0[lane..]), s.read(&replay.transmittance.0[lane..]));
                    for (sum, &feature) in sums[row].iter_mut().zip(features) {
                        let total = s.mul_add(weight, s.splat(feature), s.read(&sum.0[lane..]));
                        s.write(total, &mut sum.0[lane..]);
                    }
                }
            }
            start = end;
        }
        sums
    }
}
