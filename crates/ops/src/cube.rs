//! What the kernels for CubeCL devices share: tensors whose elements lie in order, how many threads, and adding to numbers
//! that other threads add to. The kernels know `f32` alone.

use burn::backend::TensorMetadata;
use burn::tensor::{DType, Shape};
use burn_cubecl::cubecl::client::Client;
use burn_cubecl::cubecl::features::AtomicUsage;
use burn_cubecl::cubecl::ir::{FloatKind, Type};
use burn_cubecl::cubecl::{self, calculate_cube_count_elemwise, prelude::*};
use burn_cubecl::kernel::into_contiguous;
use burn_cubecl::ops::numeric::{empty_device_contiguous_dtype, zeros_client};
use burn_cubecl::tensor::CubeTensor;

/// The tensor with its elements in order, copied only where they were not. Panics when it does not hold `f32`.
pub(crate) fn contiguous(tensor: CubeTensor) -> CubeTensor {
    assert_eq!(tensor.dtype(), DType::F32, "the kernels compute in f32");
    into_contiguous(tensor)
}

/// Memory for a result, on the device of `beside`.
pub(crate) fn empty(beside: &CubeTensor, shape: impl Into<Shape>) -> CubeTensor {
    empty_device_contiguous_dtype(beside.client.clone(), beside.device.clone(), shape.into(), DType::F32)
}

/// Zeros, on the device of `beside`.
pub(crate) fn zeros(beside: &CubeTensor, shape: impl Into<Shape>) -> CubeTensor {
    let shape = shape.into();
    // Rows of more dimensions may be padded; those of one are not.
    let flat = Shape::new([shape.num_elements()]);
    let flat = zeros_client(beside.client.clone(), beside.device.clone(), flat, DType::F32);
    CubeTensor::new_contiguous(flat.client, flat.device, shape, flat.handle, flat.dtype)
}

/// Cubes and their size for one thread for each of `elements`.
pub(crate) fn threads(client: &Client, elements: usize) -> (CubeCount, CubeDim) {
    let dim = CubeDim::new(client, elements);
    (calculate_cube_count_elemwise(client, elements, dim), dim)
}

/// At least `cubes` cubes of `units` threads each; the last ones have to see that there is nothing for them.
pub(crate) fn cubes(client: &Client, cubes: usize, units: usize) -> (CubeCount, CubeDim) {
    let dim = CubeDim::new_1d(units as u32);
    (calculate_cube_count_elemwise(client, cubes * units, dim), dim)
}

/// Whether the device can add to a number in memory in one step.
pub(crate) fn adds_in_one_step(client: &Client) -> bool {
    client.properties().atomic_type_usage(Type::atomic(FloatKind::F32)).contains(AtomicUsage::Add)
}

/// How to add to a number that other threads add to. The order of the additions is not the same in every run.
#[cube]
pub(crate) trait AtomicAdd: Send + Sync + 'static {
    /// What stands for the number.
    type Cell: Numeric;

    fn add(cell: &mut Atomic<Self::Cell>, value: f32);
}

/// In one step; see [`adds_in_one_step`].
pub(crate) struct InOneStep;

/// By exchanging the bits as long as another thread was faster.
pub(crate) struct ByExchange;

#[cube]
impl AtomicAdd for InOneStep {
    type Cell = f32;

    fn add(cell: &mut Atomic<f32>, value: f32) {
        cell.fetch_add(value);
    }
}

#[cube]
impl AtomicAdd for ByExchange {
    type Cell = u32;

    fn add(cell: &mut Atomic<u32>, value: f32) {
        if value != 0.0 {
            let mut seen = cell.load();
            loop {
                let sum = (f32::from_bits(seen) + value).to_bits();
                let found = cell.compare_exchange_weak(seen, sum);
                if found == seen {
                    break;
                }
                seen = found;
            }
        }
    }
}
