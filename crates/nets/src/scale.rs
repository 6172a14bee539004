//! Estimates flow on resized frames.

use srflow_core::resize::{resize_flow_antialiased, resize_image_antialiased, resize_plane_antialiased};
use srflow_core::{
    EstimateError, FlowEstimate, FlowEstimator, FlowField, FlowSequence, Image, check_frame_sizes,
};

/// Applies an estimator to frames resized by a factor, and resizes its results back.
pub struct Scaled {
    estimator: Box<dyn FlowEstimator>,
    factor: f64,
}

/// Width and height of a frame after scaling by [`Scaled`]: each times `factor`, rounded, at least 1.
pub fn scaled_size((width, height): (usize, usize), factor: f64) -> (usize, usize) {
    let side = |side: usize| ((side as f64 * factor).round() as usize).max(1);
    (side(width), side(height))
}

impl Scaled {
    /// Scales the sides of frames by `factor` for `estimator`.
    ///
    /// # Errors
    /// When `factor` is not in 1/64 to 64.
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

    fn resized_frame(&self, frame: &Image) -> Image {
        resize_image_antialiased(frame, scaled_size(frame.size(), self.factor))
    }
}

impl FlowEstimator for Scaled {
    fn name(&self) -> &str {
        self.estimator.name()
    }

    fn estimate(&self, frame1: &Image, frame2: &Image) -> Result<FlowField, EstimateError> {
        Ok(self.estimate_pairs(&[[frame1, frame2]])?.remove(0).flow)
    }

    fn estimate_pairs(&self, pairs: &[[&Image; 2]]) -> Result<Vec<FlowEstimate>, EstimateError> {
        let Some([first, _]) = pairs.first() else { return Ok(Vec::new()) };
        check_frame_sizes(first.size(), pairs.as_flattened().iter().map(|frame| frame.size()))?;
        let scaled: Vec<[Image; 2]> =
            pairs.iter().map(|pair| pair.map(|frame| self.resized_frame(frame))).collect();
        let scaled: Vec<[&Image; 2]> = scaled.iter().map(|pair| pair.each_ref()).collect();
        let estimates = self.estimator.estimate_pairs(&scaled)?;
        Ok(estimates.into_iter().map(|estimate| resized(estimate, first.size())).collect())
    }

    fn estimate_from(
        &self,
        frame1: &Image,
        frame2: &Image,
        initial: &FlowField,
    ) -> Result<FlowEstimate, EstimateError> {
        check_frame_sizes(frame1.size(), [frame2.size(), initial.size()])?;
        let initial = resize_flow_antialiased(initial, scaled_size(initial.size(), self.factor));
        let estimate = self.estimator.estimate_from(
            &self.resized_frame(frame1),
            &self.resized_frame(frame2),
            &initial,
        )?;
        Ok(resized(estimate, frame1.size()))
    }

    fn remembers(&self) -> bool {
        self.estimator.remembers()
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
    fn push(&mut self, frames: &[Image]) -> Result<Vec<FlowEstimate>, EstimateError> {
        let Some(first) = frames.first() else { return Ok(Vec::new()) };
        let size = *self.size.get_or_insert(first.size());
        check_frame_sizes(size, frames.iter().map(Image::size))?;
        let scaled: Vec<Image> = frames.iter().map(|frame| self.scaled.resized_frame(frame)).collect();
        let estimates = self.sequence.push(&scaled)?;
        Ok(estimates.into_iter().map(|estimate| resized(estimate, size)).collect())
    }

    fn push_pair(&mut self, pair: [&Image; 2]) -> Result<FlowEstimate, EstimateError> {
        let size = *self.size.get_or_insert(pair[0].size());
        check_frame_sizes(size, pair.map(Image::size))?;
        let scaled = pair.map(|frame| self.scaled.resized_frame(frame));
        Ok(resized(self.sequence.push_pair(scaled.each_ref())?, size))
    }
}

/// Resizes an estimate. The uncertainty, which is common to both components of the flow, is scaled by the geometric mean of the
/// two factors.
fn resized(estimate: FlowEstimate, size: (usize, usize)) -> FlowEstimate {
    let from = estimate.flow.size();
    if from == size {
        return estimate;
    }
    let grow = |to: usize, from: usize| to as f32 / from.max(1) as f32;
    let gain = (grow(size.0, from.0) * grow(size.1, from.1)).sqrt();
    FlowEstimate {
        flow: resize_flow_antialiased(&estimate.flow, size),
        uncertainty: estimate.uncertainty.map(|plane| resize_plane_antialiased(&plane, size, gain)),
        occlusion: estimate.occlusion.map(|plane| resize_plane_antialiased(&plane, size, 1.0)),
        iterations: estimate.iterations,
    }
}

#[cfg(test)]
mod tests {
    use srflow_core::Plane;

    use super::*;

    /// The flow is the size of the frames, in hundreds of pixels.
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
    fn uncertainty_is_in_pixels_of_the_frame_and_occlusion_a_probability() {
        let estimate = FlowEstimate {
            flow: FlowField::filled(50, 31, [1.0, 1.0]),
            uncertainty: Some(Plane::filled(50, 31, 3.0)),
            occlusion: Some(Plane::filled(50, 31, 0.25)),
            iterations: Some(2.5),
        };
        let FlowEstimate { flow, uncertainty, occlusion, iterations } = resized(estimate.clone(), (100, 62));
        let near = |plane: Option<Plane>, expected: f32| {
            let plane = plane.expect("kept");
            assert_eq!(plane.size(), (100, 62));
            assert!(
                plane.pixels().iter().all(|value| (value - expected).abs() < 1e-5),
                "{}",
                plane.get(0, 0)
            );
        };
        assert_eq!(flow.size(), (100, 62));
        near(uncertainty, 6.0);
        near(occlusion, 0.25);
        assert_eq!(iterations, Some(2.5));
        assert_eq!(resized(estimate.clone(), (50, 31)), estimate);
    }

    #[test]
    fn the_estimator_gets_scaled_frames_and_flow_is_scaled_back() {
        let frame = Image::new(100, 61);
        for (factor, seen) in [(0.5, (50, 31)), (2.0, (200, 122)), (1.0, (100, 61)), (0.02, (2, 1))] {
            let scaled = Scaled::new(Box::new(Sizes), factor).expect("a factor in range");
            assert_eq!(scaled_size(frame.size(), factor), seen);
            let flow = scaled.estimate(&frame, &frame).expect("flow");
            let moving = scaled.sequence(false).push(&[frame.clone(), frame.clone()]).expect("flow");
            for flow in [&flow, &moving[0].flow] {
                assert_eq!(flow.size(), (100, 61));
                // The size of the scaled frame times the inverse factor is the size of the frame.
                let near = |[u, v]: [f32; 2]| (u - 1.0).abs() < 1e-4 && (v - 0.61).abs() < 1e-4;
                assert!(flow.pixels().iter().all(|vector| near(*vector)), "{factor}: {:?}", flow.get(0, 0));
            }
        }
        for factor in [0.0, -1.0, f64::NAN, f64::INFINITY, 0.001] {
            assert!(Scaled::new(Box::new(Sizes), factor).is_err(), "{factor}");
        }
    }
}
