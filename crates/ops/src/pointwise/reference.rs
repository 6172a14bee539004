//! The definition: layer after layer, pixel by pixel, sums in f64.

use srflow_simd::Activation;

/// Weights of a [`Layer`].
#[derive(Debug, Clone)]
pub enum Map {
    /// `[outputs, inputs]`.
    Dense(Vec<f32>),
    /// A factor for each channel.
    Scale(Vec<f32>),
}

/// `activation(map x + bias + add)`.
#[derive(Debug, Clone)]
pub struct Layer {
    /// The weights.
    pub map: Map,
    /// A number for each output channel.
    pub bias: Vec<f32>,
    /// Adds what went into the layer of this number.
    pub add_input_of: Option<usize>,
    /// Applied last.
    pub activation: Activation,
}

/// The chain on one pixel's channels.
pub fn pointwise(pixel: &[f32], layers: &[Layer]) -> Vec<f32> {
    let mut states = vec![pixel.to_vec()];
    for layer in layers {
        let x = &states[states.len() - 1];
        let sum = |output: usize| -> f64 {
            match &layer.map {
                Map::Dense(weights) => {
                    let weights = &weights[output * x.len()..][..x.len()];
                    weights.iter().zip(x).map(|(&w, &x)| f64::from(w) * f64::from(x)).sum()
                }
                Map::Scale(factors) => f64::from(factors[output]) * f64::from(x[output]),
            }
        };
        let output = |o: usize| {
            let add = layer.add_input_of.map_or(0.0, |number| f64::from(states[number][o]));
            layer.activation.reference(sum(o) + f64::from(layer.bias[o]) + add) as f32
        };
        let outputs = (0..layer.bias.len()).map(output).collect();
        states.push(outputs);
    }
    states.swap_remove(layers.len())
}
