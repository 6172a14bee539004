//! Shared parts of the kernels for CubeCL devices: contiguous tensors, numbers of threads, and atomic addition. The kernels
//! support `f32` only.

use burn::backend::TensorMetadata;
use burn::tensor::{DType, Shape};
use burn_cubecl::cubecl::client::Client;
use burn_cubecl::cubecl::features::AtomicUsage;
use burn_cubecl::cubecl::ir::{FloatKind, Type};
use burn_cubecl::cubecl::{self, calculate_cube_count_elemwise, prelude::*};
use burn_cubecl::kernel::into_contiguous;
use burn_cubecl::ops::numeric::{empty_device_contiguous_dtype, zeros_client};
use burn_cubecl::tensor::CubeTensor;

/// The contiguous tensor, copied only if necessary. Panics when it is not `f32`.
pub(crate) fn contiguous(tensor: CubeTensor) -> CubeTensor {
    assert_eq!(tensor.dtype(), DType::F32, "the kernels compute in f32");
    into_contiguous(tensor)
}

/// Uninitialised memory for a result, on the device of `beside`.
pub(crate) fn empty(beside: &CubeTensor, shape: impl Into<Shape>) -> CubeTensor {
    empty_device_contiguous_dtype(beside.client.clone(), beside.device.clone(), shape.into(), DType::F32)
}

/// Zeros, on the device of `beside`.
pub(crate) fn zeros(beside: &CubeTensor, shape: impl Into<Shape>) -> CubeTensor {
    let shape = shape.into();
    // Rows of tensors with several dimensions may be padded; one dimension is not.
    let flat = Shape::new([shape.num_elements()]);
    let flat = zeros_client(beside.client.clone(), beside.device.clone(), flat, DType::F32);
    CubeTensor::new_contiguous(flat.client, flat.device, shape, flat.handle, flat.dtype)
}

/// Number of cubes and their size for one thread per element.
pub(crate) fn threads(client: &Client, elements: usize) -> (CubeCount, CubeDim) {
    let dim = CubeDim::new(client, elements);
    (calculate_cube_count_elemwise(client, elements, dim), dim)
}

/// At least `cubes` cubes of `units` threads each; kernels must check for excess cubes.
pub(crate) fn cubes(client: &Client, cubes: usize, units: usize) -> (CubeCount, CubeDim) {
    let dim = CubeDim::new_1d(units as u32);
    (calculate_cube_count_elemwise(client, cubes * units, dim), dim)
}

/// Whether the device has an atomic addition of floats.
pub(crate) fn adds_in_one_step(client: &Client) -> bool {
    client.properties().atomic_type_usage(Type::atomic(FloatKind::F32)).contains(AtomicUsage::Add)
}

/// Addition to a number that other threads add to. The order of additions varies between runs.
#[cube]
pub(crate) trait AtomicAdd: Send + Sync + 'static {
    /// The representation of the number.
    type Cell: Numeric;

    fn add(cell: &mut Atomic<Self::Cell>, value: f32);
}

/// Atomic addition; see [`adds_in_one_step`].
pub(crate) struct InOneStep;

/// Compare and exchange of the bits, repeated while other threads interfere.
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
