//! The warp on tensors: [`warp`] with gradients.

use burn::tensor::{Int, Tensor};
#[cfg(feature = "cube")]
use burn_cubecl::tensor::CubeTensor;

use crate::flex::CpuTensor;
use crate::operation::{Backprop, Composition, Operation, apply};

/// Of image and flow.
#[derive(Debug, Clone)]
pub(super) struct Warp;

impl Composition<2> for Warp {}

impl Operation<2> for Warp {
    fn cpu(&self, [image, flow]: [CpuTensor; 2]) -> Vec<CpuTensor> {
        vec![image.like(super::warp(image.slice(), flow.slice(), &image.map_shape()))]
    }

    fn cpu_backward(&self, back: Backprop<CpuTensor>) -> [Option<CpuTensor>; 2] {
        let ([image, flow], grad) = back.into_parts();
        let [d_image, d_flow] =
            super::warp_backward(image.slice(), flow.slice(), grad.slice(), &image.map_shape());
        [image.like(d_image), flow.like(d_flow)].map(Some)
    }

    #[cfg(feature = "cube")]
    fn cube(&self, inputs: [CubeTensor; 2]) -> Vec<CubeTensor> {
        vec![super::cube::warp(inputs)]
    }

    #[cfg(feature = "cube")]
    fn cube_backward(&self, back: Backprop<CubeTensor>) -> [Option<CubeTensor>; 2] {
        let (inputs, grad) = back.into_parts();
        super::cube::warp_backward(inputs, grad).map(Some)
    }
}

/// `image` (`[batch, channels, height, width]`) sampled at each pixel displaced by `flow` (`[batch, 2, height, width]`, in
/// pixels, u then v). Panics when the sizes do not fit.
pub fn warp(image: Tensor<4>, flow: Tensor<4>) -> Tensor<4> {
    let [batch, _, height, width] = image.dims();
    assert_eq!(flow.dims(), [batch, 2, height, width], "warp: a displacement for each pixel");
    apply(Warp, [image.into_dispatch(), flow.into_dispatch()])
}

/// As [`warp`], but pixels outside of the image have the value of the nearest pixel inside.
pub fn warp_replicated(image: Tensor<4>, flow: Tensor<4>) -> Tensor<4> {
    let [_, _, height, width] = image.dims();
    let device = image.device();
    let places = |size: usize, shape: [usize; 4]| {
        Tensor::<1, Int>::arange(0..size as i64, &device).float().reshape(shape)
    };
    let limited = |component: usize, places: Tensor<4>, size: usize| {
        let least = -places.clone();
        let most = -places + (size - 1) as f64;
        let component = flow.clone().narrow(1, component, 1);
        let shape = component.dims();
        component.max_pair(least.expand(shape)).min_pair(most.expand(shape))
    };
    let u = limited(0, places(width, [1, 1, 1, width]), width);
    let v = limited(1, places(height, [1, 1, height, 1]), height);
    warp(image, Tensor::cat(vec![u, v], 1))
}
