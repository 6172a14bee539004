//! The definition, in f64.

/// `softmax_j(q_i . k_j)` of one image: `[pixels i, pixels j]`. Queries and keys are `[channels, pixels]`.
fn weights(queries: &[f32], keys: &[f32], pixels: usize) -> Vec<f64> {
    let mut weights = Vec::with_capacity(pixels * pixels);
    for i in 0..pixels {
        let score = |j: usize| -> f64 {
            let pairs = queries.chunks_exact(pixels).zip(keys.chunks_exact(pixels));
            pairs.map(|(q, k)| f64::from(q[i]) * f64::from(k[j])).sum()
        };
        let scores: Vec<f64> = (0..pixels).map(score).collect();
        let most = scores.iter().copied().fold(f64::NEG_INFINITY, f64::max);
        let sum: f64 = scores.iter().map(|score| (score - most).exp()).sum();
        weights.extend(scores.iter().map(|score| (score - most).exp() / sum));
    }
    weights
}

/// See [`super::attention`]; one image.
pub fn attention(queries: &[f32], keys: &[f32], values: &[f32], pixels: usize) -> Vec<f32> {
    let weights = weights(queries, keys, pixels);
    let of = |plane: &[f32], i: usize| -> f64 {
        weights[i * pixels..][..pixels].iter().zip(plane).map(|(w, &v)| w * f64::from(v)).sum()
    };
    let planes = values.chunks_exact(pixels);
    planes
        .flat_map(|plane| (0..pixels).map(move |i| (plane, i)))
        .map(|(plane, i)| of(plane, i) as f32)
        .collect()
}
