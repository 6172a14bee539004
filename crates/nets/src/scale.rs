//! Flow estimated at another scale of the frames.

use rayon::prelude::*;
use srflow_field::{EstimateError, FlowEstimator, FlowField, FlowSequence, Image};

use crate::tiles::check_sizes;

/// An estimator on frames resized by a factor; its flow is resized back.
pub struct Scaled {
    estimator: Box<dyn FlowEstimator>,
    factor: f64,
}

/// Width and height of a frame scaled by [`Scaled`]: each times `factor`, rounded, at least 1.
pub fn scaled_size((width, height): (usize, usize), factor: f64) -> (usize, usize) {
    let side = |side: usize| ((side as f64 * factor).round() as usize).max(1);
    (side(width), side(height))
}

impl Scaled {
    /// `estimator` on frames whose sides are `factor` times as long.
    ///
    /// # Errors
    /// When `factor` is not within 1/64 to 64.
    pub fn new(estimator: Box<dyn FlowEstimator>, factor: f64) -> Result<Self, EstimateError> {
        if (1.0 / 64.0..=64.0).contains(&factor) {
            return Ok(Self { estimator, factor });
        }
        Err(EstimateError::Unsupported {
            method: estimator.name().to_owned(),
            reason: format!(
                "cannot scale frames by {factor}: expected a factor from 1/64 to 64, such as 0.5"
            ),
        })
    }

    fn smaller(&self, frame: &Image) -> Image {
        resize_image(frame, scaled_size(frame.size(), self.factor))
    }
}

impl FlowEstimator for Scaled {
    fn name(&self) -> &str {
        self.estimator.name()
    }

    fn estimate(&self, frame1: &Image, frame2: &Image) -> Result<FlowField, EstimateError> {
        Ok(self.estimate_pairs(&[[frame1, frame2]])?.remove(0))
    }

    fn estimate_pairs(&self, pairs: &[[&Image; 2]]) -> Result<Vec<FlowField>, EstimateError> {
        let Some([first, _]) = pairs.first() else { return Ok(Vec::new()) };
        pairs.as_flattened().iter().try_for_each(|frame| check_sizes(first.size(), frame.size()))?;
        let smaller: Vec<[Image; 2]> =
            pairs.iter().map(|pair| pair.map(|frame| self.smaller(frame))).collect();
        let smaller: Vec<[&Image; 2]> = smaller.iter().map(|pair| pair.each_ref()).collect();
        let flows = self.estimator.estimate_pairs(&smaller)?;
        Ok(flows.iter().map(|flow| resize_flow(flow, first.size())).collect())
    }

    fn estimate_from(
        &self,
        frame1: &Image,
        frame2: &Image,
        initial: &FlowField,
    ) -> Result<FlowField, EstimateError> {
        check_sizes(frame1.size(), frame2.size())?;
        check_sizes(frame1.size(), initial.size())?;
        let initial = resize_flow(initial, scaled_size(initial.size(), self.factor));
        let flow = self.estimator.estimate_from(&self.smaller(frame1), &self.smaller(frame2), &initial)?;
        Ok(resize_flow(&flow, frame1.size()))
    }

    fn sequence(&self, warm_start: bool) -> Box<dyn FlowSequence + '_> {
        Box::new(ScaledSequence { scaled: self, sequence: self.estimator.sequence(warm_start), size: None })
    }
}

struct ScaledSequence<'a> {
    scaled: &'a Scaled,
    sequence: Box<dyn FlowSequence + 'a>,
    size: Option<(usize, usize)>,
}

impl FlowSequence for ScaledSequence<'_> {
    fn push(&mut self, frames: &[Image]) -> Result<Vec<FlowField>, EstimateError> {
        let Some(first) = frames.first() else { return Ok(Vec::new()) };
        let size = *self.size.get_or_insert(first.size());
        frames.iter().try_for_each(|frame| check_sizes(size, frame.size()))?;
        let smaller: Vec<Image> = frames.iter().map(|frame| self.scaled.smaller(frame)).collect();
        let flows = self.sequence.push(&smaller)?;
        Ok(flows.iter().map(|flow| resize_flow(flow, size)).collect())
    }
}

/// One pixel of the result reads the input from `first` on, by these weights, which sum to one.
struct Tap {
    first: usize,
    weights: Vec<f32>,
}

/// Linear interpolation; where the result is smaller, over as much of the input as one of its pixels covers, so that
/// nothing aliases. Pixel centres are integers and borders keep their place: `x` of the result lies at
/// `(x + 0.5) * input / output - 0.5`.
fn taps(input: usize, output: usize) -> Vec<Tap> {
    let scale = input as f64 / output as f64;
    let reach = scale.max(1.0);
    let tap = |x: usize| {
        let centre = (x as f64 + 0.5) * scale - 0.5;
        let first = (centre - reach).floor().max(0.0) as usize;
        let last = ((centre + reach).ceil() as usize).min(input - 1);
        let weight = |place: usize| (1.0 - (place as f64 - centre).abs() / reach).max(0.0);
        let sum: f64 = (first..=last).map(weight).sum();
        Tap { first, weights: (first..=last).map(|place| (weight(place) / sum) as f32).collect() }
    };
    (0..output).map(tap).collect()
}

/// Rows resized to `size`, `N` numbers a pixel.
fn resize<T: Copy + Sync, const N: usize>(
    pixels: &[T],
    from: (usize, usize),
    size: (usize, usize),
    numbers: impl Fn(T) -> [f32; N] + Sync,
) -> Vec<[f32; N]> {
    let (across, down) = (taps(from.0, size.0), taps(from.1, size.1));
    let mut out = vec![[0.0; N]; size.0 * size.1];
    out.par_chunks_mut(size.0).zip(&down).for_each_init(
        || vec![[0.0_f32; N]; from.0],
        |column_sums, (row, down)| {
            column_sums.fill([0.0; N]);
            for (y, weight) in down.weights.iter().enumerate() {
                let input = &pixels[(down.first + y) * from.0..][..from.0];
                for (sum, pixel) in column_sums.iter_mut().zip(input) {
                    let value = numbers(*pixel);
                    (0..N).for_each(|i| sum[i] += weight * value[i]);
                }
            }
            for (pixel, across) in row.iter_mut().zip(&across) {
                for (value, weight) in column_sums[across.first..].iter().zip(&across.weights) {
                    (0..N).for_each(|i| pixel[i] += weight * value[i]);
                }
            }
        },
    );
    out
}

fn resize_image(image: &Image, size: (usize, usize)) -> Image {
    if image.size() == size || image.pixels().is_empty() {
        return image.clone();
    }
    let numbers = resize(image.pixels(), image.size(), size, |pixel| pixel.map(f32::from));
    let mut resized = Image::new(size.0, size.1);
    for (pixel, value) in resized.pixels_mut().iter_mut().zip(numbers) {
        *pixel = value.map(|channel| (channel + 0.5) as u8);
    }
    resized
}

/// The vectors grow as the field does.
fn resize_flow(flow: &FlowField, size: (usize, usize)) -> FlowField {
    if flow.size() == size || flow.pixels().is_empty() {
        return flow.clone();
    }
    let grow = [size.0 as f32 / flow.width() as f32, size.1 as f32 / flow.height() as f32];
    let numbers = resize(flow.pixels(), flow.size(), size, |[u, v]| [u * grow[0], v * grow[1]]);
    let mut resized = FlowField::new(size.0, size.1);
    resized.pixels_mut().copy_from_slice(&numbers);
    resized
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Says the size of what it sees, a hundredth a pixel.
    struct Sizes;

    impl FlowEstimator for Sizes {
        fn name(&self) -> &str {
            "sizes"
        }

        fn estimate(&self, frame1: &Image, _: &Image) -> Result<FlowField, EstimateError> {
            let (width, height) = frame1.size();
            Ok(FlowField::filled(width, height, [width as f32 / 100.0, height as f32 / 100.0]))
        }
    }

    #[test]
    fn the_method_sees_the_scaled_frame_and_the_flow_comes_back_in_its_pixels() {
        let frame = Image::new(100, 61);
        for (factor, seen) in [(0.5, (50, 31)), (2.0, (200, 122)), (1.0, (100, 61)), (0.02, (2, 1))] {
            let scaled = Scaled::new(Box::new(Sizes), factor).expect("a factor in range");
            assert_eq!(scaled_size(frame.size(), factor), seen);
            let flow = scaled.estimate(&frame, &frame).expect("flow");
            let moving = scaled.sequence(false).push(&[frame.clone(), frame.clone()]).expect("flow");
            for flow in [&flow, &moving[0]] {
                assert_eq!(flow.size(), (100, 61));
                // What it saw, times how much smaller that was: the frame's own size again.
                let near = |[u, v]: [f32; 2]| (u - 1.0).abs() < 1e-4 && (v - 0.61).abs() < 1e-4;
                assert!(flow.pixels().iter().all(|vector| near(*vector)), "{factor}: {:?}", flow.get(0, 0));
            }
        }
        for factor in [0.0, -1.0, f64::NAN, f64::INFINITY, 0.001] {
            assert!(Scaled::new(Box::new(Sizes), factor).is_err(), "{factor}");
        }
    }

    /// A ramp stays the ramp it was, away from the borders; where pixels do not divide evenly, weights that are made to sum to
    /// one move it by a small part of a pixel.
    #[test]
    fn resizing_keeps_places() {
        let flow = FlowField::from_fn(64, 48, |x, y| [x as f32, y as f32]);
        for size in [(32, 24), (128, 96), (21, 31)] {
            let resized = resize_flow(&flow, size);
            let scale = (64.0 / size.0 as f32, 48.0 / size.1 as f32);
            for (x, y) in [(size.0 / 2, size.1 / 2), (size.0 / 3, size.1 - size.1 / 4)] {
                let place = [(x as f32 + 0.5) * scale.0 - 0.5, (y as f32 + 0.5) * scale.1 - 0.5];
                let [u, v] = resized.get(x, y);
                let found = [u * scale.0, v * scale.1];
                let near = |i: usize| (found[i] - place[i]).abs() < 0.05;
                assert!(near(0) && near(1), "{size:?}: {found:?} for {place:?}");
            }
        }
    }

    /// Every other column black: half the size is grey, not black or white.
    #[test]
    fn a_smaller_image_does_not_alias() {
        let image = Image::from_fn(64, 8, |x, _| [if x % 2 == 0 { 0 } else { 255 }; 3]);
        let half = resize_image(&image, (32, 4));
        assert!(half.pixels().iter().all(|pixel| pixel[0].abs_diff(128) < 40), "{:?}", half.row(2));
        assert_eq!(
            resize_image(&Image::filled(7, 5, [9, 99, 200]), (3, 11)),
            Image::filled(3, 11, [9, 99, 200])
        );
    }
}
