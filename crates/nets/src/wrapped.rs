//! What settings add to any estimator: tiles, a scale, a refinement, a name.

use srflow_classical::TvL1;
use srflow_core::resize::{resize_flow_antialiased, resize_image_antialiased, resize_plane_antialiased};
use srflow_core::{
    EstimateError, FlowEstimate, FlowEstimator, FlowField, FlowSequence, Image, Size, check_frame_sizes,
};

use crate::tiles::{Tiles, Tiling};

/// An estimator that sees frames resized and in tiles. Its flow, back at the size of the frames, may be refined there.
pub struct Wrapped {
    estimator: Box<dyn FlowEstimator>,
    label: Option<String>,
    tiling: Option<Tiling>,
    scale: Option<f64>,
    refinement: Option<TvL1>,
}

/// Size of a frame whose sides are scaled by `factor`: rounded, at least 1.
pub fn scaled_size(Size { width, height }: Size, factor: f64) -> Size {
    let side = |side: usize| ((side as f64 * factor).round() as usize).max(1);
    Size::new(side(width), side(height))
}

impl Wrapped {
    /// The estimator as it is.
    pub fn new(estimator: Box<dyn FlowEstimator>) -> Self {
        Self { estimator, label: None, tiling: None, scale: None, refinement: None }
    }

    /// Names it `label` in tables.
    pub fn labelled(self, label: String) -> Self {
        Self { label: Some(label), ..self }
    }

    /// Estimates tile by tile, after scaling.
    pub fn tiled(self, tiling: impl Into<Option<Tiling>>) -> Self {
        Self { tiling: tiling.into(), ..self }
    }

    /// Scales the sides of frames by `factor`.
    ///
    /// # Errors
    /// When `factor` is not in 1/64 to 64.
    pub fn scaled(self, factor: impl Into<Option<f64>>) -> Result<Self, EstimateError> {
        let scale = factor.into();
        match scale.filter(|factor| !(1.0 / 64.0..=64.0).contains(factor)) {
            None => Ok(Self { scale, ..self }),
            Some(factor) => Err(self.unsupported(format!(
                "cannot scale frames by {factor}: expected a factor from 1/64 to 64, such as 0.5"
            ))),
        }
    }

    /// Refines the flow at the size of the frames: networks that compute at a part of the size see less than the frames show.
    /// Only the flow changes, not its uncertainty.
    pub fn refined(self, refinement: impl Into<Option<TvL1>>) -> Self {
        Self { refinement: refinement.into(), ..self }
    }

    fn unsupported(&self, reason: String) -> EstimateError {
        EstimateError::Unsupported { method: self.estimator.name().to_owned(), reason }
    }

    /// What the estimator sees of frames of `size`; `None` if it sees the frames themselves.
    fn view(&self, size: Size) -> Result<Option<View>, EstimateError> {
        if self.scale.is_none() && self.tiling.is_none() {
            return Ok(None);
        }
        let scaled = self.scale.map_or(size, |factor| scaled_size(size, factor));
        let tiles = match self.tiling {
            Some(tiling) => {
                Tiles::new(scaled, tiling).map_err(|error| self.unsupported(error.to_string()))?
            }
            None => Tiles::whole(scaled),
        };
        Ok(Some(View { size, tiles }))
    }

    fn refine(
        &self,
        [frame1, frame2]: [&Image; 2],
        estimate: FlowEstimate,
    ) -> Result<FlowEstimate, EstimateError> {
        let Some(refinement) = &self.refinement else { return Ok(estimate) };
        let flow = refinement.estimate_from(frame1, frame2, &estimate.flow)?.flow;
        Ok(FlowEstimate { flow, ..estimate })
    }
}

/// What an estimator sees of frames of one size.
struct View {
    size: Size,
    /// Of the scaled frames.
    tiles: Tiles,
}

impl View {
    /// The estimates, at the size of the frames, that `estimate` gives for each tile of the frames: called with the number of
    /// the tile, its left and top, and that tile of all frames.
    fn estimates(
        &self,
        frames: &[&Image],
        mut estimate: impl FnMut(usize, (usize, usize), &[Image]) -> Result<Vec<FlowEstimate>, EstimateError>,
    ) -> Result<Vec<FlowEstimate>, EstimateError> {
        check_frame_sizes(self.size, frames.iter().map(|frame| frame.size()))?;
        let scaled: Vec<Image> =
            frames.iter().map(|frame| resize_image_antialiased(frame, self.tiles.frame())).collect();
        let estimates = match self.tiles.count() {
            1 => estimate(0, (0, 0), &scaled)?,
            _ => self.tiles.blended(|number, corner| {
                let cut: Vec<Image> = scaled.iter().map(|frame| self.tiles.cut(frame, corner)).collect();
                estimate(number, corner, &cut)
            })?,
        };
        Ok(estimates.into_iter().map(|estimate| resized(estimate, self.size)).collect())
    }
}

impl FlowEstimator for Wrapped {
    fn name(&self) -> &str {
        self.label.as_deref().unwrap_or_else(|| self.estimator.name())
    }

    fn estimate(&self, frame1: &Image, frame2: &Image) -> Result<FlowField, EstimateError> {
        Ok(self.estimate_pairs(&[[frame1, frame2]])?.remove(0).flow)
    }

    fn estimate_pairs(&self, pairs: &[[&Image; 2]]) -> Result<Vec<FlowEstimate>, EstimateError> {
        let Some([first, _]) = pairs.first() else { return Ok(Vec::new()) };
        let estimates = match self.view(first.size())? {
            None => self.estimator.estimate_pairs(pairs)?,
            Some(view) => view.estimates(pairs.as_flattened(), |_, _, tiles| {
                let tiles: Vec<[&Image; 2]> =
                    tiles.chunks_exact(2).map(|pair| [&pair[0], &pair[1]]).collect();
                self.estimator.estimate_pairs(&tiles)
            })?,
        };
        pairs.iter().zip(estimates).map(|(pair, estimate)| self.refine(*pair, estimate)).collect()
    }

    fn estimate_from(
        &self,
        frame1: &Image,
        frame2: &Image,
        initial: &FlowField,
    ) -> Result<FlowEstimate, EstimateError> {
        let estimate = match self.view(frame1.size())? {
            None => self.estimator.estimate_from(frame1, frame2, initial)?,
            Some(view) => {
                check_frame_sizes(view.size, [initial.size()])?;
                let initial = resize_flow_antialiased(initial, view.tiles.frame());
                let estimates = view.estimates(&[frame1, frame2], |_, (left, top), tiles| {
                    let initial = initial.crop(left, top, tiles[0].width(), tiles[0].height());
                    Ok(vec![self.estimator.estimate_from(&tiles[0], &tiles[1], &initial)?])
                });
                estimates?.remove(0)
            }
        };
        self.refine([frame1, frame2], estimate)
    }

    fn remembers(&self) -> bool {
        self.estimator.remembers()
    }

    fn sequence(&self, warm_start: bool) -> Box<dyn FlowSequence + '_> {
        Box::new(WrappedSequence { wrapped: self, warm_start, state: None, last: None })
    }
}

struct WrappedSequence<'a> {
    wrapped: &'a Wrapped,
    warm_start: bool,
    state: Option<State<'a>>,
    /// The last frame, for the refinement.
    last: Option<Image>,
}

struct State<'a> {
    view: Option<View>,
    /// One for each tile.
    sequences: Vec<Box<dyn FlowSequence + 'a>>,
}

impl FlowSequence for WrappedSequence<'_> {
    fn push(&mut self, frames: &[Image]) -> Result<Vec<FlowEstimate>, EstimateError> {
        let Some(first) = frames.first() else { return Ok(Vec::new()) };
        let State { view, sequences } = self.state(first.size())?;
        let estimates = match view {
            None => sequences[0].push(frames)?,
            Some(view) => {
                let frames: Vec<&Image> = frames.iter().collect();
                view.estimates(&frames, |number, _, tiles| sequences[number].push(tiles))?
            }
        };
        if self.wrapped.refinement.is_none() {
            return Ok(estimates);
        }
        let video: Vec<&Image> = self.last.iter().chain(frames).collect();
        let pairs = video.windows(2).zip(estimates);
        let refined =
            pairs.map(|(pair, estimate)| self.wrapped.refine([pair[0], pair[1]], estimate)).collect();
        self.last = frames.last().cloned();
        refined
    }

    fn push_pair(&mut self, pair: [&Image; 2]) -> Result<FlowEstimate, EstimateError> {
        let State { view, sequences } = self.state(pair[0].size())?;
        let estimate = match view {
            None => sequences[0].push_pair(pair)?,
            Some(view) => {
                let estimates = view.estimates(&pair, |number, _, tiles| {
                    Ok(vec![sequences[number].push_pair([&tiles[0], &tiles[1]])?])
                });
                estimates?.remove(0)
            }
        };
        self.last = self.wrapped.refinement.is_some().then(|| pair[1].clone());
        self.wrapped.refine(pair, estimate)
    }
}

impl<'a> WrappedSequence<'a> {
    /// What the sequence keeps; frames of `size` begin it.
    fn state(&mut self, size: Size) -> Result<&mut State<'a>, EstimateError> {
        let state = match self.state.take() {
            Some(state) => state,
            None => {
                let view = self.wrapped.view(size)?;
                let count = view.as_ref().map_or(1, |view| view.tiles.count());
                let sequences =
                    (0..count).map(|_| self.wrapped.estimator.sequence(self.warm_start)).collect();
                State { view, sequences }
            }
        };
        Ok(self.state.insert(state))
    }
}

/// Resizes an estimate. The uncertainty, which is common to both components of the flow, is scaled by the geometric mean of the
/// two factors.
fn resized(estimate: FlowEstimate, size: Size) -> FlowEstimate {
    let from = estimate.flow.size();
    if from == size {
        return estimate;
    }
    let grow = |to: usize, from: usize| to as f32 / from.max(1) as f32;
    let gain = (grow(size.width, from.width) * grow(size.height, from.height)).sqrt();
    FlowEstimate {
        flow: resize_flow_antialiased(&estimate.flow, size),
        uncertainty: estimate.uncertainty.map(|plane| resize_plane_antialiased(&plane, size, gain)),
        occlusion: estimate.occlusion.map(|plane| resize_plane_antialiased(&plane, size, 1.0)),
        iterations: estimate.iterations,
    }
}

#[cfg(test)]
mod tests {
    use srflow_classical::TvL1Parameters;
    use srflow_core::Plane;
    use srflow_core::random::Key;

    use super::*;
    use crate::{Padding, TileSize};

    fn tiled(estimator: impl FlowEstimator + 'static, tile: Size, overlap: usize) -> Wrapped {
        let tiling = Tiling { size: TileSize::Fixed(tile), overlap, alignment: Padding::Fixed(8) };
        Wrapped::new(Box::new(estimator)).tiled(tiling)
    }

    /// The flow is the size of the frames, in hundreds of pixels.
    struct Sizes;

    impl FlowEstimator for Sizes {
        fn name(&self) -> &str {
            "sizes"
        }

        fn estimate(&self, frame1: &Image, _: &Image) -> Result<FlowField, EstimateError> {
            let Size { width, height } = frame1.size();
            Ok(FlowField::filled(width, height, [width as f32 / 100.0, height as f32 / 100.0]))
        }
    }

    #[test]
    fn uncertainty_is_in_pixels_of_the_frame_and_occlusion_a_probability() {
        let estimate = FlowEstimate {
            flow: FlowField::filled(50, 31, [1.0, 1.0]),
            uncertainty: Some(Plane::filled(50, 31, 3.0)),
            occlusion: Some(Plane::filled(50, 31, 0.25)),
            iterations: Some(2.5),
        };
        let FlowEstimate { flow, uncertainty, occlusion, iterations } =
            resized(estimate.clone(), Size::new(100, 62));
        let near = |plane: Option<Plane>, expected: f32| {
            let plane = plane.expect("kept");
            assert_eq!(plane.size(), Size::new(100, 62));
            assert!(
                plane.pixels().iter().all(|value| (value - expected).abs() < 1e-5),
                "{}",
                plane.get(0, 0)
            );
        };
        assert_eq!(flow.size(), Size::new(100, 62));
        near(uncertainty, 6.0);
        near(occlusion, 0.25);
        assert_eq!(iterations, Some(2.5));
        assert_eq!(resized(estimate.clone(), Size::new(50, 31)), estimate);
    }

    #[test]
    fn the_estimator_gets_scaled_frames_and_flow_is_scaled_back() {
        let frame = Image::new(100, 61);
        for (factor, seen) in [(0.5, (50, 31)), (2.0, (200, 122)), (1.0, (100, 61)), (0.02, (2, 1))] {
            let scaled = Wrapped::new(Box::new(Sizes)).scaled(factor).expect("a factor in range");
            assert_eq!(scaled_size(frame.size(), factor), Size::new(seen.0, seen.1));
            let flow = scaled.estimate(&frame, &frame).expect("flow");
            let moving = scaled.sequence(false).push(&[frame.clone(), frame.clone()]).expect("flow");
            for flow in [&flow, &moving[0].flow] {
                assert_eq!(flow.size(), Size::new(100, 61));
                // The size of the scaled frame times the inverse factor is the size of the frame.
                let near = |[u, v]: [f32; 2]| (u - 1.0).abs() < 1e-4 && (v - 0.61).abs() < 1e-4;
                assert!(flow.pixels().iter().all(|vector| near(*vector)), "{factor}: {:?}", flow.get(0, 0));
            }
        }
        for factor in [0.0, -1.0, f64::NAN, f64::INFINITY, 0.001] {
            assert!(Wrapped::new(Box::new(Sizes)).scaled(factor).is_err(), "{factor}");
        }
    }

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

    /// Half of the true motion.
    struct Half;

    impl FlowEstimator for Half {
        fn name(&self) -> &str {
            "half"
        }

        fn estimate(&self, frame1: &Image, _: &Image) -> Result<FlowField, EstimateError> {
            Ok(FlowField::filled(frame1.width(), frame1.height(), [0.5, -0.25]))
        }
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
            let tiled = tiled(Places, Size::new(tile.0, tile.1), overlap);
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
    fn inconsistent_tiles_are_blended_smoothly() {
        let frame = Image::new(200, 20);
        let tiled = tiled(Counting(0.into()), Size::new(80, 80), 20);
        let flow = tiled.estimate(&frame, &frame).expect("flow");
        let row = flow.row(10);
        assert_eq!((row[0], row[100], row[199]), ([0.0, 0.0], [1.0, 0.0], [2.0, 0.0]));
        let steps = row.windows(2).map(|pair| pair[1][0] - pair[0][0]);
        let (least, most) =
            steps.fold((0.0_f32, 0.0_f32), |(least, most), step| (least.min(step), most.max(step)));
        assert!(least >= -1e-6 && most < 0.15, "steps from {least} to {most}");
    }

    #[test]
    fn frames_of_different_sizes_are_an_error() {
        let tiled = tiled(Places, Size::new(16, 16), 4);
        let (one, other) = (Image::new(40, 30), Image::new(41, 30));
        assert!(matches!(tiled.estimate(&one, &other), Err(EstimateError::SizeMismatch { .. })));
        assert!(matches!(
            tiled.estimate_from(&one, &one, &FlowField::new(41, 30)),
            Err(EstimateError::SizeMismatch { .. })
        ));
        let result = tiled.sequence(false).push(&[one, other]);
        assert!(matches!(result, Err(EstimateError::SizeMismatch { .. })));
    }

    #[test]
    fn refinement_comes_nearer_to_the_true_motion() {
        let mut random = Key::new(5).stream("texture");
        let waves: Vec<[f32; 3]> = (0..12)
            .map(|_| [random.uniform(-0.35, 0.35), random.uniform(-0.35, 0.35), random.uniform(0.0, 6.0)])
            .collect();
        let frame = |time: f32| {
            Image::from_fn(120, 90, |x, y| {
                let (x, y) = (x as f32 - time, y as f32 + 0.5 * time);
                let sum: f32 = waves.iter().map(|[fx, fy, phase]| (fx * x + fy * y + phase).sin()).sum();
                [(127.5 + 25.0 * sum).clamp(0.0, 255.0).round() as u8; 3]
            })
        };
        let refinement = TvL1::new(TvL1Parameters { nscales: 1, warps: 1, ..TvL1Parameters::default() });
        let refined = Wrapped::new(Box::new(Half)).refined(refinement.expect("parameters in range"));
        let frames = [frame(0.0), frame(1.0), frame(2.0)];
        let alone = refined.estimate(&frames[0], &frames[1]).expect("flow");
        let inner = alone.crop(8, 8, 104, 74);
        let apart = inner.pixels().iter().map(|[u, v]| (u - 1.0).hypot(v + 0.5)).sum::<f32>()
            / inner.pixels().len() as f32;
        assert!(apart < 0.1, "{apart}");
        assert_eq!(refined.name(), "half");
        // As pairs, and along a video, in whatever portions it comes.
        let pairs = [[&frames[0], &frames[1]], [&frames[1], &frames[2]]];
        let pairs = refined.estimate_pairs(&pairs).expect("flows");
        assert_eq!(pairs[0].flow, alone);
        let mut sequence = refined.sequence(false);
        let mut along = sequence.push(&frames[..1]).expect("none before it");
        along.extend(sequence.push(&[]).expect("nothing"));
        along.extend(sequence.push(&frames[1..]).expect("flows"));
        assert_eq!(along, pairs);
        assert_eq!(refined.sequence(false).push_pair([&frames[1], &frames[2]]).expect("flow"), pairs[1]);
    }
}
