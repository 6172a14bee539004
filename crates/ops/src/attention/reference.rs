//! The definition, in f64.

use super::Windows;
use super::windows::Window;

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

/// Pixels of an image of so many rows and columns, window after window.
fn each_window(windows: &Windows) -> Vec<Vec<usize>> {
    let [_, width] = windows.sides();
    let pixels = |window: Window| {
        let row = |y: usize| window.columns.clone().map(move |x| y * width + x);
        window.rows.clone().flat_map(row).collect()
    };
    windows.each().into_iter().map(pixels).collect()
}

/// The channels of some pixels.
fn part(image: &[f64], pixels: usize, own: &[usize]) -> Vec<f64> {
    image.chunks_exact(pixels).flat_map(|plane| own.iter().map(|&pixel| plane[pixel])).collect()
}

/// `whole` with a part put in.
fn put(whole: &mut [f64], pixels: usize, own: &[usize], part: &[f64]) {
    for (plane, part) in whole.chunks_exact_mut(pixels).zip(part.chunks_exact(own.len())) {
        own.iter().zip(part).for_each(|(&pixel, &x)| plane[pixel] = x);
    }
}

/// See [`super::windowed_attention`]; one image.
pub fn windowed_attention(queries: &[f64], keys: &[f64], values: &[f64], windows: &Windows) -> Vec<f64> {
    let pixels = windows.sides().iter().product();
    let mut out = vec![0.0; values.len()];
    for own in each_window(windows) {
        let [queries, keys, values] = [queries, keys, values].map(|map| part(map, pixels, &own));
        put(&mut out, pixels, &own, &attention(&queries, &keys, &values, own.len()));
    }
    out
}

/// See [`super::windowed_attention_backward`]; one image.
pub fn windowed_attention_backward(
    queries: &[f64],
    keys: &[f64],
    values: &[f64],
    grad: &[f64],
    windows: &Windows,
) -> [Vec<f64>; 3] {
    let pixels = windows.sides().iter().product();
    let mut gradients = [queries, keys, values].map(|map| vec![0.0; map.len()]);
    for own in each_window(windows) {
        let [queries, keys, values, grad] = [queries, keys, values, grad].map(|map| part(map, pixels, &own));
        let parts = attention_backward(&queries, &keys, &values, &grad, own.len());
        gradients.iter_mut().zip(parts).for_each(|(whole, part)| put(whole, pixels, &own, &part));
    }
    gradients
}
