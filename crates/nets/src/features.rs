//! Features of a single frame.

use burn::tensor::Tensor;

use crate::blocks::Encoder;
use crate::frames::{Border, prepared};
use crate::recurrent::STRIDE;

/// Features of a batch of frames, from which correlations are computed. Every frame of a video but the first and last is in
/// two pairs; with [`Request::features`](crate::Request::features) it is encoded once.
#[derive(Debug, Clone)]
pub struct Features(pub(crate) Tensor<4>);

impl Features {
    /// Of frames in 0..1.
    pub(crate) fn of(encoder: &Encoder, frames: Tensor<4>) -> Self {
        let [_, _, height, width] = frames.dims();
        Self(encoder.forward(prepared(frames, Border::new([height, width], STRIDE))))
    }

    /// Of the frames of both sides of as many pairs, already prepared.
    pub(crate) fn of_both(encoder: &Encoder, frames: [Tensor<4>; 2]) -> [Self; 2] {
        // One after the other: both at once would double the memory, which is at its highest here.
        frames.map(|frames| Self(encoder.forward(frames)))
    }

    /// Those of several batches of frames of one size, as one.
    pub fn cat(batches: Vec<Self>) -> Self {
        Self(Tensor::cat(batches.into_iter().map(|features| features.0).collect(), 0))
    }

    /// Those of `frames` frames from `first` on. Panics when there are fewer.
    pub fn narrow(self, first: usize, frames: usize) -> Self {
        Self(self.0.narrow(0, first, frames))
    }

    /// How many frames they are of.
    pub fn frames(&self) -> usize {
        self.0.dims()[0]
    }
}
