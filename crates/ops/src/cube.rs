//! Shared parts of the kernels for CubeCL devices: contiguous tensors, numbers of threads, products at the precision of the thread, and
//! atomic addition. Tensors are `f32`.

use burn::backend::TensorMetadata;
use burn::backend::ops::FloatTensorOps as _;
use burn::tensor::{DType, Shape};
use burn_cubecl::cubecl::client::Client;
use burn_cubecl::cubecl::features::AtomicUsage;
use burn_cubecl::cubecl::ir::{FloatKind, Type};
use burn_cubecl::cubecl::{self, calculate_cube_count_elemwise, prelude::*};
use burn_cubecl::kernel::matmul::{MatmulStrategy, matmul};
use burn_cubecl::kernel::{cast, into_contiguous};
use burn_cubecl::ops::numeric::{empty_device_contiguous_dtype, zeros_client};
use burn_cubecl::{CubeBackend, tensor::CubeTensor};

use crate::precision::{Precision, precision};

/// The contiguous tensor, copied only if necessary. Panics when it is not `f32`.
pub(crate) fn contiguous(tensor: CubeTensor) -> CubeTensor {
    assert_eq!(tensor.dtype(), DType::F32, "the kernels compute in f32");
    into_contiguous(tensor)
}

/// Uninitialised memory for a result, on the device of `beside`.
pub(crate) fn empty(beside: &CubeTensor, shape: impl Into<Shape>) -> CubeTensor {
    empty_of(beside, shape, DType::F32)
}

/// The same of another type than `f32`.
pub(crate) fn empty_of(beside: &CubeTensor, shape: impl Into<Shape>, dtype: DType) -> CubeTensor {
    empty_device_contiguous_dtype(beside.client.clone(), beside.device.clone(), shape.into(), dtype)
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

/// The matrix product of `lhs`, `[batch, rows, depth]`, and `rhs`, `[batch, depth, columns]`, either of which may have one matrix for all,
/// at the precision of this thread: rounded to it, multiplied, and summed in `f32`.
pub(crate) fn product(lhs: CubeTensor, rhs: CubeTensor) -> CubeTensor {
    let [lhs, rhs] = [lhs, rhs].map(|operand| cast(operand, precision().dtype()));
    matmul(lhs.clone(), rhs.clone(), None, MatmulStrategy::default(), DType::F32).unwrap_or_else(|_| {
        // Without a kernel for these types: the same products, as numbers of more digits.
        let [lhs, rhs] = [lhs, rhs].map(|operand| cast(operand, DType::F32));
        CubeBackend::float_matmul(lhs, rhs)
    })
}

/// What `of` makes of a gradient, of which it must be a linear function. At `f16`, which has no numbers under 6e-8, `of` gets the
/// gradient over its largest magnitude.
pub(crate) fn magnified(grad: CubeTensor, of: impl FnOnce(CubeTensor) -> CubeTensor) -> CubeTensor {
    if precision() != Precision::F16 {
        return of(grad);
    }
    let last = grad.shape().num_dims() - 1;
    // In two steps: of few numbers, one thread could find the largest.
    let largest = CubeBackend::float_max(CubeBackend::float_max_abs_dim(grad.clone(), last));
    let largest = CubeBackend::float_clamp_min(largest, f32::MIN_POSITIVE.into());
    let of_rank = |rank: usize| CubeBackend::float_reshape(largest.clone(), vec![1; rank].into());
    let result = of(CubeBackend::float_div(grad, of_rank(last + 1)));
    let rank = result.shape().num_dims();
    CubeBackend::float_mul(result, of_rank(rank))
}

/// Whether the device has an atomic addition of floats.
pub(crate) fn adds_in_one_step(client: &Client) -> bool {
    client.properties().atomic_type_usage(Type::atomic(FloatKind::F32)).contains(AtomicUsage::Add)
}

/// The sum of the numbers of all `units` threads of the cube, for each of them, added in a fixed order. `sums` is shared memory for one
/// number of each; `units` must be a power of two.
#[cube]
#[allow(clippy::manual_is_multiple_of)] // Kernels have no such method.
pub(crate) fn sum_of_threads(sums: &mut [f32], own: f32, #[comptime] units: usize) -> f32 {
    let unit = UNIT_POS as usize;
    sums[unit] = own;
    sync_cube();
    let mut distance = 1usize;
    while distance < units {
        if unit % (2 * distance) == 0 {
            let other = sums[unit + distance];
            sums[unit] += other;
        }
        sync_cube();
        distance *= 2;
    }
    let sum = sums[0];
    // Before another call writes to it.
    sync_cube();
    sum
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
