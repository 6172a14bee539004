//! The resizing on tensors: [`resize`] with its gradient.

use burn::tensor::Tensor;

use super::Grids;
use crate::MapShape;
use crate::flex::CpuTensor;
use crate::operation::{Backprop, Operation, apply};

#[derive(Debug, Clone)]
pub(super) struct Resize {
    pub(super) shape: MapShape,
    /// Height and width.
    pub(super) size: [usize; 2],
    pub(super) grids: Grids,
}

impl Operation<1> for Resize {
    fn saved_inputs<T>(_inputs: &[T; 1]) -> &[T] {
        &[]
    }

    fn cpu(&self, [input]: [CpuTensor; 1]) -> Vec<CpuTensor> {
        let MapShape { batch, channels, .. } = self.shape;
        let [height, width] = self.size;
        let values = super::resize(input.slice(), self.shape, self.size, self.grids);
        vec![CpuTensor::new(values, [batch, channels, height, width])]
    }

    fn cpu_backward(&self, back: Backprop<CpuTensor>) -> [Option<CpuTensor>; 1] {
        let ([], grad) = back.into_parts();
        let values = super::resize_backward(grad.slice(), self.shape, self.size, self.grids);
        [Some(CpuTensor::new(values, self.shape.dims()))]
    }
}

/// `x`, `[batch, channels, height, width]`, at height and width `size`. Panics when only one of the sizes is empty.
pub fn resize(x: Tensor<4>, size: [usize; 2], grids: Grids) -> Tensor<4> {
    let shape = MapShape::from(x.dims());
    if [shape.height, shape.width] == size {
        return x;
    }
    assert_eq!(shape.pixels() == 0, size.contains(&0), "resize: {shape:?} to {size:?}");
    apply(Resize { shape, size, grids }, [x.into_dispatch()])
}
