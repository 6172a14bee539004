//! Random changes to a sample that keep its flow correct: colour, erased rectangles, scale, flips, crop.
//!
//! Implements SKFlow's augmentation (core/utils/augmentor.py, which is RAFT's), in its order. All random numbers come from a
//! key ([`srflow_core::random`]): a sample can be computed alone, in any order, on any number of threads, and is bit-identical.

mod color;
mod config;
mod eraser;
mod error;
mod geometry;
mod hue;
mod resample;
mod sparse;
mod still;
#[cfg(test)]
mod tests;

use srflow_core::random::Key;
use srflow_core::{FlowField, Mask, SizeMismatch};

pub use config::AugmentConfig;
pub use error::AugmentError;

use color::ColorJitter;
use geometry::Geometry;
use hue::HueTables;
use srflow_data::flow::{Sample, TruthDensity};

/// Applies random changes to samples.
#[derive(Debug, Clone)]
pub struct Augmentation {
    config: AugmentConfig,
    hue: HueTables,
}

impl Augmentation {
    /// Applies the changes that `config` describes.
    ///
    /// # Errors
    /// When a number of it is out of range.
    pub fn new(config: AugmentConfig) -> Result<Self, AugmentError> {
        config.check()?;
        Ok(Self { config, hue: HueTables::new() })
    }

    pub fn config(&self) -> &AugmentConfig {
        &self.config
    }

    /// A sample of the crop's size, deterministic in sample and key.
    ///
    /// The flow is scaled, flipped and shifted with the frames; masks follow frame 1. A frame smaller than the crop is always
    /// scaled to fit it.
    ///
    /// # Errors
    /// When the frames are empty, or the parts of the sample have different sizes.
    pub fn apply(&self, mut sample: Sample, key: Key) -> Result<Sample, AugmentError> {
        check_sizes(&sample)?;
        still::still(&mut sample, &self.config, key);
        let Sample { frame1, frame2, .. } = &mut sample;
        if key.stream("augment: asymmetric").unit() < self.config.asymmetric_probability {
            ColorJitter::draw(&self.config, &mut key.stream("augment: color 1"))
                .apply(&mut [frame1], &self.hue);
            ColorJitter::draw(&self.config, &mut key.stream("augment: color 2"))
                .apply(&mut [frame2], &self.hue);
        } else {
            let jitter = ColorJitter::draw(&self.config, &mut key.stream("augment: color 1"));
            jitter.apply(&mut [frame1, frame2], &self.hue);
        }
        eraser::erase(frame2, &self.config, &mut key.stream("augment: eraser"));
        let geometry = Geometry::draw(&self.config, sample.frame1.size(), key);
        let (of_frame2, shift) = geometry.shifted(&self.config, key);
        let mask = sample.mask.as_ref().map(|mask| geometry.mask(mask));
        let mut flow = sample.flow.as_ref().map(|flow| match self.config.truth {
            TruthDensity::Dense => geometry.dense_flow(flow),
            TruthDensity::Sparse => geometry.sparse_flow(flow),
        });
        if let Some(flow) = flow.as_mut().filter(|_| shift != [0.0; 2]) {
            add_shift(flow, shift, mask.as_ref().filter(|_| !self.config.shift_background));
        }
        Ok(Sample {
            frame1: geometry.frame(&sample.frame1),
            frame2: of_frame2.frame(&sample.frame2),
            flow,
            mask,
            occlusion: sample.occlusion.as_ref().map(|occlusion| geometry.mask(occlusion)),
        })
    }
}

/// Adds a constant to the whole flow. Outside the mask, if there is one, the flow becomes unknown: the motion of a plain background is
/// not visible, and a network must not learn it.
fn add_shift(flow: &mut FlowField, shift: [f32; 2], mask: Option<&Mask>) {
    for (index, pixel) in flow.pixels_mut().iter_mut().enumerate() {
        let shown = mask.is_none_or(|mask| mask.pixels()[index]);
        *pixel = if shown { [pixel[0] + shift[0], pixel[1] + shift[1]] } else { [f32::NAN; 2] };
    }
}

fn check_sizes(sample: &Sample) -> Result<(), AugmentError> {
    let frame = sample.frame1.size();
    if frame.width == 0 || frame.height == 0 {
        return Err(AugmentError::Empty(frame));
    }
    let others = [
        ("frame 2", Some(sample.frame2.size())),
        ("the flow", sample.flow.as_ref().map(|flow| flow.size())),
        ("the mask", sample.mask.as_ref().map(|mask| mask.size())),
        ("the occlusion", sample.occlusion.as_ref().map(|occlusion| occlusion.size())),
    ];
    for (name, size) in others {
        if let Some(size) = size.filter(|size| *size != frame) {
            return Err(SizeMismatch {
                first_name: "frame 1",
                first: frame,
                second_name: name,
                second: size,
            }
            .into());
        }
    }
    Ok(())
}
