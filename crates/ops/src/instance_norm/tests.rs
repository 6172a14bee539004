use super::tensor::InstanceNorm;
use super::*;
use crate::operation::tests::{ACTIVATIONS, Case};

/// Planes whose mean is far larger than their spread.
pub(crate) fn cases() -> Vec<Case> {
    let case = |[height, width]: [usize; 2], activation| {
        let pixels = height * width;
        Case::of(
            &format!("instance norm, {activation:?}, {height}x{width}"),
            InstanceNorm { epsilon: EPSILON, activation },
            [&[2, 3, height, width]],
            move |x| reference::instance_norm(&x[0], pixels, EPSILON, activation),
            move |x, grad| vec![reference::instance_norm_backward(&x[0], grad, pixels, EPSILON, activation)],
        )
        .change(0, move |i, x| 2.0 * (i / pixels) as f32 + x)
    };
    let sizes = [[2, 3], [4, 4], [9, 11]].map(|size| case(size, Activation::Relu));
    let activations = ACTIVATIONS.map(|activation| case([5, 7], activation));
    sizes.into_iter().chain(activations).chain([case([1, 1999], Activation::Gelu)]).collect()
}
