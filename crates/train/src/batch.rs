//! Batches of samples as tensors for networks and losses.

use burn::tensor::{Device, Tensor, TensorData};
use srflow_core::Size;
use srflow_core::random::Key;
use srflow_nets::Frames;

use crate::loss::LossInputs;
use crate::ranks::share;
use crate::training_set::TrainingSample;

/// A batch in host memory, NCHW.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Batch {
    pub names: Vec<String>,
    /// Of the random choices for each sample.
    pub keys: Vec<Key>,
    /// Height and width of all samples.
    pub size: [usize; 2],
    /// First frames, RGB in 0..1: `[samples, 3, height, width]`.
    pub first: Vec<f32>,
    /// Second frames, like `first`.
    pub second: Vec<f32>,
    /// True flow in pixels, 0 where it is unknown: `[samples, 2, height, width]`.
    pub flow: Vec<f32>,
    /// 1 where the flow is known, else 0: `[samples, 1, height, width]`.
    pub valid: Vec<f32>,
    /// 1 on the head, and everywhere in a sample without mask, else 0: `[samples, 1, height, width]`.
    pub foreground: Vec<f32>,
}

impl Batch {
    /// Joins samples of one size.
    ///
    /// # Panics
    /// When the samples differ in size or one has no flow; a training set does not make such samples.
    pub fn new<'a>(samples: impl IntoIterator<Item = &'a TrainingSample>) -> Self {
        let mut batch = Self::default();
        for TrainingSample { name, key, sample } in samples {
            let Size { width, height } = sample.frame1.size();
            assert!(batch.names.is_empty() || batch.size == [height, width], "samples of one size");
            let flow = sample.flow.as_ref().expect("a sample with a flow");
            batch.size = [height, width];
            batch.names.push(name.clone());
            batch.keys.push(*key);
            for (planes, frame) in [(&mut batch.first, &sample.frame1), (&mut batch.second, &sample.frame2)] {
                for channel in 0..3 {
                    planes.extend(frame.pixels().iter().map(|pixel| f32::from(pixel[channel]) / 255.0));
                }
            }
            let known = |[u, v]: &[f32; 2]| u.is_finite() && v.is_finite();
            for component in 0..2 {
                let value = |flow: &[f32; 2]| if known(flow) { flow[component] } else { 0.0 };
                batch.flow.extend(flow.pixels().iter().map(value));
            }
            batch.valid.extend(flow.pixels().iter().map(|flow| f32::from(u8::from(known(flow)))));
            match &sample.mask {
                Some(mask) => {
                    batch.foreground.extend(mask.pixels().iter().map(|&inside| f32::from(u8::from(inside))));
                }
                None => batch.foreground.extend(std::iter::repeat_n(1.0, width * height)),
            }
        }
        batch
    }

    pub fn len(&self) -> usize {
        self.names.len()
    }

    pub fn is_empty(&self) -> bool {
        self.names.is_empty()
    }

    /// Splits the batch, in order, into at most `parts` non-empty parts of nearly equal size.
    pub fn split(&self, parts: usize) -> Vec<Self> {
        let count = self.len();
        let parts = parts.clamp(1, count.max(1));
        (0..parts).map(|i| self.samples(share(i, parts, count))).collect()
    }

    fn samples(&self, range: std::ops::Range<usize>) -> Self {
        let pixels = self.size[0] * self.size[1];
        let planes = |values: &[f32], channels: usize| {
            values[range.start * channels * pixels..range.end * channels * pixels].to_vec()
        };
        Self {
            names: self.names[range.clone()].to_vec(),
            keys: self.keys[range.clone()].to_vec(),
            size: self.size,
            first: planes(&self.first, 3),
            second: planes(&self.second, 3),
            flow: planes(&self.flow, 2),
            valid: planes(&self.valid, 1),
            foreground: planes(&self.foreground, 1),
        }
    }

    fn tensor(&self, values: &[f32], channels: usize, device: &Device) -> Tensor<4> {
        let shape = [self.len(), channels, self.size[0], self.size[1]];
        Tensor::from_data(TensorData::new(values.to_vec(), shape), device)
    }

    /// The input of the network.
    pub fn frames(&self, device: &Device) -> Frames {
        Frames { first: self.tensor(&self.first, 3, device), second: self.tensor(&self.second, 3, device) }
    }

    /// The true flow, 0 where it is unknown.
    pub(crate) fn truth(&self, device: &Device) -> Tensor<4> {
        self.tensor(&self.flow, 2, device)
    }

    /// The targets of the loss.
    pub fn loss_inputs(&self, device: &Device) -> LossInputs {
        LossInputs {
            truth: self.truth(device),
            valid: self.tensor(&self.valid, 1, device),
            first_frame: self.tensor(&self.first, 3, device),
            second_frame: self.tensor(&self.second, 3, device),
            foreground: Some(self.tensor(&self.foreground, 1, device)),
        }
    }

    /// Mean end-point error of `flow` (`[samples, 2, height, width]`) over the pixels with a known flow, in pixels; 0 when there
    /// are none.
    pub fn end_point_error(&self, flow: &[f32]) -> f64 {
        let pixels = self.size[0] * self.size[1];
        let (mut sum, mut count) = (0.0, 0.0);
        for sample in 0..self.len() {
            let start = sample * 2 * pixels;
            for pixel in 0..pixels {
                let (u, v) = (start + pixel, start + pixels + pixel);
                let valid = f64::from(self.valid[sample * pixels + pixel]);
                let distance = f64::from((flow[u] - self.flow[u]).hypot(flow[v] - self.flow[v]));
                if valid > 0.0 {
                    sum += distance;
                    count += valid;
                }
            }
        }
        if count > 0.0 { sum / count } else { 0.0 }
    }
}
