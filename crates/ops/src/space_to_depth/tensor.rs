//! On tensors: [`space_to_depth`] with its gradient.

use burn::tensor::Tensor;

use super::in_blocks;
use crate::MapShape;
use crate::flex::CpuTensor;
use crate::operation::{Backprop, Operation, apply};

#[derive(Debug, Clone)]
pub(super) struct SpaceToDepth {
    pub(super) shape: MapShape,
    pub(super) side: usize,
}

impl Operation<1> for SpaceToDepth {
    fn saved_inputs<T>(_inputs: &[T; 1]) -> &[T] {
        &[]
    }

    fn cpu(&self, [input]: [CpuTensor; 1]) -> Vec<CpuTensor> {
        let blocks = super::space_to_depth(input.slice(), self.shape, self.side);
        vec![CpuTensor::new(blocks, in_blocks(self.shape, self.side).dims())]
    }

    fn cpu_backward(&self, back: Backprop<CpuTensor>) -> [Option<CpuTensor>; 1] {
        let ([], grad) = back.into_parts();
        let whole = super::depth_to_space(grad.slice(), self.shape, self.side);
        [Some(CpuTensor::new(whole, self.shape.dims()))]
    }
}

/// `x`, `[batch, channels, height, width]`, with the pixels of each block of `side` x `side`, row by row, as channels:
/// `[batch, channels * side^2, height / side, width / side]`. Panics when the blocks do not fill the maps.
pub fn space_to_depth(x: Tensor<4>, side: usize) -> Tensor<4> {
    let shape = MapShape::from(x.dims());
    apply(SpaceToDepth { shape, side }, [x.into_dispatch()])
}
