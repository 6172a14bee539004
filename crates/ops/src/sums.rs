//! Sums over long slices: accurate, and without a serial dependency between additions.

/// Elements summed in f32 before the result is added in f64.
const RUN: usize = 512;
/// Number of partial sums: one or two vectors.
const LANES: usize = 16;

/// The sum of `of` each value.
#[inline(always)]
pub(crate) fn sum(values: &[f32], of: impl Fn(f32) -> f32) -> f64 {
    sum_pairs(values, values, |x, _| of(x))
}

/// The sum of `of` each pair of values.
#[inline(always)]
pub(crate) fn sum_pairs(a: &[f32], b: &[f32], of: impl Fn(f32, f32) -> f32) -> f64 {
    let mut total = 0.0;
    for (a, b) in a.chunks(RUN).zip(b.chunks(RUN)) {
        let mut lanes = [0.0_f32; LANES];
        for (a, b) in a.chunks(LANES).zip(b.chunks(LANES)) {
            for (lane, (&a, &b)) in lanes.iter_mut().zip(a.iter().zip(b)) {
                *lane += of(a, b);
            }
        }
        total += lanes.iter().map(|&lane| f64::from(lane)).sum::<f64>();
    }
    total
}
