//! The lookup on tensors: [`Correlation`], with gradients of both feature maps.

use burn::backend::autodiff::checkpoint::{base::Checkpointer, strategy::CheckpointStrategy};
use burn::backend::autodiff::grads::Gradients;
use burn::backend::autodiff::ops::{Backward, Ops, OpsKind};
use burn::backend::tensor::FloatTensor;
use burn::backend::{Autodiff, Backend, Dispatch, Flex, TensorMetadata, backend_extension};
use burn::tensor::Tensor;
use burn::tensor::module::avg_pool2d;
use burn::tensor::ops::AvgPoolOptions;

use super::pyramid::level_sizes;
use super::{FeaturePyramid, correlation_lookup, correlation_lookup_backward};
use crate::flex::{Contiguous, sizes, tensor};
use crate::gradients;

/// The lookup. `first` is `[batch, height, width, channels]`; `second` its pyramid, packed as [`Correlation`] does;
/// `coords` `[batch, 2, height, width]`.
#[backend_extension(Flex, Cube: cfg(feature = "cube"), Autodiff)]
pub trait CorrelationOps: Backend {
    /// `[batch, levels * (2 radius + 1)^2, height, width]`.
    fn correlation_windows(
        first: FloatTensor<Self>,
        second: FloatTensor<Self>,
        coords: FloatTensor<Self>,
        levels: usize,
        radius: usize,
    ) -> FloatTensor<Self>;
}

/// Gradients of the lookup.
pub trait CorrelationGradOps: Backend {
    /// Gradients of `first` and `second`.
    fn correlation_windows_grad(
        first: FloatTensor<Self>,
        second: FloatTensor<Self>,
        coords: FloatTensor<Self>,
        grad: FloatTensor<Self>,
        levels: usize,
        radius: usize,
    ) -> (FloatTensor<Self>, FloatTensor<Self>);
}

impl CorrelationOps for Flex {
    fn correlation_windows(
        first: FloatTensor<Self>,
        second: FloatTensor<Self>,
        coords: FloatTensor<Self>,
        levels: usize,
        radius: usize,
    ) -> FloatTensor<Self> {
        let shape @ [batch, height, width, _] = sizes(&first);
        let (first, second, coords) =
            (Contiguous::new(&first), Contiguous::new(&second), Contiguous::new(&coords));
        let pyramid = FeaturePyramid::of_packed(second.slice(), shape, levels);
        let out = correlation_lookup(first.slice(), &pyramid, coords.slice(), [height, width], radius);
        tensor(out, [batch, levels * (2 * radius + 1) * (2 * radius + 1), height, width])
    }
}

impl CorrelationGradOps for Flex {
    fn correlation_windows_grad(
        first: FloatTensor<Self>,
        second: FloatTensor<Self>,
        coords: FloatTensor<Self>,
        grad: FloatTensor<Self>,
        levels: usize,
        radius: usize,
    ) -> (FloatTensor<Self>, FloatTensor<Self>) {
        let shape @ [_, height, width, _] = sizes(&first);
        let packed_shape = second.shape();
        let (first, second, coords, grad) = (
            Contiguous::new(&first),
            Contiguous::new(&second),
            Contiguous::new(&coords),
            Contiguous::new(&grad),
        );
        let pyramid = FeaturePyramid::of_packed(second.slice(), shape, levels);
        let (d_first, d_levels) = correlation_lookup_backward(
            first.slice(),
            &pyramid,
            coords.slice(),
            [height, width],
            radius,
            grad.slice(),
        );
        (tensor(d_first, shape), tensor(d_levels.concat(), packed_shape))
    }
}

/// The positions get no gradient: the networks detach them.
#[derive(Debug)]
struct WindowsBackward;

impl<B: CorrelationGradOps> Backward<B, 2> for WindowsBackward {
    type State = ([FloatTensor<B>; 3], usize, usize);

    fn backward(self, ops: Ops<Self::State, 2>, grads: &mut Gradients, _: &mut Checkpointer) {
        gradients::register::<B, _, 2>(ops, grads, |([first, second, coords], levels, radius), grad| {
            B::correlation_windows_grad(first, second, coords, grad, levels, radius).into()
        });
    }
}

impl<B: CorrelationOps + CorrelationGradOps, C: CheckpointStrategy> CorrelationOps for Autodiff<B, C> {
    fn correlation_windows(
        first: FloatTensor<Self>,
        second: FloatTensor<Self>,
        coords: FloatTensor<Self>,
        levels: usize,
        radius: usize,
    ) -> FloatTensor<Self> {
        let guards = [first.node(), second.node()];
        let inputs = [first.into_primitive(), second.into_primitive(), coords.into_primitive()];
        let [first, second, coords] = inputs.clone();
        let out = B::correlation_windows(first, second, coords, levels, radius);
        match WindowsBackward.prepare::<C>(guards).compute_bound().stateful() {
            OpsKind::Tracked(prep) => prep.finish((inputs, levels, radius), out),
            OpsKind::UnTracked(prep) => prep.finish(out),
        }
    }
}

/// Two feature maps, ready to be looked up many times.
#[derive(Debug, Clone)]
pub struct Correlation {
    /// `[batch, height, width, channels]`.
    first: Tensor<4>,
    /// The levels of the second map's pyramid one after another, each `[batch, height, width, channels]`.
    second: Tensor<1>,
    levels: usize,
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
        Self { first, second: Tensor::cat(pyramid, 0), levels }
    }

    /// Windows of `radius` around `coords` (`[batch, 2, height, width]`: x, then y, in pixels of the feature map):
    /// `[batch, levels * (2 radius + 1)^2, height, width]`; see [`super::reference::correlation_lookup`]. Panics when
    /// the sizes do not fit.
    pub fn windows(&self, coords: Tensor<4>, radius: usize) -> Tensor<4> {
        let [batch, height, width, _] = self.first.dims();
        assert_eq!(coords.dims(), [batch, 2, height, width], "correlation: a position for each pixel");
        Tensor::from_dispatch(Dispatch::correlation_windows(
            self.first.clone().into_dispatch(),
            self.second.clone().into_dispatch(),
            coords.into_dispatch(),
            self.levels,
            radius,
        ))
    }
}
