//! At which precision the operations of a thread multiply.

use std::cell::Cell;

use srflow_simd::Isa;
pub use srflow_simd::Precision;

thread_local! {
    static PRECISION: Cell<Precision> = const { Cell::new(Precision::F32) };
}

/// Calls `of` with dense and pointwise convolutions and attention on the CPU, forward and backward, multiplying at a precision in
/// this thread. Sums are `f32`, and so is all else: what goes in and comes out, norms, softmax, activations, flow and its
/// lookups, and convolutions of few channels.
pub fn with_precision<T>(precision: Precision, of: impl FnOnce() -> T) -> T {
    /// Also after a panic.
    struct Restore(Precision);
    impl Drop for Restore {
        fn drop(&mut self) {
            PRECISION.set(self.0);
        }
    }
    let _restore = Restore(PRECISION.replace(precision));
    of()
}

/// The precision of this thread: `f32` outside of [`with_precision`].
pub fn precision() -> Precision {
    PRECISION.get()
}

/// The fastest precision of this processor: bfloat16 where it multiplies that by itself, else `f32`.
pub fn fastest_precision() -> Precision {
    if Isa::best().multiplies_bf16() { Precision::Bf16 } else { Precision::F32 }
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
}
