//! Estimates flow in tiles, for frames that do not fit in memory.
//!
//! A tile is the same rectangle of both frames, processed independently. It lacks the context of the rest of the frame: motion
//! that leaves the tile by more than the overlap, attention in GMA and its relatives, and the statistics of instance norm.
//! Overlapping tiles are blended with weights that fall smoothly towards their edges.

use srflow_core::{
    EstimateError, FlowEstimate, FlowEstimator, FlowField, FlowSequence, Image, Plane, check_frame_sizes,
};

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
    /// Width and height in pixels, at most those of the frame.
    Fixed(usize, usize),
    /// The fewest equal and roughly square tiles that fit in this much memory.
    Fitting { need: MemoryNeed, bytes: u64 },
}

/// The tiles of a frame, all of one size.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Tiles {
    frame: (usize, usize),
    across: Vec<usize>,
    down: Vec<usize>,
    size: (usize, usize),
}

/// Not even the smallest tile fits in memory.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error(
    "{} MB of memory are free, but the smallest tile of {}x{} pixels takes {} MB: free some memory, or scale the frames down",
    .free / 1_000_000, .smallest.0, .smallest.1, .needed.div_ceil(1_000_000)
)]
pub struct NothingFits {
    /// Width and height of the smallest tile.
    pub smallest: (usize, usize),
    /// Bytes that it needs.
    pub needed: u64,
    /// Bytes that are free.
    pub free: u64,
}

impl Tiles {
    /// Smallest side of tiles of [`TileSize::Fitting`].
    const SMALLEST_SIDE: usize = 256;

    /// Distributes tiles evenly over a frame of `(width, height)`. The overlap is at most half the side of a tile.
    ///
    /// # Errors
    /// When no tile fits in memory.
    pub fn new(frame: (usize, usize), tiling: Tiling) -> Result<Self, NothingFits> {
        let Tiling { size, overlap, .. } = tiling;
        let alignment = tiling.alignment.of([frame.1, frame.0]);
        let (width, height) = match size {
            TileSize::Fixed(width, height) => (width, height),
            TileSize::Fitting { need, bytes } => Self::fitting(frame, [overlap, alignment], need, bytes)?,
        };
        let side = |side: usize, frame: usize| side.max(2 * alignment).min(frame);
        let size = (side(width, frame.0), side(height, frame.1));
        Ok(Self {
            frame,
            across: starts(frame.0, size.0, overlap, alignment),
            down: starts(frame.1, size.1, overlap, alignment),
            size,
        })
    }

    /// Tile size for one tile, then two, and so on, until it fits; for each count, from the grid with the smallest tiles.
    fn fitting(
        frame: (usize, usize),
        [overlap, alignment]: [usize; 2],
        need: MemoryNeed,
        bytes: u64,
    ) -> Result<(usize, usize), NothingFits> {
        let side = |length: usize, count: usize| match count {
            1 => length,
            _ => (length + (count - 1) * overlap).div_ceil(count).next_multiple_of(alignment),
        };
        let large_enough = |side: usize, length: usize| side >= Self::SMALLEST_SIDE.min(length);
        let most = [frame.0, frame.1].map(|length| length.div_ceil(Self::SMALLEST_SIDE / 2).max(1));
        for count in 1..=most[0] * most[1] {
            let grids = (1..=count).filter(|across| count.is_multiple_of(*across));
            let sizes = grids.filter_map(|across| {
                let down = count / across;
                let (width, height) = (side(frame.0, across), side(frame.1, down));
                let square = (width <= 2 * height || down == 1) && (height <= 2 * width || across == 1);
                let fair = large_enough(width, frame.0) && large_enough(height, frame.1);
                (square && fair).then_some((width, height))
            });
            if let Some((width, height)) = sizes.min_by_key(|(width, height)| width * height)
                && need.bytes(width * height) <= bytes
            {
                return Ok((width, height));
            }
        }
        let smallest = (frame.0.min(Self::SMALLEST_SIDE), frame.1.min(Self::SMALLEST_SIDE));
        Err(NothingFits { smallest, needed: need.bytes(smallest.0 * smallest.1), free: bytes })
    }

    pub fn count(&self) -> usize {
        self.across.len() * self.down.len()
    }

    /// Width and height of each tile.
    pub fn size(&self) -> (usize, usize) {
        self.size
    }

    /// Left and top of each tile.
    fn corners(&self) -> impl Iterator<Item = (usize, usize)> + '_ {
        self.down.iter().flat_map(|top| self.across.iter().map(move |left| (*left, *top)))
    }

    /// The tile of a frame at this corner.
    fn cut(&self, frame: &Image, (left, top): (usize, usize)) -> Image {
        frame.crop(left, top, self.size.0, self.size.1)
    }

    /// Blends the results of `estimate` for each tile, called with its number and its left and top.
    fn blended(
        &self,
        mut estimate: impl FnMut(usize, (usize, usize)) -> Result<Vec<FlowEstimate>, EstimateError>,
    ) -> Result<Vec<FlowEstimate>, EstimateError> {
        let mut blends: Vec<Blend> = Vec::new();
        for (number, corner) in self.corners().enumerate() {
            let estimates = estimate(number, corner)?;
            if self.count() == 1 {
                return Ok(estimates);
            }
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
        let (width, height) = tiles.frame;
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
        let (width, height) = self.tiles.size;
        if let (Some(sum), Some(iterations)) = (&mut self.sums.iterations, estimate.iterations) {
            *sum += iterations;
        }
        let (along, below) = (weights(across, column, width), weights(down, row, height));
        for (y, below) in below.iter().enumerate() {
            let start = (down[row] + y) * self.tiles.frame.0 + across[column];
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

/// Applies an estimator to tiles.
pub struct Tiled {
    estimator: Box<dyn FlowEstimator>,
    tiling: Tiling,
}

impl Tiled {
    pub fn new(estimator: Box<dyn FlowEstimator>, tiling: Tiling) -> Self {
        Self { estimator, tiling }
    }

    fn tiles(&self, frame: (usize, usize)) -> Result<Tiles, EstimateError> {
        Tiles::new(frame, self.tiling).map_err(|problem| EstimateError::Unsupported {
            method: self.name().to_owned(),
            reason: problem.to_string(),
        })
    }

    /// Blends the results of `estimate` for each tile, called with that tile of every pair and its left and top.
    fn blended(
        &self,
        pairs: &[[&Image; 2]],
        estimate: impl Fn(&[[&Image; 2]], (usize, usize)) -> Result<Vec<FlowEstimate>, EstimateError>,
    ) -> Result<Vec<FlowEstimate>, EstimateError> {
        let Some([first, _]) = pairs.first() else { return Ok(Vec::new()) };
        check_frame_sizes(first.size(), pairs.as_flattened().iter().map(|frame| frame.size()))?;
        let tiles = self.tiles(first.size())?;
        tiles.blended(|_, corner| {
            let cut: Vec<[Image; 2]> =
                pairs.iter().map(|pair| pair.map(|frame| tiles.cut(frame, corner))).collect();
            let cut: Vec<[&Image; 2]> = cut.iter().map(|pair| pair.each_ref()).collect();
            estimate(&cut, corner)
        })
    }
}

impl FlowEstimator for Tiled {
    fn name(&self) -> &str {
        self.estimator.name()
    }

    fn estimate(&self, frame1: &Image, frame2: &Image) -> Result<FlowField, EstimateError> {
        Ok(self.estimate_pairs(&[[frame1, frame2]])?.remove(0).flow)
    }

    fn estimate_pairs(&self, pairs: &[[&Image; 2]]) -> Result<Vec<FlowEstimate>, EstimateError> {
        self.blended(pairs, |tiles, _| self.estimator.estimate_pairs(tiles))
    }

    fn estimate_from(
        &self,
        frame1: &Image,
        frame2: &Image,
        initial: &FlowField,
    ) -> Result<FlowEstimate, EstimateError> {
        check_frame_sizes(frame1.size(), [initial.size()])?;
        let estimates = self.blended(&[[frame1, frame2]], |tiles, (left, top)| {
            let estimate = |[tile1, tile2]: &[&Image; 2]| {
                let initial = initial.crop(left, top, tile1.width(), tile1.height());
                self.estimator.estimate_from(tile1, tile2, &initial)
            };
            tiles.iter().map(estimate).collect()
        });
        Ok(estimates?.remove(0))
    }

    fn remembers(&self) -> bool {
        self.estimator.remembers()
    }

    fn sequence(&self, warm_start: bool) -> Box<dyn FlowSequence + '_> {
        Box::new(TiledSequence { tiled: self, warm_start, state: None })
    }
}

/// A separate sequence for each tile.
struct TiledSequence<'a> {
    tiled: &'a Tiled,
    warm_start: bool,
    state: Option<(Tiles, Vec<Box<dyn FlowSequence + 'a>>)>,
}

impl FlowSequence for TiledSequence<'_> {
    fn push(&mut self, frames: &[Image]) -> Result<Vec<FlowEstimate>, EstimateError> {
        let frames: Vec<&Image> = frames.iter().collect();
        self.blended(&frames, |sequence, cut| sequence.push(cut))
    }

    fn push_pair(&mut self, pair: [&Image; 2]) -> Result<FlowEstimate, EstimateError> {
        let estimates =
            self.blended(&pair, |sequence, cut| Ok(vec![sequence.push_pair([&cut[0], &cut[1]])?]));
        Ok(estimates?.remove(0))
    }
}

impl<'a> TiledSequence<'a> {
    /// Blends the results of `push` for the sequence and the frames of each tile.
    fn blended(
        &mut self,
        frames: &[&Image],
        push: impl Fn(&mut (dyn FlowSequence + 'a), &[Image]) -> Result<Vec<FlowEstimate>, EstimateError>,
    ) -> Result<Vec<FlowEstimate>, EstimateError> {
        let Some(first) = frames.first() else { return Ok(Vec::new()) };
        if self.state.is_none() {
            let tiles = self.tiled.tiles(first.size())?;
            let sequence = |_| self.tiled.estimator.sequence(self.warm_start);
            let sequences = (0..tiles.count()).map(sequence).collect();
            self.state = Some((tiles, sequences));
        }
        let Some((tiles, sequences)) = &mut self.state else { return Ok(Vec::new()) };
        check_frame_sizes(tiles.frame, frames.iter().map(|frame| frame.size()))?;
        tiles.blended(|number, corner| {
            let cut: Vec<Image> = frames.iter().map(|frame| tiles.cut(frame, corner)).collect();
            push(sequences[number].as_mut(), &cut)
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The flow is the red and green of frame 1, which [`places`] sets to x and y.
    struct Places;

    impl FlowEstimator for Places {
        fn name(&self) -> &str {
            "places"
        }

        fn estimate(&self, frame1: &Image, _: &Image) -> Result<FlowField, EstimateError> {
            let flow = |x, y| frame1.get(x, y).map(f32::from);
            Ok(FlowField::from_fn(frame1.width(), frame1.height(), |x, y| [flow(x, y)[0], flow(x, y)[1]]))
        }
    }

    /// The flow is the number of the call, so tiles differ.
    struct Counting(std::sync::atomic::AtomicUsize);

    impl FlowEstimator for Counting {
        fn name(&self) -> &str {
            "counting"
        }

        fn estimate(&self, frame1: &Image, _: &Image) -> Result<FlowField, EstimateError> {
            let number = self.0.fetch_add(1, std::sync::atomic::Ordering::Relaxed);
            Ok(FlowField::filled(frame1.width(), frame1.height(), [number as f32, 0.0]))
        }
    }

    fn tiling(width: usize, height: usize, overlap: usize) -> Tiling {
        Tiling { size: TileSize::Fixed(width, height), overlap, alignment: Padding::Fixed(8) }
    }

    fn places(width: usize, height: usize) -> Image {
        Image::from_fn(width, height, |x, y| [x as u8, y as u8, 0])
    }

    #[test]
    fn consistent_tiles_give_the_flow_of_the_whole_frame() {
        for (size, tile, overlap) in
            [((250, 131), (64, 48), 16), ((65, 240), (64, 64), 40), ((100, 90), (30, 31), 1)]
        {
            let frame = places(size.0, size.1);
            let whole = Places.estimate(&frame, &frame).expect("flow");
            let tiled = Tiled::new(Box::new(Places), tiling(tile.0, tile.1, overlap));
            let found = tiled.estimate(&frame, &frame).expect("flow");
            let mut sequence = tiled.sequence(false);
            assert_eq!(sequence.push(std::slice::from_ref(&frame)).expect("none before it"), []);
            let moving = sequence.push(&[frame.clone(), frame.clone()]).expect("flows");
            for flow in [&found, &moving[0].flow, &moving[1].flow] {
                let far = |a: &[f32; 2], b: &[f32; 2]| (a[0] - b[0]).abs().max((a[1] - b[1]).abs());
                let worst =
                    whole.pixels().iter().zip(flow.pixels()).map(|(a, b)| far(a, b)).fold(0.0, f32::max);
                assert!(worst < 1e-3, "{size:?} in {tile:?}: {worst} px");
            }
        }
    }

    #[test]
    fn uncertainty_is_blended_like_the_flow() {
        let frame = places(100, 90);
        let tiles = Tiles::new((100, 90), tiling(48, 40, 16)).expect("tiles");
        assert!(tiles.count() > 1);
        let part = |of: usize| Plane::from_fn(100, 90, |x, y| f32::from(frame.get(x, y)[of]));
        let whole = FlowEstimate {
            flow: Places.estimate(&frame, &frame).expect("flow"),
            uncertainty: Some(part(0)),
            occlusion: None,
            iterations: None,
        };
        let blended = tiles.blended(|_, (left, top)| {
            let (width, height) = tiles.size();
            let cut = |plane: &Plane| plane.crop(left, top, width, height);
            let flow = whole.flow.crop(left, top, width, height);
            let uncertainty = whole.uncertainty.as_ref().map(cut);
            Ok(vec![FlowEstimate { flow, uncertainty, ..whole.clone() }])
        });
        let blended = blended.expect("blended").remove(0);
        let (found, expected) = (blended.uncertainty.expect("kept"), part(0));
        let apart = found.pixels().iter().zip(expected.pixels()).map(|(a, b)| (a - b).abs());
        assert!(apart.fold(0.0, f32::max) < 1e-3 && blended.occlusion.is_none());
    }

    #[test]
    fn inconsistent_tiles_are_blended_smoothly() {
        let frame = Image::new(200, 20);
        let estimator = Counting(0.into());
        let tiled = Tiled::new(Box::new(estimator), tiling(80, 80, 20));
        let flow = tiled.estimate(&frame, &frame).expect("flow");
        let row = flow.row(10);
        assert_eq!((row[0], row[100], row[199]), ([0.0, 0.0], [1.0, 0.0], [2.0, 0.0]));
        let steps = row.windows(2).map(|pair| pair[1][0] - pair[0][0]);
        let (least, most) =
            steps.fold((0.0_f32, 0.0_f32), |(least, most), step| (least.min(step), most.max(step)));
        assert!(least >= -1e-6 && most < 0.15, "steps from {least} to {most}");
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
            Tiles::new((3840, 2160), Tiling { size, overlap: 128, alignment: Padding::Fixed(8) })
        };
        assert_eq!(tiles(6_000_000_000).expect("fits whole").count(), 1);
        let mut last = 1;
        for bytes in [3_000_000_000, 1_500_000_000, 800_000_000, 400_000_000] {
            let tiles = tiles(bytes).expect("fits in tiles");
            let (width, height) = tiles.size();
            assert!(need.bytes(width * height) <= bytes, "{width}x{height} in {bytes}");
            assert!(tiles.count() > last && width < 2 * height && height < 2 * width, "{tiles:?}");
            last = tiles.count();
        }
        let error = tiles(120_000_000).expect_err("too little").to_string();
        assert!(error.contains("120 MB") && error.contains("256x256"), "{error}");
    }

    #[test]
    fn frames_of_different_sizes_are_an_error() {
        let tiled = Tiled::new(Box::new(Places), tiling(16, 16, 4));
        let (one, other) = (Image::new(40, 30), Image::new(41, 30));
        assert!(matches!(tiled.estimate(&one, &other), Err(EstimateError::SizeMismatch { .. })));
        assert!(matches!(
            tiled.estimate_from(&one, &one, &FlowField::new(41, 30)),
            Err(EstimateError::SizeMismatch { .. })
        ));
        let result = tiled.sequence(false).push(&[one, other]);
        assert!(matches!(result, Err(EstimateError::SizeMismatch { .. })));
    }
}
