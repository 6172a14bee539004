//! Estimates flow in tiles, for frames that do not fit in memory.
//!
//! A tile is the same rectangle of both frames, processed independently. It lacks the context of the rest of the frame: motion
//! that leaves the tile by more than the overlap, attention in GMA and its relatives, and the statistics of instance norm.
//! Overlapping tiles are blended with weights that fall smoothly towards their edges.

use srflow_core::{EstimateError, FlowEstimate, FlowField, Image, Plane, Size};

use crate::Padding;
use crate::memory_need::MemoryNeed;

/// Smallest side of tiles with a fixed size.
pub const SMALLEST_TILE_SIDE: usize = 128;
/// Share of an overlap, at the edge of each tile, where the weight of that tile is zero.
const MARGIN: f32 = 1.0 / 8.0;

/// Division of a frame into tiles.
#[derive(Debug, Clone, Copy)]
pub struct Tiling {
    pub size: TileSize,
    /// Least overlap of neighbouring tiles in pixels, up to alignment.
    pub overlap: usize,
    /// Tiles start at multiples of this, so that coarse pixels of a network coincide with those of the whole frame; see
    /// [`Network::padding`](crate::Network::padding).
    pub alignment: Padding,
}

/// Size of tiles.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum TileSize {
    /// At most the size of the frame.
    Fixed(Size),
    /// The fewest equal and roughly square tiles that fit in this much memory.
    Fitting { need: MemoryNeed, bytes: u64 },
}

/// The tiles of a frame, all of one size.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Tiles {
    frame: Size,
    across: Vec<usize>,
    down: Vec<usize>,
    size: Size,
}

/// Not even the smallest tile fits in memory.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error(
    "{} MB of memory are free, but the smallest tile of {smallest} pixels takes {} MB: free some memory, or scale the frames down",
    .free / 1_000_000, .needed.div_ceil(1_000_000)
)]
pub struct NothingFits {
    /// Size of the smallest tile.
    pub smallest: Size,
    /// Bytes that it needs.
    pub needed: u64,
    /// Bytes that are free.
    pub free: u64,
}

impl Tiles {
    /// Smallest side of tiles of [`TileSize::Fitting`].
    const SMALLEST_SIDE: usize = 256;

    /// Distributes tiles evenly over a frame. The overlap is at most half the side of a tile.
    ///
    /// # Errors
    /// When no tile fits in memory.
    pub fn new(frame: Size, tiling: Tiling) -> Result<Self, NothingFits> {
        let Tiling { size, overlap, .. } = tiling;
        let alignment = tiling.alignment.of([frame.height, frame.width]);
        let Size { width, height } = match size {
            TileSize::Fixed(size) => size,
            TileSize::Fitting { need, bytes } => Self::fitting(frame, [overlap, alignment], need, bytes)?,
        };
        let side = |side: usize, frame: usize| side.max(2 * alignment).min(frame);
        let size = Size::new(side(width, frame.width), side(height, frame.height));
        Ok(Self {
            frame,
            across: starts(frame.width, size.width, overlap, alignment),
            down: starts(frame.height, size.height, overlap, alignment),
            size,
        })
    }

    /// Tile size for one tile, then two, and so on, until it fits; for each count, from the grid with the smallest tiles.
    fn fitting(
        frame: Size,
        [overlap, alignment]: [usize; 2],
        need: MemoryNeed,
        bytes: u64,
    ) -> Result<Size, NothingFits> {
        let side = |length: usize, count: usize| match count {
            1 => length,
            _ => (length + (count - 1) * overlap).div_ceil(count).next_multiple_of(alignment),
        };
        let large_enough = |side: usize, length: usize| side >= Self::SMALLEST_SIDE.min(length);
        let most = [frame.width, frame.height].map(|length| length.div_ceil(Self::SMALLEST_SIDE / 2).max(1));
        for count in 1..=most[0] * most[1] {
            let grids = (1..=count).filter(|across| count.is_multiple_of(*across));
            let sizes = grids.filter_map(|across| {
                let down = count / across;
                let size = Size::new(side(frame.width, across), side(frame.height, down));
                let Size { width, height } = size;
                let square = (width <= 2 * height || down == 1) && (height <= 2 * width || across == 1);
                let fair = large_enough(width, frame.width) && large_enough(height, frame.height);
                (square && fair).then_some(size)
            });
            if let Some(size) = sizes.min_by_key(|size| size.pixels())
                && need.bytes(size.pixels()) <= bytes
            {
                return Ok(size);
            }
        }
        let smallest = Size::new(frame.width.min(Self::SMALLEST_SIDE), frame.height.min(Self::SMALLEST_SIDE));
        Err(NothingFits { smallest, needed: need.bytes(smallest.pixels()), free: bytes })
    }

    /// A whole frame as one tile.
    pub(crate) fn whole(frame: Size) -> Self {
        Self { frame, across: vec![0], down: vec![0], size: frame }
    }

    /// Size of the frame.
    pub(crate) fn frame(&self) -> Size {
        self.frame
    }

    pub fn count(&self) -> usize {
        self.across.len() * self.down.len()
    }

    /// Size of each tile.
    pub fn size(&self) -> Size {
        self.size
    }

    /// Left and top of each tile.
    fn corners(&self) -> impl Iterator<Item = (usize, usize)> + '_ {
        self.down.iter().flat_map(|top| self.across.iter().map(move |left| (*left, *top)))
    }

    /// The tile of a frame at this corner.
    pub(crate) fn cut(&self, frame: &Image, (left, top): (usize, usize)) -> Image {
        frame.crop(left, top, self.size.width, self.size.height)
    }

    /// Blends the results of `estimate` for each tile, called with its number and its left and top.
    pub(crate) fn blended(
        &self,
        mut estimate: impl FnMut(usize, (usize, usize)) -> Result<Vec<FlowEstimate>, EstimateError>,
    ) -> Result<Vec<FlowEstimate>, EstimateError> {
        let mut blends: Vec<Blend> = Vec::new();
        for (number, corner) in self.corners().enumerate() {
            let estimates = estimate(number, corner)?;
            if number == 0 {
                blends = estimates.iter().map(|of| Blend::new(self, of)).collect();
            }
            blends.iter_mut().zip(&estimates).for_each(|(blend, estimate)| blend.add(number, estimate));
        }
        Ok(blends.into_iter().map(Blend::finish).collect())
    }
}

/// Start positions of tiles of `size` pixels along `length` pixels.
fn starts(length: usize, size: usize, overlap: usize, alignment: usize) -> Vec<usize> {
    if length <= size {
        return vec![0];
    }
    // Alignment shortens an overlap by less than `alignment`.
    let overlap = overlap.clamp(alignment.min(size / 2), size / 2);
    let count = (length - overlap).div_ceil(size - overlap);
    let last = length - size;
    let start =
        |i: usize| if i + 1 == count { last } else { (i * last / (count - 1)) / alignment * alignment };
    let mut starts: Vec<usize> = (0..count).map(start).collect();
    starts.dedup();
    starts
}

/// Weights of the pixels of a tile along one axis: 1 inside, falling to 0 towards edges that another tile overlaps.
fn weights(starts: &[usize], number: usize, size: usize) -> Vec<f32> {
    let overlap = |before: usize, after: usize| (before + size).saturating_sub(after) as f32;
    let left = number.checked_sub(1).map(|before| overlap(starts[before], starts[number]));
    let right = starts.get(number + 1).map(|after| overlap(starts[number], *after));
    let rise = |place: f32, overlap: Option<f32>| match overlap {
        Some(overlap) if overlap > 0.0 => {
            let part = ((place / overlap - MARGIN) / (1.0 - 2.0 * MARGIN)).clamp(0.0, 1.0);
            part * part * (3.0 - 2.0 * part)
        }
        _ => 1.0,
    };
    let weight = |i: usize| {
        let place = i as f32 + 0.5;
        rise(place, left) * rise(size as f32 - place, right)
    };
    (0..size).map(weight).collect()
}

/// Weighted mean of the estimates of tiles.
struct Blend<'a> {
    tiles: &'a Tiles,
    sums: FlowEstimate,
    weights: Vec<f32>,
}

impl<'a> Blend<'a> {
    /// A blend of estimates with the same planes as `of`.
    fn new(tiles: &'a Tiles, of: &FlowEstimate) -> Self {
        let Size { width, height } = tiles.frame;
        let blank = |plane: &Option<Plane>| plane.as_ref().map(|_| Plane::new(width, height));
        let sums = FlowEstimate {
            flow: FlowField::new(width, height),
            uncertainty: blank(&of.uncertainty),
            occlusion: blank(&of.occlusion),
            iterations: of.iterations.map(|_| 0.0),
        };
        Self { tiles, sums, weights: vec![0.0; width * height] }
    }

    /// Adds the estimate of tile `number`.
    fn add(&mut self, number: usize, estimate: &FlowEstimate) {
        let (across, down) = (&self.tiles.across, &self.tiles.down);
        let (column, row) = (number % across.len(), number / across.len());
        let Size { width, height } = self.tiles.size;
        if let (Some(sum), Some(iterations)) = (&mut self.sums.iterations, estimate.iterations) {
            *sum += iterations;
        }
        let (along, below) = (weights(across, column, width), weights(down, row, height));
        for (y, below) in below.iter().enumerate() {
            let start = (down[row] + y) * self.tiles.frame.width + across[column];
            let whole = start..start + width;
            let weights: Vec<f32> = along.iter().map(|along| along * below).collect();
            for (total, weight) in self.weights[whole.clone()].iter_mut().zip(&weights) {
                *total += weight;
            }
            let sums = &mut self.sums.flow.pixels_mut()[whole.clone()];
            for ((sum, vector), weight) in sums.iter_mut().zip(estimate.flow.row(y)).zip(&weights) {
                *sum = [sum[0] + weight * vector[0], sum[1] + weight * vector[1]];
            }
            let planes = [
                (&mut self.sums.uncertainty, &estimate.uncertainty),
                (&mut self.sums.occlusion, &estimate.occlusion),
            ];
            for (sums, values) in planes {
                let (Some(sums), Some(values)) = (sums, values) else { continue };
                let sums = &mut sums.pixels_mut()[whole.clone()];
                for ((sum, value), weight) in sums.iter_mut().zip(values.row(y)).zip(&weights) {
                    *sum += weight * value;
                }
            }
        }
    }

    fn finish(mut self) -> FlowEstimate {
        for (sum, total) in self.sums.flow.pixels_mut().iter_mut().zip(&self.weights) {
            *sum = sum.map(|part| part / total);
        }
        for plane in [&mut self.sums.uncertainty, &mut self.sums.occlusion].into_iter().flatten() {
            plane.pixels_mut().iter_mut().zip(&self.weights).for_each(|(sum, total)| *sum /= total);
        }
        if let Some(sum) = &mut self.sums.iterations {
            *sum /= self.tiles.count() as f32;
        }
        self.sums
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn tiling(width: usize, height: usize, overlap: usize) -> Tiling {
        Tiling { size: TileSize::Fixed(Size { width, height }), overlap, alignment: Padding::Fixed(8) }
    }

    #[test]
    fn uncertainty_is_blended_like_the_flow() {
        let tiles = Tiles::new(Size::new(100, 90), tiling(48, 40, 16)).expect("tiles");
        assert!(tiles.count() > 1);
        let across = || Plane::from_fn(100, 90, |x, _| x as f32);
        let whole = FlowEstimate {
            flow: FlowField::from_fn(100, 90, |x, y| [x as f32, y as f32]),
            uncertainty: Some(across()),
            occlusion: None,
            iterations: None,
        };
        let blended = tiles.blended(|_, (left, top)| {
            let Size { width, height } = tiles.size();
            let cut = |plane: &Plane| plane.crop(left, top, width, height);
            let flow = whole.flow.crop(left, top, width, height);
            let uncertainty = whole.uncertainty.as_ref().map(cut);
            Ok(vec![FlowEstimate { flow, uncertainty, ..whole.clone() }])
        });
        let blended = blended.expect("blended").remove(0);
        let (found, expected) = (blended.uncertainty.expect("kept"), across());
        let apart = found.pixels().iter().zip(expected.pixels()).map(|(a, b)| (a - b).abs());
        assert!(apart.fold(0.0, f32::max) < 1e-3 && blended.occlusion.is_none());
    }

    #[test]
    fn tiles_cover_the_frame_with_the_requested_overlap() {
        let cases = [(3840, 1000, 128), (2160, 1000, 128), (1001, 1000, 64), (512, 512, 64), (700, 100, 90)];
        for ((length, size, overlap), alignment) in cases.into_iter().zip([8, 32, 8, 64, 16]) {
            let starts = starts(length, size, overlap, alignment);
            let within = &starts[..starts.len() - 1];
            assert!(within.iter().all(|start| start.is_multiple_of(alignment)), "{starts:?}");
            assert_eq!((starts[0], starts[starts.len() - 1] + size), (0, length));
            for pair in starts.windows(2) {
                let shared = pair[0] + size - pair[1];
                let wanted = overlap.min(size / 2);
                assert!(pair[1] > pair[0] && shared + alignment > wanted, "{length} {size}: {starts:?}");
            }
        }
    }

    #[test]
    fn tiles_are_as_large_as_the_memory_allows() {
        let need = MemoryNeed { fixed: 100_000_000, per_pixel: 600, attending: 0, most_weights: 0 };
        let tiles = |bytes| {
            let size = TileSize::Fitting { need, bytes };
            Tiles::new(Size::new(3840, 2160), Tiling { size, overlap: 128, alignment: Padding::Fixed(8) })
        };
        assert_eq!(tiles(6_000_000_000).expect("fits whole").count(), 1);
        let mut last = 1;
        for bytes in [3_000_000_000, 1_500_000_000, 800_000_000, 400_000_000] {
            let tiles = tiles(bytes).expect("fits in tiles");
            let size @ Size { width, height } = tiles.size();
            assert!(need.bytes(size.pixels()) <= bytes, "{size} in {bytes}");
            assert!(tiles.count() > last && width < 2 * height && height < 2 * width, "{tiles:?}");
            last = tiles.count();
        }
        let error = tiles(120_000_000).expect_err("too little").to_string();
        assert!(error.contains("120 MB") && error.contains("256x256"), "{error}");
    }
}
