//! Chains of pointwise layers on NCHW slices: `x -> gelu(W1 x + b1) -> gelu(W2 h + b2 + x) -> ...`, computed in blocks of
//! pixels.
//!
//! Intermediate results, often wider than input and output, never leave the cache. [`mod@reference`] is the definition.

use srflow_simd::{
    Activation, Isa, Left, Output, Product, Start, Steps, fill_columns, multiply, multiply_diagonal,
    panel_columns,
};

pub mod reference;
pub mod tensor;

/// Panels per task.
const PANELS: usize = 2;

/// Weights of a layer.
#[derive(Debug, Clone, Copy)]
pub(crate) enum Map<'a> {
    /// `[outputs, inputs]`.
    Dense { weights: Left<'a>, outputs: usize },
    /// A factor for each channel.
    Scale(&'a [f32]),
}

/// Added to a layer's sums.
#[derive(Debug, Clone, Copy)]
pub(crate) enum Add<'a> {
    Nothing,
    /// The input of the layer with this index.
    InputOf(usize),
    /// A tensor in the shape of the output; only in the last layer.
    Planes(&'a [f32]),
}

/// `activation(map x + bias + add)`.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Layer<'a> {
    pub(crate) map: Map<'a>,
    pub(crate) bias: Option<&'a [f32]>,
    pub(crate) add: Add<'a>,
    pub(crate) activation: Activation,
}

/// The chain on `input` (`[batch, channels, pixels]`); `[batch, channels of the last layer, pixels]`.
///
/// Each sum starts at the bias and runs over the input channels in order, each step a fused multiply-add, so the result does not
/// depend on the number of threads. Panics when the length of a slice, or a layer, does not match.
pub(crate) fn pointwise(
    isa: Isa,
    input: &[f32],
    [batch, channels, pixels]: [usize; 3],
    layers: &[Layer],
) -> Vec<f32> {
    assert_eq!(input.len(), batch * channels * pixels, "input of {batch}x{channels}x{pixels}");
    let channels = check(channels, layers);
    let (inputs, outputs) = (channels[0], channels[channels.len() - 1]);
    if let Some(Layer { add: Add::Planes(planes), .. }) = layers.last() {
        assert_eq!(planes.len(), batch * outputs * pixels, "an addend for each output element");
    }
    let width = panel_columns(isa);
    let piece = PANELS * width;
    let scratch = || -> Vec<Vec<f32>> {
        channels[..layers.len()].iter().map(|channels| vec![0.0; channels * piece]).collect()
    };
    fill_columns(isa, [batch, outputs, pixels], piece, scratch, |states, n, own, out| {
        gather(&input[n * inputs * pixels..][..inputs * pixels], pixels, own.clone(), width, &mut states[0]);
        for (number, layer) in layers.iter().enumerate() {
            let (before, after) = states.split_at_mut(number + 1);
            let steps_of = |channels: usize| Steps { row: width, panel: channels * width };
            let add = match layer.add {
                Add::Nothing => None,
                Add::InputOf(layer) => Some((before[layer].as_slice(), steps_of(channels[layer]))),
                Add::Planes(planes) => {
                    let at = n * outputs * pixels + own.start;
                    Some((&planes[at..], Steps { row: pixels, panel: width }))
                }
            };
            let left = match layer.map {
                Map::Dense { weights, .. } => weights,
                Map::Scale(factors) => Left::F32(factors),
            };
            let product = Product {
                left,
                rows: channels[number + 1],
                depth: channels[number],
                right: &before[number],
                right_panel: channels[number] * width,
                start: layer.bias.map_or(Start::Zero, Start::PerRow),
                add,
                activation: layer.activation,
                columns: if after.is_empty() { own.len() } else { piece },
            };
            let into = |out: &mut Output| match layer.map {
                Map::Dense { .. } => multiply(isa, &product, out),
                Map::Scale(factors) => multiply_diagonal(isa, factors, &product, out),
            };
            match after.first_mut() {
                Some(state) => into(&mut Output::new(state, steps_of(channels[number + 1]))),
                None => into(out),
            }
        }
    })
}

/// Number of channels before each layer and after the last.
fn check(inputs: usize, layers: &[Layer]) -> Vec<usize> {
    assert!(!layers.is_empty() && inputs > 0, "a chain has a layer and channels");
    let mut channels = vec![inputs];
    for (number, layer) in layers.iter().enumerate() {
        let outputs = match layer.map {
            Map::Dense { outputs, .. } => outputs,
            Map::Scale(scale) => {
                assert_eq!(scale.len(), channels[number], "factors of layer {number}");
                scale.len()
            }
        };
        assert!(layer.bias.is_none_or(|bias| bias.len() == outputs), "bias of layer {number}");
        match layer.add {
            Add::Nothing => {}
            Add::InputOf(other) => {
                assert!(other <= number && channels[other] == outputs, "addend of layer {number}");
            }
            Add::Planes(_) => assert_eq!(number + 1, layers.len(), "the addend comes last"),
        }
        channels.push(outputs);
    }
    channels
}

/// Copies columns of planes of `pixels` elements to panels, zero-padding the last one.
fn gather(planes: &[f32], pixels: usize, columns: std::ops::Range<usize>, width: usize, panels: &mut [f32]) {
    let channels = planes.len() / pixels;
    for (first, panel) in columns.clone().step_by(width).zip(panels.chunks_exact_mut(channels * width)) {
        let count = width.min(columns.end - first);
        for (to, from) in panel.chunks_exact_mut(width).zip(planes.chunks_exact(pixels)) {
            to[..count].copy_from_slice(&from[first..first + count]);
            to[count..].fill(0.0);
        }
    }
}

#[cfg(test)]
pub(crate) mod tests;
