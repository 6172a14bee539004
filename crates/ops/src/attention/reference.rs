//! The definition, in f64.

/// Scores `q_i . k_j` of one image, `[pixels i, pixels j]`, to `softmax_j`. Queries and keys are `[channels, pixels]`.
fn weights(queries: &[f64], keys: &[f64], pixels: usize) -> Vec<f64> {
    let mut weights = Vec::with_capacity(pixels * pixels);
    for i in 0..pixels {
        let scores: Vec<f64> = (0..pixels).map(|j| product(queries, i, keys, j, pixels)).collect();
        let most = scores.iter().copied().fold(f64::NEG_INFINITY, f64::max);
        let sum: f64 = scores.iter().map(|score| (score - most).exp()).sum();
        weights.extend(scores.iter().map(|score| (score - most).exp() / sum));
    }
    weights
}

/// `a_i . b_j`, of `[channels, pixels]` each.
fn product(a: &[f64], i: usize, b: &[f64], j: usize, pixels: usize) -> f64 {
    let planes = a.chunks_exact(pixels).zip(b.chunks_exact(pixels));
    planes.map(|(a, b)| a[i] * b[j]).sum()
}

/// `out_i = sum_j weight(i, j) x_j` for each channel of `x`, `[channels, pixels]`.
fn weighted(x: &[f64], pixels: usize, weight: impl Fn(usize, usize) -> f64) -> Vec<f64> {
    let of =
        |plane: &[f64], i: usize| -> f64 { plane.iter().enumerate().map(|(j, x)| weight(i, j) * x).sum() };
    let planes = x.chunks_exact(pixels);
    planes.flat_map(|plane| (0..pixels).map(move |i| (plane, i))).map(|(plane, i)| of(plane, i)).collect()
}

/// See [`super::attention`]; one image.
pub fn attention(queries: &[f64], keys: &[f64], values: &[f64], pixels: usize) -> Vec<f64> {
    let weights = weights(queries, keys, pixels);
    weighted(values, pixels, |i, j| weights[i * pixels + j])
}

/// `ln sum_j exp(q_i . k_j)` of one image.
pub fn log_sums(queries: &[f64], keys: &[f64], pixels: usize) -> Vec<f64> {
    let log_sum = |i: usize| {
        let scores: Vec<f64> = (0..pixels).map(|j| product(queries, i, keys, j, pixels)).collect();
        let most = scores.iter().copied().fold(f64::NEG_INFINITY, f64::max);
        most + scores.iter().map(|score| (score - most).exp()).sum::<f64>().ln()
    };
    (0..pixels).map(log_sum).collect()
}

/// Gradients of queries and keys, from `grad`, that of [`log_sums`].
pub fn log_sums_backward(queries: &[f64], keys: &[f64], grad: &[f64], pixels: usize) -> [Vec<f64>; 2] {
    let weights = weights(queries, keys, pixels);
    [
        weighted(keys, pixels, |i, j| grad[i] * weights[i * pixels + j]),
        weighted(queries, pixels, |j, i| grad[i] * weights[i * pixels + j]),
    ]
}

/// See [`super::attention_backward`]; one image.
pub fn attention_backward(
    queries: &[f64],
    keys: &[f64],
    values: &[f64],
    grad: &[f64],
    pixels: usize,
) -> [Vec<f64>; 3] {
    let weights = weights(queries, keys, pixels);
    let mut scores = Vec::with_capacity(weights.len());
    for (i, weights) in weights.chunks_exact(pixels).enumerate() {
        let of_weights: Vec<f64> = (0..pixels).map(|j| product(grad, i, values, j, pixels)).collect();
        let mean: f64 = weights.iter().zip(&of_weights).map(|(weight, of)| weight * of).sum();
        scores.extend(weights.iter().zip(&of_weights).map(|(weight, of)| weight * (of - mean)));
    }
    [
        weighted(keys, pixels, |i, j| scores[i * pixels + j]),
        weighted(queries, pixels, |j, i| scores[i * pixels + j]),
        weighted(grad, pixels, |j, i| weights[i * pixels + j]),
    ]
}
