//! The definition, in f64, element by element.

use crate::MapShape;

/// Where the update gate and the reset gate of element `index` of the hidden state stand among the gates.
fn gates_of(index: usize, shape: &MapShape) -> [usize; 2] {
    let image = shape.channels * shape.pixels();
    let update = index / image * 2 * image + index % image;
    [update, update + image]
}

/// See [`super::reset`].
pub fn reset(gates: &[f64], hidden: &[f64], shape: &MapShape) -> Vec<f64> {
    let element = |i| {
        let [_, reset] = gates_of(i, shape);
        gates[reset] * hidden[i]
    };
    (0..hidden.len()).map(element).collect()
}

/// See [`super::reset_backward`].
pub fn reset_backward(gates: &[f64], hidden: &[f64], grad: &[f64], shape: &MapShape) -> [Vec<f64>; 2] {
    let [mut d_gates, mut d_hidden] = [vec![0.0; gates.len()], vec![0.0; hidden.len()]];
    for i in 0..hidden.len() {
        let [_, reset] = gates_of(i, shape);
        d_gates[reset] = grad[i] * hidden[i];
        d_hidden[i] = grad[i] * gates[reset];
    }
    [d_gates, d_hidden]
}

/// See [`super::update`].
pub fn update(gates: &[f64], hidden: &[f64], candidate: &[f64], shape: &MapShape) -> Vec<f64> {
    let element = |i| {
        let [update, _] = gates_of(i, shape);
        (1.0 - gates[update]) * hidden[i] + gates[update] * candidate[i]
    };
    (0..hidden.len()).map(element).collect()
}

/// See [`super::update_backward`].
pub fn update_backward(
    gates: &[f64],
    hidden: &[f64],
    candidate: &[f64],
    grad: &[f64],
    shape: &MapShape,
) -> [Vec<f64>; 3] {
    let mut d_gates = vec![0.0; gates.len()];
    let [mut d_hidden, mut d_candidate] = [vec![0.0; hidden.len()], vec![0.0; hidden.len()]];
    for i in 0..hidden.len() {
        let [update, _] = gates_of(i, shape);
        d_gates[update] = grad[i] * (candidate[i] - hidden[i]);
        d_hidden[i] = grad[i] * (1.0 - gates[update]);
        d_candidate[i] = grad[i] * gates[update];
    }
    [d_gates, d_hidden, d_candidate]
}
