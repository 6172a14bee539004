//! Chains of pointwise layers on NCHW slices: `x -> gelu(W1 x + b1) -> gelu(W2 h + b2 + x) -> ...`, block of pixels by block
//! of pixels.
//!
//! What lies between the layers, often wider than input and output, never leaves the cache. [`mod@reference`] is the
//! definition.

use rayon::prelude::*;
use srflow_simd::{
    Activation, Isa, Product, SharedMut, Simd, Start, Steps, dispatch, multiply, panel_columns,
};

pub mod reference;
pub mod tensor;

/// Panels of one piece of work.
const PANELS: usize = 2;

/// Weights of a layer.
#[derive(Debug, Clone, Copy)]
pub(crate) enum Map<'a> {
    /// `[outputs, inputs]`, in the order of [`srflow_simd::pack_rows`].
    Dense(&'a [f32]),
    /// A factor for each channel.
    Scale(&'a [f32]),
}

/// What is added to a layer's sums.
#[derive(Debug, Clone, Copy)]
pub(crate) enum Add<'a> {
    Nothing,
    /// What went into the layer of this number, the first being 0.
    InputOf(usize),
    /// As large as the output; in the last layer only.
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
/// Each sum starts at the bias and runs over the input channels in order, each step a fused multiply-add, so the result is
/// the same for every number of threads. Panics when a slice or a layer does not fit.
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
    let pieces = pixels.div_ceil(piece);
    let fill = |target: SharedMut| {
        let scratch = || -> Vec<Vec<f32>> {
            channels[..layers.len()].iter().map(|channels| vec![0.0; channels * piece]).collect()
        };
        (0..batch * pieces).into_par_iter().for_each_init(scratch, |states, task| {
            let (n, first) = (task / pieces, task % pieces * piece);
            let columns = piece.min(pixels - first);
            let image = &input[n * inputs * pixels..][..inputs * pixels];
            gather(image, pixels, first..first + columns, width, &mut states[0]);
            for (number, layer) in layers.iter().enumerate() {
                let (before, after) = states.split_at_mut(number + 1);
                let at = n * outputs * pixels + first;
                let (out, out_steps, columns) = match after.first_mut() {
                    Some(state) => {
                        (state.as_mut_ptr(), Steps { row: width, panel: channels[number + 1] * width }, piece)
                    }
                    // SAFETY: inside; these columns are this task's.
                    None => (unsafe { target.at(at) }, Steps { row: pixels, panel: width }, columns),
                };
                let add = match layer.add {
                    Add::Nothing => None,
                    Add::InputOf(layer) => {
                        let steps = Steps { row: width, panel: channels[layer] * width };
                        Some((before[layer].as_ptr(), steps))
                    }
                    Add::Planes(planes) => Some((planes[at..].as_ptr(), Steps { row: pixels, panel: width })),
                };
                let left = match layer.map {
                    Map::Dense(weights) | Map::Scale(weights) => weights.as_ptr(),
                };
                let product = Product {
                    left,
                    rows: channels[number + 1],
                    depth: channels[number],
                    right: before[number].as_ptr(),
                    right_panel: channels[number] * width,
                    start: layer.bias.map_or(Start::Zero, |bias| Start::PerRow(bias.as_ptr())),
                    add,
                    activation: layer.activation,
                    out,
                    out_steps,
                    columns,
                };
                // SAFETY: states hold whole panels, the output and the addend these columns.
                unsafe {
                    match layer.map {
                        Map::Dense(_) => multiply(isa, &product),
                        Map::Scale(_) => scale(isa, &product),
                    }
                }
            }
        });
    };
    // SAFETY: the pieces cover every pixel of every image, and the last layer writes all output channels of each.
    unsafe { SharedMut::fill_new(batch * outputs * pixels, fill) }
}

/// Channels before each layer and after the last.
fn check(inputs: usize, layers: &[Layer]) -> Vec<usize> {
    assert!(!layers.is_empty() && inputs > 0, "a chain has a layer and channels");
    let mut channels = vec![inputs];
    for (number, layer) in layers.iter().enumerate() {
        let outputs = match layer.map {
            Map::Dense(weights) => {
                assert!(weights.len().is_multiple_of(channels[number]), "input channels of layer {number}");
                weights.len() / channels[number]
            }
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

/// Copies columns of planes of `pixels` elements to panels; columns that the last panel lacks are zero.
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

dispatch! {
    /// The [`Product`] of a diagonal matrix: one factor for each row.
    ///
    /// # Safety
    /// As for [`multiply`].
    unsafe fn scale = scale_kernel(product: &Product)
}

#[inline(always)]
unsafe fn scale_kernel<S: Simd>(s: S, product: &Product) {
    // SAFETY: the caller's promise.
    unsafe {
        let width = product.right_panel / product.depth;
        for panel in 0..product.columns.div_ceil(width) {
            let columns = width.min(product.columns - panel * width);
            for row in 0..product.rows {
                let factor = s.splat(*product.left.add(row));
                let start = match product.start {
                    Start::PerRow(start) => s.splat(*start.add(row)),
                    Start::Zero | Start::Output => s.splat(0.0),
                };
                let right = product.right.add(panel * product.right_panel + row * width);
                let out = product.out.add(panel * product.out_steps.panel + row * product.out_steps.row);
                for x in (0..columns).step_by(S::LANES) {
                    let lanes = S::LANES.min(columns - x);
                    let mut sum = s.mul_add(factor, s.load(right.add(x)), start);
                    if let Some((add, steps)) = product.add {
                        let add = add.add(panel * steps.panel + row * steps.row + x);
                        sum = s.add(sum, s.load_first(add, lanes));
                    }
                    let value = product.activation.apply(s, sum);
                    if lanes == S::LANES {
                        s.store(out.add(x), value)
                    } else {
                        s.store_first(out.add(x), value, lanes)
                    }
                }
            }
        }
    }
}

#[cfg(test)]
mod tests;
