//! Features of a single frame.

use burn::tensor::Tensor;

/// What a network computes of each frame of a batch on its own, such as the features from which correlations are computed. Every
/// frame of a video but the first and last is in two pairs; with [`Request::features`](crate::Request::features) it is encoded
/// once.
#[derive(Debug, Clone)]
pub struct Features {
    frames: usize,
    /// `[frames, ...]` each, such as the levels of a pyramid; none for a network that looks at pairs alone.
    maps: Vec<Tensor<4>>,
}

impl Features {
    pub(crate) fn new(frames: usize, maps: Vec<Tensor<4>>) -> Self {
        Self { frames, maps }
    }

    /// The maps, of which the network knows how many there are.
    pub(crate) fn into_maps<const N: usize>(self) -> [Tensor<4>; N] {
        let count = self.maps.len();
        self.maps.try_into().unwrap_or_else(|_| panic!("features of another network: {count} maps for {N}"))
    }

    /// The maps of a network that makes as many as it has levels.
    pub(crate) fn into_levels(self) -> Vec<Tensor<4>> {
        self.maps
    }

    /// Those of several batches of frames of one size, as one. Panics without a batch.
    pub fn cat(batches: Vec<Self>) -> Self {
        let map = |number: usize| {
            Tensor::cat(batches.iter().map(|features| features.maps[number].clone()).collect(), 0)
        };
        Self {
            frames: batches.iter().map(Self::frames).sum(),
            maps: (0..batches[0].maps.len()).map(map).collect(),
        }
    }

    /// Those of `frames` frames from `first` on. Panics when there are fewer.
    pub fn narrow(self, first: usize, frames: usize) -> Self {
        assert!(first + frames <= self.frames, "{frames} frames from {first} on, of {}", self.frames);
        Self { frames, maps: self.maps.into_iter().map(|map| map.narrow(0, first, frames)).collect() }
    }

    /// How many frames they are of.
    pub fn frames(&self) -> usize {
        self.frames
    }
}
