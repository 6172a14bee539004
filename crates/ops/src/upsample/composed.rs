//! The upsampling composed of a backend's own operations. One neighbour after another, so that nothing larger than the mask is made.

use std::ops::Range;

use burn::backend::tensor::FloatTensor;
use burn::backend::{Backend, TensorMetadata};
use burn::tensor::{Shape, Slice};

use super::tensor::ConvexUpsample;
use super::{NEIGHBOURS, UpsampleShape};
use crate::operation::{Backprop, Composition};

impl Composition<2> for ConvexUpsample {
    fn composed<B: Backend>(&self, [flow, mask]: [FloatTensor<B>; 2]) -> Vec<FloatTensor<B>> {
        let shape = self.shape(flow.shape());
        let UpsampleShape { batch, coarse: [height, width], factor } = shape;
        let weights = weights::<B>(mask, self.scale, &shape);
        let bordered = bordered::<B>(flow, &shape);
        let term = |k| {
            let neighbours = B::float_slice(bordered.clone(), &shifted(&shape, k));
            B::float_mul(weight::<B>(&weights, &shape, k), neighbours)
        };
        let sum = (1..NEIGHBOURS).fold(term(0), |sum, k| B::float_add(sum, term(k)));
        // [batch, 2, i, j, height, width] to [batch, 2, height, i, width, j].
        let sum = B::float_reshape(sum, [batch, 2, factor, factor, height, width].into());
        let sum = B::float_permute(sum, &[0, 1, 4, 2, 5, 3]);
        let fine = B::float_reshape(sum, [batch, 2, height * factor, width * factor].into());
        vec![B::float_mul_scalar(fine, (factor as f32).into())]
    }

    fn composed_backward<B: Backend>(&self, back: Backprop<FloatTensor<B>>) -> [Option<FloatTensor<B>>; 2] {
        let ([flow, mask], grad) = back.into_parts();
        let shape = self.shape(flow.shape());
        let UpsampleShape { batch, coarse: [height, width], factor } = shape;
        let (flow_shape, mask_shape) = (flow.shape(), mask.shape());
        let weights = weights::<B>(mask, self.scale, &shape);
        let grad = B::float_reshape(grad, [batch, 2, height, factor, width, factor].into());
        let grad = B::float_permute(grad, &[0, 1, 3, 5, 2, 4]);
        let grad = B::float_reshape(grad, [batch, 2, factor * factor, height, width].into());
        let grad = B::float_mul_scalar(grad, (factor as f32).into());
        let bordered = bordered::<B>(flow, &shape);
        let mut d_bordered = B::float_zeros(bordered.shape(), &bordered.device(), bordered.dtype().into());
        let mut along = Vec::with_capacity(NEIGHBOURS);
        for k in 0..NEIGHBOURS {
            let place = shifted(&shape, k);
            let neighbour = B::float_slice(bordered.clone(), &place);
            along.push(B::float_sum_dim(B::float_mul(grad.clone(), neighbour), 1));
            let given = B::float_sum_dim(B::float_mul(grad.clone(), weight::<B>(&weights, &shape, k)), 2);
            let given = B::float_add(B::float_slice(d_bordered.clone(), &place), given);
            d_bordered = B::float_slice_assign(d_bordered, &place, given);
        }
        let along = B::float_cat(along, 1);
        let mean = B::float_sum_dim(B::float_mul(weights.clone(), along.clone()), 1);
        let d_mask = B::float_mul(weights, B::float_sub(along, mean));
        let d_mask = B::float_mul_scalar(B::float_reshape(d_mask, mask_shape), self.scale.into());
        let inside = B::float_slice(d_bordered, &shifted(&shape, NEIGHBOURS / 2));
        [B::float_reshape(inside, flow_shape), d_mask].map(Some)
    }
}

/// `softmax(scale * mask)` over the neighbours: `[batch, 9, factor^2, height, width]`.
fn weights<B: Backend>(mask: FloatTensor<B>, scale: f32, shape: &UpsampleShape) -> FloatTensor<B> {
    let UpsampleShape { batch, coarse: [height, width], factor } = *shape;
    let mask = B::float_reshape(mask, [batch, NEIGHBOURS, factor * factor, height, width].into());
    B::softmax(B::float_mul_scalar(mask, scale.into()), 1)
}

/// The weights of neighbour `k`: `[batch, 1, factor^2, height, width]`.
fn weight<B: Backend>(weights: &FloatTensor<B>, shape: &UpsampleShape, k: usize) -> FloatTensor<B> {
    let UpsampleShape { batch, coarse: [height, width], factor } = *shape;
    B::float_slice(weights.clone(), &slices([0..batch, k..k + 1, 0..factor * factor, 0..height, 0..width]))
}

/// The zero-padded flow: `[batch, 2, 1, height + 2, width + 2]`.
fn bordered<B: Backend>(flow: FloatTensor<B>, shape: &UpsampleShape) -> FloatTensor<B> {
    let UpsampleShape { batch, coarse: [height, width], .. } = *shape;
    let zeros =
        B::float_zeros(Shape::new([batch, 2, 1, height + 2, width + 2]), &flow.device(), flow.dtype().into());
    let flow = B::float_reshape(flow, [batch, 2, 1, height, width].into());
    B::float_slice_assign(zeros, &shifted(shape, NEIGHBOURS / 2), flow)
}

/// Position of the `k`-th neighbours of all pixels in the padded flow.
fn shifted(shape: &UpsampleShape, k: usize) -> [Slice; 5] {
    let UpsampleShape { batch, coarse: [height, width], .. } = *shape;
    slices([0..batch, 0..2, 0..1, k / 3..k / 3 + height, k % 3..k % 3 + width])
}

fn slices(ranges: [Range<usize>; 5]) -> [Slice; 5] {
    ranges.map(Slice::from)
}
