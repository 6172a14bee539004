//! At which precision the operations of a thread multiply.

use std::cell::Cell;

use burn::backend::{Backend as _, DTypeUsage, Dispatch};
use burn::tensor::{DType, Device};
use srflow_simd::Isa;

use crate::scoped;

/// The numbers that products multiply. Sums are `f32` always.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Precision {
    /// 24 significant bits.
    #[default]
    F32,
    /// 11 significant bits, up to 65504. Not on the CPU.
    F16,
    /// 8 significant bits, and the range of `f32`.
    Bf16,
}

impl Precision {
    /// All of them.
    pub const ALL: [Self; 3] = [Self::F32, Self::F16, Self::Bf16];

    /// Name as users write it.
    pub fn name(self) -> &'static str {
        match self {
            Self::F32 => "f32",
            Self::F16 => "f16",
            Self::Bf16 => "bf16",
        }
    }

    /// Burn's name of the numbers.
    pub(crate) fn dtype(self) -> DType {
        match self {
            Self::F32 => DType::F32,
            Self::F16 => DType::F16,
            Self::Bf16 => DType::BF16,
        }
    }

    /// Whether a device multiplies these numbers.
    fn is_of(self, device: &Device) -> bool {
        match self {
            Self::F32 => true,
            Self::Bf16 if *device == Device::flex() => true,
            Self::F16 | Self::Bf16 => *device != Device::flex() && device.supports_dtype(self.dtype()),
        }
    }
}

/// A device does not multiply the wanted numbers.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("this device does not multiply {}: it has {}", .wanted.name(), .has.iter().map(|has| has.name()).collect::<Vec<_>>().join(", "))]
pub struct PrecisionError {
    /// What was wanted.
    pub wanted: Precision,
    /// What the device has.
    pub has: Vec<Precision>,
}

/// The precisions at which a device multiplies.
pub fn precisions(device: &Device) -> Vec<Precision> {
    Precision::ALL.into_iter().filter(|precision| precision.is_of(device)).collect()
}

/// Checks that a device multiplies at a precision.
///
/// # Errors
/// When it does not.
pub fn check_precision(device: &Device, wanted: Precision) -> Result<(), PrecisionError> {
    if wanted.is_of(device) { Ok(()) } else { Err(PrecisionError { wanted, has: precisions(device) }) }
}

/// The fastest precision of a device: of the CPU, bfloat16 where the processor multiplies that by itself; of others, 16 bits where they
/// have units for matrices of them; else `f32`.
pub fn fastest_precision(device: &Device) -> Precision {
    if *device == Device::flex() {
        return if Isa::best().multiplies_bf16() { Precision::Bf16 } else { Precision::F32 };
    }
    let accelerated = |precision: &Precision| {
        let usage = Dispatch::dtype_usage(device.as_dispatch(), precision.dtype());
        precision.is_of(device) && usage.contains(DTypeUsage::Accelerated)
    };
    [Precision::F16, Precision::Bf16].into_iter().find(accelerated).unwrap_or_default()
}

thread_local! {
    static PRECISION: Cell<Precision> = const { Cell::new(Precision::F32) };
}

/// Calls `of` with dense and pointwise convolutions and attention, forward and backward, multiplying at a precision in this thread;
/// on the CPU also the lookup of correlations. Sums are `f32`, and so is all else: what goes in and comes out, norms, softmax,
/// activations, flow and its lookups, and convolutions of few channels. What [`check_precision`] refuses is undefined here.
pub fn with_precision<T>(precision: Precision, of: impl FnOnce() -> T) -> T {
    scoped::with(&PRECISION, precision, of)
}

/// The precision of this thread: `f32` outside of [`with_precision`].
pub fn precision() -> Precision {
    PRECISION.get()
}

/// The precision of this thread on the CPU, which does not multiply `f16`.
pub(crate) fn cpu_precision() -> srflow_simd::Precision {
    match precision() {
        Precision::Bf16 => srflow_simd::Precision::Bf16,
        Precision::F32 | Precision::F16 => srflow_simd::Precision::F32,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_precision_holds_within_its_thread_and_call() {
        with_precision(Precision::Bf16, || {
            assert_eq!(precision(), Precision::Bf16);
            let elsewhere = std::thread::spawn(precision).join().expect("a thread");
            assert_eq!(elsewhere, Precision::F32);
            with_precision(Precision::F32, || assert_eq!(precision(), Precision::F32));
            assert_eq!(precision(), Precision::Bf16);
        });
        let panicked = std::panic::catch_unwind(|| with_precision(Precision::Bf16, || panic!("inside")));
        assert!(panicked.is_err());
        assert_eq!(precision(), Precision::F32);
    }

    #[test]
    fn what_a_device_does_not_multiply_is_answered_with_what_it_has() {
        let cpu = Device::flex();
        assert_eq!(check_precision(&cpu, Precision::Bf16), Ok(()));
        let error = check_precision(&cpu, Precision::F16).expect_err("not on the CPU").to_string();
        assert_eq!(error, "this device does not multiply f16: it has f32, bf16");
    }
}
