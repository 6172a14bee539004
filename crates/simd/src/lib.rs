//! Vector instructions behind one interface, matrix products on slices, writing one buffer from several threads, and the names of
//! the devices that other crates compute on.
//!
//! A kernel is written once over [`Simd`] (or as plain loops, which the compiler vectorises) and compiled for every
//! instruction set by [`dispatch!`] or [`multiversioned!`]. An [`Isa`] holds a token that only detection can create, so code
//! compiled for an instruction set runs only where the processor has it.
//!
//! Every lane operation is the IEEE one, multiply-adds are fused on every instruction set, and nothing is reordered: an
//! element of a result depends on the order of its own operations, never on the vector width. The exception is
//! [`Simd::sum`], which adds lanes.

#![expect(
    clippy::needless_range_loop,
    reason = "kernels walk several arrays in step by one index, as their equations do"
)]

mod activation;
#[cfg(target_arch = "x86_64")]
mod amx;
#[cfg(target_arch = "x86_64")]
mod avx2;
#[cfg(target_arch = "x86_64")]
mod avx512;
mod bf16;
mod device;
mod functions;
mod isa;
mod packed;
mod portable;
mod product;
mod scratch;
mod shared_mut;
mod vector;

pub use activation::{Activation, Keeps, activate, activated, activation_backward};
#[cfg(target_arch = "x86_64")]
pub use avx2::Avx2;
#[cfg(target_arch = "x86_64")]
pub use avx512::Avx512;
#[cfg(target_arch = "x86_64")]
pub use bf16::Avx512Bf16;
pub use bf16::{Multiply, Numbers, Pair, PairsInSteps, Precision, pair_neighbours, pair_rows, pair_up};
pub use device::{DeviceError, DeviceName, device_kinds};
pub use functions::{exp, exp2, ln_1p};
pub use isa::Isa;
pub use packed::{Left, Packed};
pub use portable::Portable;
pub use product::{
    Output, Product, Right, Start, Steps, multiply, multiply_diagonal, multiply_to_pairs, panel_columns,
};
pub use scratch::{Element, Scratch};
pub use shared_mut::{SharedMut, copy_pieces, fill_columns, fill_pieces, zeros};
pub use vector::{MAX_LANES, Simd};
