//! The same by a backend's own operations.

use burn::backend::Backend;
use burn::backend::tensor::FloatTensor;
use burn::tensor::Shape;

use super::in_blocks;
use super::tensor::SpaceToDepth;
use crate::MapShape;
use crate::operation::{Backprop, Composition};

impl Composition<1> for SpaceToDepth {
    fn composed<B: Backend>(&self, [input]: [FloatTensor<B>; 1]) -> Vec<FloatTensor<B>> {
        let side = self.side;
        let blocks = in_blocks(self.shape, side);
        let MapShape { batch, channels, .. } = self.shape;
        let apart = Shape::from([batch, channels, blocks.height, side, blocks.width, side]);
        let sorted = B::float_permute(B::float_reshape(input, apart), &[0, 1, 3, 5, 2, 4]);
        vec![B::float_reshape(sorted, Shape::from(blocks.dims()))]
    }

    fn composed_backward<B: Backend>(&self, back: Backprop<FloatTensor<B>>) -> [Option<FloatTensor<B>>; 1] {
        let ([], grad) = back.into_parts();
        let side = self.side;
        let blocks = in_blocks(self.shape, side);
        let MapShape { batch, channels, .. } = self.shape;
        let apart = Shape::from([batch, channels, side, side, blocks.height, blocks.width]);
        let sorted = B::float_permute(B::float_reshape(grad, apart), &[0, 1, 4, 2, 5, 3]);
        [Some(B::float_reshape(sorted, Shape::from(self.shape.dims())))]
    }
}
