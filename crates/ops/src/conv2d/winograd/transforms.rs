//! The transforms of one dimension, with four outputs: `y = A^T ((G g) * (B^T d))`.

use srflow_simd::Simd;

/// Outputs of a tile in a transformed dimension.
pub(super) const OUTPUTS: usize = 4;

/// `G` for three taps, points 0, 1, -1, 2, -2 and infinity.
pub(super) const WEIGHTS_3: [[f64; 3]; 6] = [
    [1.0 / 4.0, 0.0, 0.0],
    [-1.0 / 6.0, -1.0 / 6.0, -1.0 / 6.0],
    [-1.0 / 6.0, 1.0 / 6.0, -1.0 / 6.0],
    [1.0 / 24.0, 1.0 / 12.0, 1.0 / 6.0],
    [1.0 / 24.0, -1.0 / 12.0, 1.0 / 6.0],
    [0.0, 0.0, 1.0],
];

/// `G` for five taps, points 0, 1, -1, 2, -2, 1/2, -1/2 and infinity.
pub(super) const WEIGHTS_5: [[f64; 5]; 8] = [
    [1.0, 0.0, 0.0, 0.0, 0.0],
    [-2.0 / 9.0, -2.0 / 9.0, -2.0 / 9.0, -2.0 / 9.0, -2.0 / 9.0],
    [-2.0 / 9.0, 2.0 / 9.0, -2.0 / 9.0, 2.0 / 9.0, -2.0 / 9.0],
    [1.0 / 90.0, 1.0 / 45.0, 2.0 / 45.0, 4.0 / 45.0, 8.0 / 45.0],
    [1.0 / 90.0, -1.0 / 45.0, 2.0 / 45.0, -4.0 / 45.0, 8.0 / 45.0],
    [32.0 / 45.0, 16.0 / 45.0, 8.0 / 45.0, 4.0 / 45.0, 2.0 / 45.0],
    [32.0 / 45.0, -16.0 / 45.0, 8.0 / 45.0, -4.0 / 45.0, 2.0 / 45.0],
    [0.0, 0.0, 0.0, 0.0, 1.0],
];

/// `B^T d` for three taps.
#[inline(always)]
pub(super) fn input_3<S: Simd>(s: S, d: [S::Vector; 6]) -> [S::Vector; 6] {
    let times = |factor: f32, x: S::Vector, add: S::Vector| s.mul_add(s.splat(factor), x, add);
    let even = times(-4.0, d[2], d[4]);
    let odd = times(-4.0, d[1], d[3]);
    let even_2 = s.sub(d[4], d[2]);
    let odd_2 = s.sub(d[3], d[1]);
    [
        times(4.0, d[0], times(-5.0, d[2], d[4])),
        s.add(even, odd),
        s.sub(even, odd),
        times(2.0, odd_2, even_2),
        times(-2.0, odd_2, even_2),
        times(4.0, d[1], times(-5.0, d[3], d[5])),
    ]
}

/// `A^T m` for three taps.
#[inline(always)]
pub(super) fn output_3<S: Simd>(s: S, m: [S::Vector; 6]) -> [S::Vector; OUTPUTS] {
    let times = |factor: f32, x: S::Vector, add: S::Vector| s.mul_add(s.splat(factor), x, add);
    let (sum, difference) = (s.add(m[1], m[2]), s.sub(m[1], m[2]));
    let (sum_2, difference_2) = (s.add(m[3], m[4]), s.sub(m[3], m[4]));
    [
        s.add(m[0], s.add(sum, sum_2)),
        times(2.0, difference_2, difference),
        times(4.0, sum_2, sum),
        times(8.0, difference_2, s.add(difference, m[5])),
    ]
}

/// `B^T d` for five taps.
#[inline(always)]
pub(super) fn input_5<S: Simd>(s: S, d: [S::Vector; 8]) -> [S::Vector; 8] {
    let times = |factor: f32, x: S::Vector, add: S::Vector| s.mul_add(s.splat(factor), x, add);
    let even_1 = times(-4.25, d[4], s.add(d[2], d[6]));
    let odd_1 = times(-4.25, d[3], s.add(d[1], d[5]));
    let even_2 = times(0.25, d[2], times(-1.25, d[4], d[6]));
    let odd_2 = times(0.5, d[1], times(-2.5, d[3], s.mul(s.splat(2.0), d[5])));
    let even_half = times(4.0, d[2], times(-5.0, d[4], d[6]));
    let odd_half = times(2.0, d[1], times(-2.5, d[3], s.mul(s.splat(0.5), d[5])));
    [
        times(5.25, s.sub(d[4], d[2]), s.sub(d[0], d[6])),
        s.add(even_1, odd_1),
        s.sub(even_1, odd_1),
        s.add(even_2, odd_2),
        s.sub(even_2, odd_2),
        s.add(even_half, odd_half),
        s.sub(even_half, odd_half),
        times(5.25, s.sub(d[3], d[5]), s.sub(d[7], d[1])),
    ]
}

/// `A^T m` for five taps.
#[inline(always)]
pub(super) fn output_5<S: Simd>(s: S, m: [S::Vector; 8]) -> [S::Vector; OUTPUTS] {
    let times = |factor: f32, x: S::Vector, add: S::Vector| s.mul_add(s.splat(factor), x, add);
    let (sum_1, difference_1) = (s.add(m[1], m[2]), s.sub(m[1], m[2]));
    let (sum_2, difference_2) = (s.add(m[3], m[4]), s.sub(m[3], m[4]));
    let (sum_half, difference_half) = (s.add(m[5], m[6]), s.sub(m[5], m[6]));
    [
        s.add(s.add(m[0], sum_1), s.add(sum_2, sum_half)),
        times(2.0, difference_2, times(0.5, difference_half, difference_1)),
        times(4.0, sum_2, times(0.25, sum_half, sum_1)),
        times(8.0, difference_2, times(0.125, difference_half, s.add(difference_1, m[7]))),
    ]
}
