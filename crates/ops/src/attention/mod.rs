//! Attention between the pixels of an image: `out_i = sum_j softmax_j(q_i . k_j) v_j`, without the matrix of all pairs.
//!
//! Pairs are computed in blocks that stay in cache. The largest score of each pixel and the sum of its exponentials are
//! computed once; after that, a pass over values needs each pair once, and so do the gradients. As many weights as the memory
//! limit allows are kept, since the networks apply the same weights to different values many times. Where they are applied
//! once, [`windowed_attention`] computes each pair once.
//! [`mod@reference`] is the definition.

use srflow_simd::Isa;

use backward::Gathered;
use weights::AttentionWeights;

use crate::precision::cpu_precision;

mod backward;
mod composed;
mod panels;
mod recomputed;
pub mod reference;
mod softmax;
pub mod tensor;
mod weights;
mod windows;

pub use windows::{Windows, windowed_attention, windowed_attention_backward};

/// Calls `of` with queries, keys and the `others` of each image.
fn each_image<'a, const N: usize, T>(
    others: [&'a [f32]; N],
    pairs: [&'a [f32]; 2],
    [batch, channels, pixels]: [usize; 3],
    of: impl Fn([&'a [f32]; 2], [&'a [f32]; N]) -> T,
) -> Vec<T> {
    for pair in pairs {
        assert_eq!(pair.len(), batch * channels * pixels, "queries and keys of {batch}x{channels}x{pixels}");
    }
    for other in others {
        assert!(other.len().is_multiple_of(batch * pixels), "values of {batch} images of {pixels} pixels");
    }
    (0..batch).map(|n| of(pairs.map(|x| image(x, batch, n)), others.map(|x| image(x, batch, n)))).collect()
}

/// Image number `n` of `batch`.
fn image(values: &[f32], batch: usize, n: usize) -> &[f32] {
    let len = values.len() / batch;
    &values[n * len..][..len]
}

/// `out_i = sum_j softmax_j(q_i . k_j) v_j` for every image. Queries and keys are `[batch, channels, pixels]`, values and
/// output `[batch, value channels, pixels]`. Panics when the length of a slice does not match.
pub fn attention(queries: &[f32], keys: &[f32], values: &[f32], sizes: [usize; 3]) -> Vec<f32> {
    let gather = |[queries, keys]: [&[f32]; 2], [values]: [&[f32]; 1]| {
        AttentionWeights::new(Isa::best(), cpu_precision(), [queries, keys], sizes[2], 0).gather(values)
    };
    each_image([values], [queries, keys], sizes, gather).concat()
}

/// Gradients of queries, keys and values, given `grad`, that of the output of [`attention`]. Panics when the length of a slice
/// does not match.
pub fn attention_backward(
    queries: &[f32],
    keys: &[f32],
    values: &[f32],
    grad: &[f32],
    sizes: [usize; 3],
) -> [Vec<f32>; 3] {
    assert_eq!(values.len(), grad.len(), "a gradient for each output");
    let backward = |[queries, keys]: [&[f32]; 2], [values, grad]: [&[f32]; 2]| {
        let weights = AttentionWeights::new(Isa::best(), cpu_precision(), [queries, keys], sizes[2], 0);
        let gathered = weights.gather(values);
        let gathered = Gathered { values, gathered: &gathered, grad };
        let [d_queries, d_keys] = weights.backward(queries, keys, &[gathered], &vec![0.0; sizes[2]]);
        [d_queries, d_keys, weights.gather_backward(queries, keys, grad)]
    };
    let images = each_image([values, grad], [queries, keys], sizes, backward);
    [0, 1, 2].map(|of| images.iter().flat_map(|gradients| &gradients[of]).copied().collect())
}

#[cfg(test)]
pub(crate) mod tests;
