use super::tensor::LayerNorm;
use super::*;
use crate::operation::tests::{ACTIVATIONS, Case};

const EPSILON: f64 = 1e-6;

/// Pixels whose mean is larger than their spread.
pub(crate) fn cases() -> Vec<Case> {
    let case = |[channels, height, width]: [usize; 3], activation| {
        let shape = MapShape::from([2, channels, height, width]);
        Case::of(
            &format!("layer norm, {activation:?}, {channels}x{height}x{width}"),
            LayerNorm { epsilon: EPSILON, activation },
            [&[2, channels, height, width]],
            move |x| reference::layer_norm(&x[0], &shape, EPSILON, activation),
            move |x, grad| vec![reference::layer_norm_backward(&x[0], grad, &shape, EPSILON, activation)],
        )
        .change(0, move |i, x| (i % (height * width) % 4) as f32 + x)
    };
    let sizes = [[5, 1, 1], [8, 4, 4], [3, 2, BLOCK + 9]].map(|size| case(size, Activation::Identity));
    sizes.into_iter().chain(ACTIVATIONS.map(|activation| case([6, 5, 7], activation))).collect()
}
