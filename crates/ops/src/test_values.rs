//! Shared by the tests of operations: pseudo-random values, comparisons and numbers of threads.

use srflow_simd::Pair;

/// Pseudo-random values in -1..1.
pub(crate) fn values(count: usize, seed: u32) -> Vec<f32> {
    (0..count as u32)
        .map(|i| {
            let bits = (i ^ seed).wrapping_mul(0x9E37_79B9).rotate_left(13).wrapping_mul(0x85EB_CA6B);
            (bits >> 8) as f32 / 8_388_608.0 - 1.0
        })
        .collect()
}

/// The same numbers in f64, in which the definitions compute.
pub(crate) fn wide(values: &[f32]) -> Vec<f64> {
    values.iter().map(|&x| f64::from(x)).collect()
}

/// The numbers that bfloat16 makes of these.
pub(crate) fn rounded(values: &[f32]) -> Vec<f64> {
    values.iter().map(|&x| f64::from(Pair::new(x, 0.0).factors()[0])).collect()
}

/// The magnitude of the largest number.
pub(crate) fn largest(values: &[f64]) -> f64 {
    values.iter().fold(0.0, |largest, x| largest.max(x.abs()))
}

/// Checks that each element is within `tolerance` times the largest expected one.
pub(crate) fn assert_close(what: &str, found: &[f32], expected: &[f64], tolerance: f64) {
    assert_within(what, found, expected, tolerance * largest(expected));
}

/// Checks that each element is within `bound` of the expected one.
pub(crate) fn assert_within(what: &str, found: &[f32], expected: &[f64], bound: f64) {
    assert_eq!(found.len(), expected.len(), "{what}");
    for (i, (&found, expected)) in found.iter().zip(expected).enumerate() {
        let error = (f64::from(found) - expected).abs();
        assert!(
            error <= bound,
            "{what} [{i}]: {found} for {expected}, {error:.1e} off where {bound:.1e} may be"
        );
    }
}

/// What `run` returns on this number of threads.
pub(crate) fn with_threads<T: Send>(threads: usize, run: impl FnOnce() -> T + Send) -> T {
    let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("threads start");
    pool.install(run)
}
