//! Features of a single frame.

use burn::tensor::Tensor;

use crate::frames::{Border, prepared};

/// Feature maps that a network computes from each frame of a batch on its own. Most frames of a video belong to two pairs; with
/// [`Request::features`](crate::Request::features) each is encoded only once.
#[derive(Debug, Clone)]
pub struct Features {
    frames: usize,
    /// Each `[frames, ...]`, such as the levels of a pyramid; empty for a network that only encodes pairs.
    maps: Vec<Tensor<4>>,
}

impl Features {
    pub(crate) fn new(frames: usize, maps: Vec<Tensor<4>>) -> Self {
        Self { frames, maps }
    }

    /// The maps that `encode` computes from frames, RGB in 0..1, [prepared] with padding to multiples of `multiple`.
    pub(crate) fn of_prepared(
        frames: Tensor<4>,
        multiple: usize,
        encode: impl FnOnce(Tensor<4>) -> Vec<Tensor<4>>,
    ) -> Self {
        let [batch, _, height, width] = frames.dims();
        Self::new(batch, encode(prepared(frames, Border::new([height, width], multiple))))
    }

    /// The maps. Panics when there are not `N` of them.
    pub(crate) fn into_maps<const N: usize>(self) -> [Tensor<4>; N] {
        let count = self.maps.len();
        self.maps.try_into().unwrap_or_else(|_| {
            panic!("expected {N} feature maps, found {count}: features of another network")
        })
    }

    /// The map of a network with one. Panics when there are others.
    pub(crate) fn into_map(self) -> Tensor<4> {
        let [map] = self.into_maps();
        map
    }

    /// The maps of a network with a variable number of levels.
    pub(crate) fn into_levels(self) -> Vec<Tensor<4>> {
        self.maps
    }

    /// Concatenates the features of batches of frames of one size. Panics without a batch.
    pub fn cat(batches: Vec<Self>) -> Self {
        let map = |number: usize| {
            Tensor::cat(batches.iter().map(|features| features.maps[number].clone()).collect(), 0)
        };
        Self {
            frames: batches.iter().map(Self::frames).sum(),
            maps: (0..batches[0].maps.len()).map(map).collect(),
        }
    }

    /// The features of `frames` frames, starting with `first`. Panics when there are fewer.
    pub fn narrow(self, first: usize, frames: usize) -> Self {
        assert!(first + frames <= self.frames, "{frames} frames from {first} on, of {}", self.frames);
        Self { frames, maps: self.maps.into_iter().map(|map| map.narrow(0, first, frames)).collect() }
    }

    /// Number of frames.
    pub fn frames(&self) -> usize {
        self.frames
    }
}
