//! Slices of the CPU backend's tensors.

use burn::backend::Flex;
use burn::backend::tensor::FloatTensor;
use burn::backend::{TensorMetadata, flex::FlexTensor};
use burn::tensor::{Shape, TensorData};

/// A tensor whose elements lie in order, copied only where they did not.
pub(crate) struct Contiguous(FlexTensor);

impl Contiguous {
    /// Panics when the tensor does not hold `f32`: the kernels know no other type.
    pub(crate) fn new(tensor: &FloatTensor<Flex>) -> Self {
        Self(tensor.to_contiguous())
    }

    pub(crate) fn slice(&self) -> &[f32] {
        let start = self.0.layout().start_offset();
        &self.0.storage::<f32>()[start..start + self.0.layout().num_elements()]
    }
}

/// The tensor with its elements changed, in place where nobody else has them.
pub(crate) fn with_elements(tensor: FloatTensor<Flex>, change: impl FnOnce(&mut [f32])) -> FloatTensor<Flex> {
    let mut tensor = tensor.to_contiguous();
    let (start, count) = (tensor.layout().start_offset(), tensor.layout().num_elements());
    change(&mut tensor.storage_mut::<f32>()[start..start + count]);
    tensor
}

/// A tensor of `values`.
pub(crate) fn tensor(values: Vec<f32>, shape: impl Into<Shape>) -> FloatTensor<Flex> {
    FlexTensor::from_data(TensorData::new(values, shape))
}

/// Sizes of a tensor that the caller has checked to be of rank `D`.
pub(crate) fn sizes<const D: usize>(tensor: &impl TensorMetadata) -> [usize; D] {
    tensor.shape().dims()
}
