//! Tensors of the CPU backend as slices.

use std::sync::OnceLock;

use burn::backend::flex::FlexTensor;
use burn::backend::{Flex, TensorMetadata};
use burn::tensor::{Shape, Tensor, TensorData};

use crate::MapShape;

/// A tensor of `f32` on the CPU, as a slice for kernels.
#[derive(Debug, Clone)]
pub(crate) struct CpuTensor {
    tensor: FlexTensor,
    /// The contiguous version; copied on first access, and only if necessary.
    in_order: OnceLock<FlexTensor>,
}

impl CpuTensor {
    pub(crate) fn new(values: Vec<f32>, shape: impl Into<Shape>) -> Self {
        FlexTensor::from_data(TensorData::new(values, shape)).into()
    }

    /// A new tensor in this one's shape.
    pub(crate) fn like(&self, values: Vec<f32>) -> Self {
        Self::new(values, self.tensor.shape())
    }

    /// `None` for a tensor on another device or in a graph.
    pub(crate) fn of<const D: usize>(tensor: &Tensor<D>) -> Option<Self> {
        tensor.clone().try_into_primitive::<Flex>().ok().map(Self::from)
    }

    pub(crate) fn into_tensor<const D: usize>(self) -> Tensor<D> {
        Tensor::from_primitive::<Flex>(self.tensor)
    }

    pub(crate) fn tensor(&self) -> &FlexTensor {
        &self.tensor
    }

    /// Panics when the tensor is not `f32`, the only type that the kernels support.
    pub(crate) fn slice(&self) -> &[f32] {
        let tensor = self.in_order.get_or_init(|| self.tensor.to_contiguous());
        let start = tensor.layout().start_offset();
        &tensor.storage::<f32>()[start..start + tensor.layout().num_elements()]
    }

    /// Modifies its elements, in place if nothing else shares them.
    pub(crate) fn change(self, change: impl FnOnce(&mut [f32])) -> Self {
        let mut tensor = self.tensor.to_contiguous();
        drop(self);
        let (start, count) = (tensor.layout().start_offset(), tensor.layout().num_elements());
        change(&mut tensor.storage_mut::<f32>()[start..start + count]);
        tensor.into()
    }

    pub(crate) fn shape(&self) -> Shape {
        self.tensor.shape()
    }

    /// Sizes of a tensor that is known to hold feature maps.
    pub(crate) fn map_shape(&self) -> MapShape {
        self.dims().into()
    }

    /// Dimensions of a tensor of known rank `D`.
    pub(crate) fn dims<const D: usize>(&self) -> [usize; D] {
        self.tensor.shape().dims()
    }
}

impl From<FlexTensor> for CpuTensor {
    fn from(tensor: FlexTensor) -> Self {
        Self { tensor, in_order: OnceLock::new() }
    }
}

impl From<CpuTensor> for FlexTensor {
    fn from(tensor: CpuTensor) -> Self {
        tensor.tensor
    }
}
