//! The definition, in f64: layer after layer, pixel by pixel.

use srflow_simd::Activation;

/// Weights of a [`Layer`].
#[derive(Debug, Clone)]
pub enum Map {
    /// `[outputs, inputs]`.
    Dense(Vec<f64>),
    /// A factor for each channel.
    Scale(Vec<f64>),
}

/// `activation(map x + bias + add)`.
#[derive(Debug, Clone)]
pub struct Layer {
    /// The weights.
    pub map: Map,
    /// A number for each output channel.
    pub bias: Vec<f64>,
    /// Adds what went into the layer of this number.
    pub add_input_of: Option<usize>,
    /// Applied last.
    pub activation: Activation,
}

/// Gradients of a layer.
#[derive(Debug, Clone)]
pub struct LayerGradients {
    /// Of its [`Map`], in the same order.
    pub weight: Vec<f64>,
    pub bias: Vec<f64>,
}

impl Layer {
    /// Calls `visit(weight, input, output)`, places in their arrays, for each product.
    fn each_product(&self, mut visit: impl FnMut(usize, usize, usize)) {
        let outputs = self.bias.len();
        match &self.map {
            Map::Dense(weights) => {
                let inputs = weights.len() / outputs;
                (0..weights.len()).for_each(|w| visit(w, w % inputs, w / inputs));
            }
            Map::Scale(_) => (0..outputs).for_each(|channel| visit(channel, channel, channel)),
        }
    }

    fn weights(&self) -> &[f64] {
        match &self.map {
            Map::Dense(weights) | Map::Scale(weights) => weights,
        }
    }
}

/// The inputs of all layers and the output of the last, of one pixel, and what each activation was applied to.
fn states(pixel: &[f64], layers: &[Layer]) -> (Vec<Vec<f64>>, Vec<Vec<f64>>) {
    let (mut states, mut sums) = (vec![pixel.to_vec()], Vec::new());
    for (number, layer) in layers.iter().enumerate() {
        let mut sum = layer.bias.clone();
        layer.each_product(|w, i, o| sum[o] += layer.weights()[w] * states[number][i]);
        if let Some(other) = layer.add_input_of {
            sum.iter_mut().zip(&states[other]).for_each(|(sum, x)| *sum += x);
        }
        states.push(sum.iter().map(|&sum| layer.activation.reference(sum)).collect());
        sums.push(sum);
    }
    (states, sums)
}

/// The chain on one pixel's channels.
pub fn pointwise(pixel: &[f64], layers: &[Layer]) -> Vec<f64> {
    states(pixel, layers).0.swap_remove(layers.len())
}

/// Gradients of the pixel and of each layer from `grad`, that of the output of [`pointwise`].
pub fn pointwise_backward(pixel: &[f64], layers: &[Layer], grad: &[f64]) -> (Vec<f64>, Vec<LayerGradients>) {
    let (states, sums) = states(pixel, layers);
    let mut d_states: Vec<Vec<f64>> = states.iter().map(|state| vec![0.0; state.len()]).collect();
    d_states[layers.len()] = grad.to_vec();
    let mut gradients = Vec::new();
    for (number, layer) in layers.iter().enumerate().rev() {
        let slopes = sums[number].iter().map(|&sum| layer.activation.reference_derivative(sum));
        let d_sum: Vec<f64> = d_states[number + 1].iter().zip(slopes).map(|(d, slope)| d * slope).collect();
        let mut d_weight = vec![0.0; layer.weights().len()];
        layer.each_product(|w, i, o| {
            d_weight[w] += d_sum[o] * states[number][i];
            d_states[number][i] += d_sum[o] * layer.weights()[w];
        });
        if let Some(other) = layer.add_input_of {
            d_states[other].iter_mut().zip(&d_sum).for_each(|(to, from)| *to += from);
        }
        gradients.push(LayerGradients { weight: d_weight, bias: d_sum });
    }
    gradients.reverse();
    (d_states.swap_remove(0), gradients)
}
