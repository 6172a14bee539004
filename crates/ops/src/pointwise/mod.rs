//! Chains of pointwise layers on NCHW slices: `x -> gelu(W1 x + b1) -> gelu(W2 h + b2 + x) -> ...`, computed in blocks of
//! pixels.
//!
//! Intermediate results, often wider than input and output, never leave the cache. [`mod@reference`] is the definition.

use std::ops::Range;

use srflow_simd::{
    Activation, Isa, Left, Output, Pair, Precision, Product, Right, Scratch, Simd, Start, Steps, dispatch,
    fill_columns, multiply, multiply_diagonal, multiply_to_pairs, panel_columns,
};

pub mod reference;
pub mod tensor;

/// Panels per task.
const PANELS: usize = 2;
/// Planes from the one that is copied to the one whose memory is asked for.
const AHEAD: usize = 8;
/// Elements of a line of the cache.
const LINE: usize = 16;

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
    let scratch = || -> Vec<State> {
        (0..layers.len()).map(|number| State::before(layers, number, channels[number], piece)).collect()
    };
    let steps_of = |channels: usize| Steps { row: width, panel: channels * width };
    fill_columns(isa, [batch, outputs, pixels], piece, scratch, |states, n, own, out| {
        let image = &input[n * inputs * pixels..][..inputs * pixels];
        if let State::Numbers(first) = &mut states[0] {
            gather(isa, image, pixels, &own, width, first);
        }
        for (number, layer) in layers.iter().enumerate() {
            let (before, after) = states.split_at_mut(number + 1);
            let add = match layer.add {
                Add::Nothing => None,
                Add::InputOf(layer) => Some((before[layer].numbers(), steps_of(channels[layer]))),
                Add::Planes(planes) => {
                    let at = n * outputs * pixels + own.start;
                    Some((&planes[at..], Steps { row: pixels, panel: width }))
                }
            };
            let left = match layer.map {
                Map::Dense { weights, .. } => weights,
                Map::Scale(factors) => Left::F32(factors),
            };
            let (right, right_panel) = before[number].right(channels[number], width);
            let product = Product {
                left,
                rows: channels[number + 1],
                depth: channels[number],
                right,
                right_panel,
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
                Some(State::Pairs(state)) => {
                    let panel = Precision::Bf16.packed(channels[number + 1]) * width;
                    multiply_to_pairs(isa, &product, state, panel);
                }
                Some(State::Numbers(state)) => {
                    into(&mut Output::new(state, steps_of(channels[number + 1])));
                }
                None => into(out),
            }
        }
    })
}

/// The input of a layer: `[channels, columns]` panel by panel.
enum State {
    Numbers(Scratch),
    /// Where a product of bfloat16 alone reads what another one wrote.
    Pairs(Scratch<Pair>),
}

impl State {
    /// Of layer `number`, for `columns` columns.
    fn before(layers: &[Layer], number: usize, channels: usize, columns: usize) -> Self {
        let of_pairs = |layer: &Layer| matches!(layer.map, Map::Dense { weights: Left::Bf16(_), .. });
        let is_added = |layer: &Layer| matches!(layer.add, Add::InputOf(other) if other == number);
        if number > 0
            && of_pairs(&layers[number - 1])
            && of_pairs(&layers[number])
            && !layers.iter().any(is_added)
        {
            return Self::Pairs(Scratch::of(Precision::Bf16.packed(channels) * columns));
        }
        Self::Numbers(Scratch::of(channels * columns))
    }

    /// Panics when they are pairs.
    fn numbers(&self) -> &[f32] {
        match self {
            Self::Numbers(numbers) => numbers,
            Self::Pairs(_) => panic!("an addend is kept as numbers"),
        }
    }

    /// All of it, and the elements from one panel to the next.
    fn right(&self, channels: usize, width: usize) -> (Right<'_>, usize) {
        match self {
            Self::Numbers(numbers) => (Right::F32(numbers), channels * width),
            Self::Pairs(pairs) => (Right::Bf16(pairs), Precision::Bf16.packed(channels) * width),
        }
    }
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

dispatch! {
    /// Copies columns of planes of `pixels` elements to panels of `width` columns, zero-padding the last one.
    ///
    /// All panels of a plane before the next plane: what is read is then as long as possible, and the memory of the next
    /// planes is asked for meanwhile.
    fn gather = gather_kernel(planes: &[f32], pixels: usize, columns: &Range<usize>, width: usize, panels: &mut [f32])
}

#[inline(always)]
fn gather_kernel<S: Simd>(
    s: S,
    planes: &[f32],
    pixels: usize,
    columns: &Range<usize>,
    width: usize,
    panels: &mut [f32],
) {
    let panel = planes.len() / pixels * width;
    for (channel, plane) in planes.chunks_exact(pixels).enumerate() {
        if let Some(later) =
            planes.get((channel + AHEAD) * pixels..).and_then(|planes| planes.get(columns.clone()))
        {
            later.iter().step_by(LINE).for_each(|line| s.prefetch(line));
        }
        let mut from = &plane[columns.clone()];
        for to in panels.chunks_exact_mut(panel) {
            let to = &mut to[channel * width..][..width];
            for to in to.chunks_exact_mut(S::LANES) {
                s.write(s.read_first(from), to);
                from = from.get(S::LANES..).unwrap_or_default();
            }
        }
    }
}

#[cfg(test)]
pub(crate) mod tests;
