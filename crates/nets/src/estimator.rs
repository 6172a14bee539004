//! Networks as [`FlowEstimator`]s.

use burn::tensor::{Device, Tensor, TensorData};
use rayon::prelude::*;
use srflow_core::{
    EstimateError, FlowEstimate, FlowEstimator, FlowField, FlowSequence, Image, Plane, Size,
    check_frame_sizes, forward_interpolate,
};

use srflow_ops::{Precision, with_precision};

use crate::shots::is_cut;
use crate::{Estimate, Facts, Features, Frames, Iterations, Memory, Network, Request, Start};

/// A [`Network`] that estimates flow between images of any size.
pub struct NetworkEstimator {
    name: String,
    network: Network,
    iterations: Iterations,
    device: Device,
    precision: Precision,
}

impl NetworkEstimator {
    /// An estimator with `network`, whose parameters must be on `device`. `name` is for tables and errors.
    pub fn new(
        name: impl Into<String>,
        network: Network,
        iterations: impl Into<Iterations>,
        device: Device,
    ) -> Self {
        let (name, iterations) = (name.into(), iterations.into());
        Self { name, network, iterations, device, precision: Precision::F32 }
    }

    /// The same, multiplying at a precision that its device has; see [`with_precision`].
    pub fn with_precision(self, precision: Precision) -> Self {
        Self { precision, ..self }
    }

    fn facts(&self) -> &'static Facts {
        self.network.architecture().facts()
    }

    fn canvas(&self, size: Size) -> Canvas {
        Canvas::new(size, self.facts().smallest_side)
    }

    fn encoded(&self, frame: &Image) -> EncodedFrame {
        let frame = self.canvas(frame.size()).extended(frame);
        let features = with_precision(self.precision, || self.network.features(self.tensor(&[&frame])));
        EncodedFrame { frame, features }
    }

    /// The multiple to which the sides of an extended frame are padded.
    fn padding(&self, Canvas { extended: Size { width, height }, .. }: Canvas) -> usize {
        self.network.padding().of([height, width])
    }

    fn unsupported(&self, reason: impl Into<String>) -> EstimateError {
        EstimateError::Unsupported { method: self.name.clone(), reason: reason.into() }
    }

    /// Side of a coarse pixel of [`Request::start`] in pixels, for frames that are padded to multiples of `padding`.
    fn start_stride(&self, padding: usize) -> Result<usize, EstimateError> {
        match self.facts().start {
            Start::Coarse(stride) => Ok(stride),
            Start::CoarsestLevel => Ok(padding),
            Start::Frames(why) => Err(self.unsupported(format!("cannot start from a given flow: {why}"))),
        }
    }

    /// Frames of one size as a tensor `[frames, 3, height, width]` in 0..1.
    fn tensor(&self, frames: &[&Image]) -> Tensor<4> {
        let Size { width, height } = frames[0].size();
        let pixels = width * height;
        let mut numbers = vec![0.0_f32; frames.len() * 3 * pixels];
        for (frame, channels) in frames.iter().zip(numbers.chunks_mut(3 * pixels.max(1))) {
            for (channel, numbers) in channels.chunks_mut(pixels).enumerate() {
                let pairs = numbers.par_chunks_mut(width).zip(frame.pixels().par_chunks(width));
                pairs.for_each(|(numbers, pixels)| {
                    for (number, pixel) in numbers.iter_mut().zip(pixels) {
                        *number = f32::from(pixel[channel]) / 255.0;
                    }
                });
            }
        }
        Tensor::from_data(TensorData::new(numbers, [frames.len(), 3, height, width]), &self.device)
    }

    /// Estimates flow from the first `pairs` frames to the last `pairs` frames.
    fn forward(
        &self,
        frames: &[EncodedFrame],
        pairs: usize,
        start: Option<Tensor<4>>,
        memory: Option<Memory>,
    ) -> Estimate {
        let features = match frames {
            // Concatenating would copy them.
            [first, second] if pairs == 1 => [first.features.clone(), second.features.clone()],
            _ => {
                let all = Features::cat(frames.iter().map(|encoded| encoded.features.clone()).collect());
                [all.clone().narrow(0, pairs), all.narrow(frames.len() - pairs, pairs)]
            }
        };
        let images: Vec<&Image> = frames.iter().map(|encoded| &encoded.frame).collect();
        let second = frames.len() - pairs;
        let frames = Frames { first: self.tensor(&images[..pairs]), second: self.tensor(&images[second..]) };
        let most = self.iterations.most(self.facts()).get();
        let still_px = self.still_px();
        let request = Request { still_px, start, features: Some(features), memory, ..Request::new(most) };
        let forward = || self.network.forward(frames, &request);
        with_precision(self.precision, forward)
    }

    /// With which pairs are estimated one by one, so that none refines longer because of another.
    fn still_px(&self) -> Option<f32> {
        self.iterations.still_px(self.facts())
    }

    /// The flows of a batch, cropped to the size of the frames.
    fn fields(&self, flows: &Tensor<4>, canvas: Canvas) -> Result<Vec<FlowField>, EstimateError> {
        let [pairs, _, height, width] = flows.dims();
        let numbers = self.numbers(flows.clone())?;
        let planes: Vec<&[f32]> = numbers.chunks(width * height).collect();
        let field = |pair: usize| {
            let [u, v] = [planes[2 * pair], planes[2 * pair + 1]];
            let (left, top) = canvas.corner;
            FlowField::from_fn(canvas.size.width, canvas.size.height, |x, y| {
                let at = (top + y) * width + left + x;
                [u[at], v[at]]
            })
        };
        Ok((0..pairs).map(field).collect())
    }

    /// The flows of a batch, cropped to the size of the frames, with the number of iterations.
    fn flows(&self, estimate: &Estimate, canvas: Canvas) -> Result<Vec<FlowEstimate>, EstimateError> {
        let iterations = estimate.iterations.map(|number| number as f32);
        let flows = self.fields(estimate.last(), canvas)?.into_iter();
        Ok(flows.map(|flow| FlowEstimate { iterations, ..flow.into() }).collect())
    }

    /// The estimates of a batch, cropped to the size of the frames.
    fn estimates(&self, estimate: &Estimate, canvas: Canvas) -> Result<Vec<FlowEstimate>, EstimateError> {
        let uncertainty =
            estimate.mixtures.last().map(|mixture| mixture.mean_scale(self.facts().log_scale_range));
        let mut uncertainty = self.planes(uncertainty, canvas)?.into_iter();
        let mut occlusion = self.planes(estimate.occlusion.clone(), canvas)?.into_iter();
        let flows = self.flows(estimate, canvas)?;
        let with_planes =
            |flow| FlowEstimate { uncertainty: uncertainty.next(), occlusion: occlusion.next(), ..flow };
        Ok(flows.into_iter().map(with_planes).collect())
    }

    /// Planes of a tensor `[batch, 1, height, width]`, cropped to the size of the frames; empty without a tensor.
    fn planes(&self, tensor: Option<Tensor<4>>, canvas: Canvas) -> Result<Vec<Plane>, EstimateError> {
        let Some(tensor) = tensor else { return Ok(Vec::new()) };
        let [_, _, height, width] = tensor.dims();
        let numbers = self.numbers(tensor)?;
        let Canvas { size, corner: (left, top), .. } = canvas;
        let plane = |numbers: &[f32]| {
            Plane::from_fn(size.width, size.height, |x, y| numbers[(top + y) * width + left + x])
        };
        Ok(numbers.chunks(width * height).map(plane).collect())
    }

    fn numbers(&self, tensor: Tensor<4>) -> Result<Vec<f32>, EstimateError> {
        let data = tensor.into_data().convert::<f32>();
        let numbers: Vec<f32> = data.try_to_vec().map_err(|error| self.unsupported(format!("{error:?}")))?;
        if let Some(wrong) = numbers.iter().find(|number| !number.is_finite()) {
            return Err(self.unsupported(format!(
                "computed {wrong} instead of a flow: its weights are broken, or unsuitable for this number of iterations; try others"
            )));
        }
        Ok(numbers)
    }

    /// Reduces `flow`, which has the size of the frames, to a coarse flow in coarse pixels, the mean over the known pixels of each.
    fn coarse(&self, flow: &FlowField, canvas: Canvas) -> Result<Tensor<4>, EstimateError> {
        let padding = self.padding(canvas);
        let stride = self.start_stride(padding)?;
        let Canvas { size, extended, corner } = canvas;
        let padded = [extended.width, extended.height].map(|side| side.next_multiple_of(padding));
        let [width, height] = padded.map(|side| side / stride);
        let border = [padded[0] - extended.width, padded[1] - extended.height];
        let from = |padded: usize, border: usize, corner: usize, side: usize| {
            (padded.saturating_sub(border / 2).saturating_sub(corner)).min(side - 1)
        };
        let mut planes = vec![0.0_f32; 2 * width * height];
        let (u, v) = planes.split_at_mut(width * height);
        for (at, (u, v)) in u.iter_mut().zip(v).enumerate() {
            let (column, row) = (at % width, at / width);
            let (mut sum, mut count) = ([0.0_f32; 2], 0);
            for y in row * stride..(row + 1) * stride {
                for x in column * stride..(column + 1) * stride {
                    let x = from(x, border[0], corner.0, size.width);
                    let y = from(y, border[1], corner.1, size.height);
                    if flow.is_known(x, y) {
                        let vector = flow.get(x, y);
                        sum = [sum[0] + vector[0], sum[1] + vector[1]];
                        count += 1;
                    }
                }
            }
            [*u, *v] = sum.map(|sum| sum / (count.max(1) * stride) as f32);
        }
        Ok(Tensor::from_data(TensorData::new(planes, [1, 2, height, width]), &self.device))
    }

    /// The start of the next pair: the coarse flow of the previous pair, warped forward.
    fn warped_forward(&self, coarse: &Tensor<4>) -> Result<Tensor<4>, EstimateError> {
        let dims @ [_, _, height, width] = coarse.dims();
        let numbers = self.numbers(coarse.clone())?;
        let (u, v) = numbers.split_at(width * height);
        let moved = forward_interpolate(&FlowField::from_fn(width, height, |x, y| {
            let at = y * width + x;
            [u[at], v[at]]
        }));
        let planes = [0, 1].map(|axis| moved.pixels().iter().map(move |vector| vector[axis]));
        let numbers: Vec<f32> = planes.into_iter().flatten().collect();
        Ok(Tensor::from_data(TensorData::new(numbers, dims), &self.device))
    }
}

impl FlowEstimator for NetworkEstimator {
    fn name(&self) -> &str {
        &self.name
    }

    fn estimate(&self, frame1: &Image, frame2: &Image) -> Result<FlowField, EstimateError> {
        Ok(self.estimate_pairs(&[[frame1, frame2]])?.remove(0).flow)
    }

    fn estimate_pairs(&self, pairs: &[[&Image; 2]]) -> Result<Vec<FlowEstimate>, EstimateError> {
        self.between(pairs, None)
    }

    fn estimate_from(
        &self,
        frame1: &Image,
        frame2: &Image,
        initial: &FlowField,
    ) -> Result<FlowEstimate, EstimateError> {
        check_frame_sizes(frame1.size(), [initial.size()])?;
        Ok(self.between(&[[frame1, frame2]], Some(initial))?.remove(0))
    }

    fn remembers(&self) -> bool {
        self.facts().remembers
    }

    fn sequence(&self, warm_start: bool) -> Box<dyn FlowSequence + '_> {
        Box::new(NetworkSequence { estimator: self, warm_start, state: None })
    }
}

impl NetworkEstimator {
    /// Estimates pairs of one size. `initial` is only allowed for a single pair.
    fn between(
        &self,
        pairs: &[[&Image; 2]],
        initial: Option<&FlowField>,
    ) -> Result<Vec<FlowEstimate>, EstimateError> {
        let Some([first, _]) = pairs.first() else { return Ok(Vec::new()) };
        let canvas = self.canvas(first.size());
        check_frame_sizes(canvas.size, pairs.as_flattened().iter().map(|frame| frame.size()))?;
        if canvas.is_empty() {
            return Ok(vec![FlowField::new(canvas.size.width, canvas.size.height).into(); pairs.len()]);
        }
        if pairs.len() > 1 && self.still_px().is_some() {
            return pairs.iter().map(|pair| Ok(self.between(&[*pair], None)?.remove(0))).collect();
        }
        let start = initial.map(|initial| self.coarse(initial, canvas)).transpose()?;
        let encoded: Vec<EncodedFrame> =
            [0, 1].iter().flat_map(|of| pairs.iter().map(|pair| self.encoded(pair[*of]))).collect();
        let estimate = self.forward(&encoded, pairs.len(), start, None);
        self.flows(&estimate, canvas)
    }
}

/// A padded frame and its features.
struct EncodedFrame {
    frame: Image,
    features: Features,
}

struct NetworkSequence<'a> {
    estimator: &'a NetworkEstimator,
    warm_start: bool,
    state: Option<State>,
}

struct State {
    canvas: Canvas,
    last: EncodedFrame,
    /// Coarse flow of the previous pair, for a warm start.
    coarse: Option<Tensor<4>>,
    memory: Option<Memory>,
}

impl FlowSequence for NetworkSequence<'_> {
    fn push(&mut self, frames: &[Image]) -> Result<Vec<FlowEstimate>, EstimateError> {
        let Some(first) = frames.first() else { return Ok(Vec::new()) };
        let size = self.state.as_ref().map_or(first.size(), |state| state.canvas.size);
        check_frame_sizes(size, frames.iter().map(Image::size))?;
        let canvas = self.estimator.canvas(size);
        if canvas.is_empty() {
            return Ok(Vec::new());
        }
        if self.warm_start {
            self.estimator.start_stride(self.estimator.padding(canvas))?;
        }
        // Warm start and memory need the result of the previous pair; see also `still_px`.
        let sequential = self.warm_start || self.estimator.remembers() || self.estimator.still_px().is_some();
        let at_once = if sequential { 1 } else { frames.len() };
        let mut estimates = Vec::with_capacity(frames.len());
        for frames in frames.chunks(at_once) {
            estimates.extend(self.next(frames)?);
        }
        Ok(estimates)
    }

    fn push_pair(&mut self, [first, second]: [&Image; 2]) -> Result<FlowEstimate, EstimateError> {
        let size = self.state.as_ref().map_or(first.size(), |state| state.canvas.size);
        check_frame_sizes(size, [first.size(), second.size()])?;
        match &mut self.state {
            Some(state) if state.canvas.extended(first) == state.last.frame => {}
            Some(state) => state.last = self.estimator.encoded(first),
            None => drop(self.push(std::slice::from_ref(first))?),
        }
        match self.push(std::slice::from_ref(second))?.pop() {
            Some(estimate) => Ok(estimate),
            None => Ok(FlowField::new(size.width, size.height).into()), // frames without pixels
        }
    }
}

impl NetworkSequence<'_> {
    /// Estimates all pairs at once. `frames` must not be empty, and its frames must have one size.
    fn next(&mut self, frames: &[Image]) -> Result<Vec<FlowEstimate>, EstimateError> {
        let canvas = self.estimator.canvas(frames[0].size());
        let (last, coarse, mut memory) = match self.state.take() {
            Some(state) => (Some(state.last), state.coarse, state.memory),
            None => (None, None, None),
        };
        // One frame after another, since memory peaks in the encoder.
        let mut video: Vec<EncodedFrame> = last.into_iter().collect();
        video.extend(frames.iter().map(|frame| self.estimator.encoded(frame)));
        let (mut estimates, mut next_coarse, mut next_memory) = (Ok(Vec::new()), None, None);
        if video.len() > 1 {
            // A pair across a cut neither uses the memory nor is remembered.
            let cut = self.estimator.remembers() && is_cut(&video[0].frame, &video[1].frame);
            memory = memory.filter(|_| !cut);
            let start = coarse.map(|coarse| self.estimator.warped_forward(&coarse)).transpose()?;
            let estimate = self.estimator.forward(&video, video.len() - 1, start, memory);
            estimates = self.estimator.estimates(&estimate, canvas);
            next_coarse = estimate.coarse.filter(|_| self.warm_start);
            next_memory = estimate.memory.filter(|_| !cut);
        }
        self.state = video.pop().map(|last| State { canvas, last, coarse: next_coarse, memory: next_memory });
        estimates
    }
}

/// Position of a frame in its padding to the smallest side.
#[derive(Debug, Clone, Copy)]
struct Canvas {
    size: Size,
    extended: Size,
    corner: (usize, usize),
}

impl Canvas {
    fn new(size: Size, smallest_side: usize) -> Self {
        let extended = Size::new(size.width.max(smallest_side), size.height.max(smallest_side));
        let corner = ((extended.width - size.width) / 2, (extended.height - size.height) / 2);
        Self { size, extended, corner }
    }

    fn is_empty(&self) -> bool {
        self.size.pixels() == 0
    }

    fn extended(&self, frame: &Image) -> Image {
        if self.extended == self.size {
            return frame.clone();
        }
        let inside = |place: usize, corner: usize, side: usize| place.saturating_sub(corner).min(side - 1);
        Image::from_fn(self.extended.width, self.extended.height, |x, y| {
            frame.get(inside(x, self.corner.0, self.size.width), inside(y, self.corner.1, self.size.height))
        })
    }
}
