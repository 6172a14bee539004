//! The transforms of one dimension, with four outputs: `y = A^T ((G g) * (B^T d))`.

use srflow_simd::Simd;

/// Outputs of a tile in a transformed dimension.
pub(super) const OUTPUTS: usize = 4;

/// The points of the transforms of three taps: 0, `a`, `-a`, `b`, `-b` and infinity.
#[derive(Debug, Clone, Copy)]
struct Points {
    a: f64,
    b: f64,
}

/// 1 and 2 for `f32`. For bfloat16, whose rounding the transforms amplify, 2/3 and 3/2: the error is less than half of that with
/// 1 and 2 (1.0 % of the result for random numbers instead of 2.4 %; products without transforms: 0.2 %).
const fn points(bf16: bool) -> Points {
    if bf16 { Points { a: 2.0 / 3.0, b: 3.0 / 2.0 } } else { Points { a: 1.0, b: 2.0 } }
}

/// `G` for three taps.
pub(super) const fn weights_3(bf16: bool) -> [[f64; 3]; 6] {
    let Points { a, b } = points(bf16);
    let (aa, bb) = (a * a, b * b);
    let (of_a, of_b) = (2.0 * aa * (aa - bb), 2.0 * bb * (bb - aa));
    [
        [1.0 / (aa * bb), 0.0, 0.0],
        [1.0 / of_a, a / of_a, aa / of_a],
        [1.0 / of_a, -a / of_a, aa / of_a],
        [1.0 / of_b, b / of_b, bb / of_b],
        [1.0 / of_b, -b / of_b, bb / of_b],
        [0.0, 0.0, 1.0],
    ]
}

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
pub(super) fn input_3<S: Simd, const BF16: bool>(s: S, d: [S::Vector; 6]) -> [S::Vector; 6] {
    let times = |factor: f64, x: S::Vector, add: S::Vector| s.mul_add(s.splat(factor as f32), x, add);
    let Points { a, b } = const { points(BF16) };
    let (aa, bb) = (a * a, b * b);
    let (even, odd) = (times(-bb, d[2], d[4]), times(-bb, d[1], d[3]));
    let (even_2, odd_2) = (times(-aa, d[2], d[4]), times(-aa, d[1], d[3]));
    [
        times(aa * bb, d[0], times(-(aa + bb), d[2], d[4])),
        times(a, odd, even),
        times(-a, odd, even),
        times(b, odd_2, even_2),
        times(-b, odd_2, even_2),
        times(aa * bb, d[1], times(-(aa + bb), d[3], d[5])),
    ]
}

/// `A^T m` for three taps.
#[inline(always)]
pub(super) fn output_3<S: Simd, const BF16: bool>(s: S, m: [S::Vector; 6]) -> [S::Vector; OUTPUTS] {
    let by = |factor: f64, x: S::Vector| s.mul(s.splat(factor as f32), x);
    let times = |factor: f64, x: S::Vector, add: S::Vector| s.mul_add(s.splat(factor as f32), x, add);
    let Points { a, b } = const { points(BF16) };
    let (sum, difference) = (s.add(m[1], m[2]), s.sub(m[1], m[2]));
    let (sum_2, difference_2) = (s.add(m[3], m[4]), s.sub(m[3], m[4]));
    [
        s.add(m[0], s.add(sum, sum_2)),
        times(b, difference_2, by(a, difference)),
        times(b * b, sum_2, by(a * a, sum)),
        times(b * b * b, difference_2, times(a * a * a, difference, m[5])),
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
