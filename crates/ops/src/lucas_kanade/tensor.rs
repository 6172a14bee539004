//! On tensors: [`lucas_kanade`], without gradients.

use burn::tensor::Tensor;

use super::{LucasKanade, in_cells};
use crate::flex::CpuTensor;
use crate::operation::{Backprop, Operation, apply};

impl Operation<2> for LucasKanade {
    fn saved_inputs<T>(_inputs: &[T; 2]) -> &[T] {
        &[]
    }

    fn cpu(&self, [first, second]: [CpuTensor; 2]) -> Vec<CpuTensor> {
        let shape = first.map_shape();
        let found = self.forward(first.slice(), second.slice(), shape);
        vec![CpuTensor::new(found, in_cells(shape).dims())]
    }

    fn cpu_backward(&self, _back: Backprop<CpuTensor>) -> [Option<CpuTensor>; 2] {
        [None, None]
    }
}

/// See [`LucasKanade::forward`]; both frames `[batch, channels, height, width]`. No gradients pass. Panics when the sizes do not fit.
pub fn lucas_kanade(of: LucasKanade, first: Tensor<4>, second: Tensor<4>) -> Tensor<4> {
    assert_eq!(first.dims(), second.dims(), "lucas_kanade: frames of one size");
    apply(of, [first.detach().into_dispatch(), second.detach().into_dispatch()])
}
