use super::tensor::InstanceNorm;
use super::*;
use crate::operation::tests::{ACTIVATIONS, Case};

/// Planes whose mean is far larger than their spread.
pub(crate) fn cases() -> Vec<Case> {
    let case = |[height, width]: [usize; 2], activation| {
        let pixels = height * width;
        let name = format!("instance norm, {activation:?}, {height}x{width}");
        Case::of(&name, InstanceNorm(activation), [&[2, 3, height, width]], move |x| {
            reference::instance_norm(&x[0], pixels, activation)
        })
        .change(0, move |i, x| 8.0 * (i / pixels) as f32 + x)
    };
    let sizes = [[1, 3], [4, 4], [9, 11]].map(|size| case(size, Activation::Relu));
    let activations = ACTIVATIONS.map(|activation| case([5, 7], activation));
    sizes.into_iter().chain(activations).chain([case([1, 1999], Activation::Gelu)]).collect()
}
