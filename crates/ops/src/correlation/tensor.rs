//! The lookup on tensors: [`Correlation`], with gradients of both feature maps.

use std::ops::Range;

use burn::tensor::Tensor;
use burn::tensor::module::avg_pool2d;
use burn::tensor::ops::AvgPoolOptions;
#[cfg(feature = "cube")]
use burn_cubecl::tensor::CubeTensor;

use srflow_simd::Isa;

use super::lookup::{Paired, lookup_with};
use super::pyramid::level_sizes;
use super::{FeaturePyramid, correlation_lookup_backward};
use crate::flex::CpuTensor;
use crate::operation::{Backprop, Composition, Operation, apply};
use crate::precision::cpu_precision;

/// Of the first map or some rows of it, `[batch, height, width, channels]`, the second's pyramid, packed as [`Correlation`] does,
/// and positions, `[batch, 2, height, width]`, which have no gradient.
#[derive(Debug, Clone)]
pub(super) struct Lookup {
    /// Height and width of the second map.
    pub(super) second: [usize; 2],
    pub(super) levels: usize,
    pub(super) radius: usize,
    /// Of these maps, on the CPU.
    paired: Paired,
}

impl Lookup {
    fn pyramid<'a>(&self, packed: &'a [f32], [batch, _, _, channels]: [usize; 4]) -> FeaturePyramid<'a> {
        let [height, width] = self.second;
        FeaturePyramid::of_packed(packed, [batch, height, width, channels], self.levels)
    }
}

impl Composition<3> for Lookup {}

impl Operation<3> for Lookup {
    fn cpu(&self, [first, second, coords]: [CpuTensor; 3]) -> Vec<CpuTensor> {
        let Self { levels, radius, ref paired, .. } = *self;
        let shape @ [batch, height, width, _] = first.dims();
        let pyramid = self.pyramid(second.slice(), shape);
        let out = lookup_with(
            Isa::best(),
            cpu_precision(),
            first.slice(),
            &pyramid,
            paired,
            coords.slice(),
            [height, width],
            radius,
        );
        vec![CpuTensor::new(out, [batch, levels * (2 * radius + 1) * (2 * radius + 1), height, width])]
    }

    fn cpu_backward(&self, back: Backprop<CpuTensor>) -> [Option<CpuTensor>; 3] {
        let ([first, second, coords], grad) = back.into_parts();
        let shape @ [_, height, width, _] = first.dims();
        let pyramid = self.pyramid(second.slice(), shape);
        let (d_first, d_levels) = correlation_lookup_backward(
            first.slice(),
            &pyramid,
            coords.slice(),
            [height, width],
            self.radius,
            grad.slice(),
        );
        [Some(first.like(d_first)), Some(second.like(d_levels.concat())), None]
    }

    #[cfg(feature = "cube")]
    fn cube(&self, inputs: [CubeTensor; 3]) -> Vec<CubeTensor> {
        vec![super::cube::lookup(self, inputs)]
    }

    #[cfg(feature = "cube")]
    fn cube_backward(&self, back: Backprop<CubeTensor>) -> [Option<CubeTensor>; 3] {
        let (inputs, grad) = back.into_parts();
        let [d_first, d_second] = super::cube::lookup_backward(self, inputs, grad);
        [Some(d_first), Some(d_second), None]
    }
}

/// Two feature maps, ready to be looked up many times.
#[derive(Debug, Clone)]
pub struct Correlation {
    /// `[batch, rows, width, channels]`.
    first: Tensor<4>,
    /// Height and width of the second map.
    size: [usize; 2],
    /// The levels of the second map's pyramid one after another, each `[batch, height, width, channels]`.
    second: Tensor<1>,
    levels: usize,
    paired: Paired,
}

impl Correlation {
    /// From feature maps of both images, each `[batch, channels, height, width]`. Panics when their sizes differ.
    pub fn new(first: Tensor<4>, second: Tensor<4>, levels: usize) -> Self {
        assert_eq!(first.dims(), second.dims(), "correlation: feature maps of one size");
        // Flattening puts the elements in order, once and not at every lookup.
        let channels_last = |map: Tensor<4>| map.permute([0, 2, 3, 1]).flatten::<1>(0, 3);
        let [batch, channels, height, width] = second.dims();
        let mut pyramid = Vec::with_capacity(levels);
        let mut level = second;
        for size in level_sizes([height, width], levels) {
            if size.contains(&0) {
                break;
            }
            if !pyramid.is_empty() {
                level = avg_pool2d(level, AvgPoolOptions::new([2, 2]));
            }
            pyramid.push(channels_last(level.clone()));
        }
        let first = channels_last(first).reshape([batch, height, width, channels]);
        Self {
            first,
            size: [height, width],
            second: Tensor::cat(pyramid, 0),
            levels,
            paired: Paired::default(),
        }
    }

    /// Of these rows of the first map.
    pub fn of_rows(&self, rows: Range<usize>) -> Self {
        let first = self.first.clone().narrow(1, rows.start, rows.len());
        Self { first, paired: self.paired.of_second(), ..self.clone() }
    }

    /// Windows of `radius` around `coords` (`[batch, 2, height, width]`: x, then y, in pixels of the feature map):
    /// `[batch, levels * (2 radius + 1)^2, height, width]`; see [`super::reference::correlation_lookup`]. Panics when
    /// the sizes do not fit.
    pub fn windows(&self, coords: Tensor<4>, radius: usize) -> Tensor<4> {
        let [batch, height, width, _] = self.first.dims();
        assert_eq!(coords.dims(), [batch, 2, height, width], "correlation: a position for each pixel");
        // The networks detach the positions as well.
        let inputs = [
            self.first.clone().into_dispatch(),
            self.second.clone().into_dispatch(),
            coords.detach().into_dispatch(),
        ];
        let paired = self.paired.clone();
        apply(Lookup { second: self.size, levels: self.levels, radius, paired }, inputs)
    }
}
