//! The definition, in f64, element by element.

use super::GruSize;

/// Where the update gate of element `index` of the hidden state stands among the gates; its reset gate stands as many
/// elements on as an image's hidden state has.
fn gate(index: usize, size: GruSize) -> usize {
    let image = size.channels * size.pixels;
    index / image * 2 * image + index % image
}

/// See [`super::reset`].
pub fn reset(gates: &[f64], hidden: &[f64], size: GruSize) -> Vec<f64> {
    let image = size.channels * size.pixels;
    (0..hidden.len()).map(|i| gates[gate(i, size) + image] * hidden[i]).collect()
}

/// See [`super::update`].
pub fn update(gates: &[f64], hidden: &[f64], candidate: &[f64], size: GruSize) -> Vec<f64> {
    (0..hidden.len())
        .map(|i| {
            let update = gates[gate(i, size)];
            (1.0 - update) * hidden[i] + update * candidate[i]
        })
        .collect()
}
