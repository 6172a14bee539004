//! The definition: PyTorch's `max_pool2d(x, 2)`.

use crate::MapShape;

/// Where the largest of each 2x2 pixels lies in the input: the first one of equal ones, and NaN is larger than any number.
fn largest(input: &[f64], size: MapShape) -> Vec<usize> {
    let MapShape { height, width, .. } = size;
    let mut found = Vec::new();
    for plane in 0..size.planes() {
        for (y, x) in (0..height / 2).flat_map(|y| (0..width / 2).map(move |x| (y, x))) {
            let first = (plane * height + 2 * y) * width + 2 * x;
            let mut largest = first;
            for other in [first + 1, first + width, first + width + 1] {
                if input[other] > input[largest] || input[other].is_nan() && !input[largest].is_nan() {
                    largest = other;
                }
            }
            found.push(largest);
        }
    }
    found
}

/// See [`super::max_pool`].
pub fn max_pool(input: &[f64], size: MapShape) -> Vec<f64> {
    largest(input, size).into_iter().map(|index| input[index]).collect()
}

/// See [`super::max_pool_backward`].
pub fn max_pool_backward(input: &[f64], grad: &[f64], size: MapShape) -> Vec<f64> {
    let mut out = vec![0.0; input.len()];
    for (index, grad) in largest(input, size).into_iter().zip(grad) {
        out[index] = *grad;
    }
    out
}
