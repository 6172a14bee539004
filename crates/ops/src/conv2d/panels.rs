//! Convolution as a matrix product whose right side, the inputs under each tap, is built panel by panel and never stored as a
//! whole.

use std::ops::Range;

use srflow_simd::{Isa, Left, Product, Right, Scratch, Start, Steps, fill_columns, multiply, panel_columns};

use super::Epilogue;
use crate::convolution::Conv2dShape;

/// Sizes of a convolution whose output may begin and end anywhere, and what it reads. Layouts as in [`Conv2dShape`].
#[derive(Debug, Clone, Copy)]
pub(super) struct Reads {
    pub(super) batch: usize,
    pub(super) in_channels: usize,
    pub(super) out_channels: usize,
    pub(super) input: [usize; 2],
    pub(super) kernel: [usize; 2],
    pub(super) stride: [usize; 2],
    /// Row and column of the input under the first tap of the first output pixel. All outside of the input is zero.
    pub(super) origin: [isize; 2],
    pub(super) output: [usize; 2],
}

impl Reads {
    /// Of an ordinary convolution.
    pub(super) fn of(shape: &Conv2dShape) -> Self {
        Self {
            batch: shape.batch,
            in_channels: shape.in_channels,
            out_channels: shape.out_channels,
            input: shape.input,
            kernel: shape.kernel,
            stride: shape.stride,
            origin: shape.padding.map(|zeros| -(zeros as isize)),
            output: shape.output(),
        }
    }

    /// Products of an output element.
    fn depth(&self) -> usize {
        self.in_channels * self.kernel[0] * self.kernel[1]
    }
}

/// Convolution with weights `[out_channels, in_channels * taps]`, then the epilogue.
pub(super) fn convolve(
    isa: Isa,
    input: &[f32],
    weights: Left,
    epilogue: &Epilogue,
    reads: &Reads,
) -> Vec<f32> {
    let pixels = reads.output[0] * reads.output[1];
    let depth = reads.depth();
    let panel = panel_columns(isa);
    let image = reads.in_channels * reads.input[0] * reads.input[1];
    let scratch = || Scratch::of(depth * panel);
    fill_columns(isa, [reads.batch, reads.out_channels, pixels], panel, scratch, |taps, n, own, out| {
        gather(&input[n * image..][..image], reads, own.clone(), panel, taps);
        let at = n * reads.out_channels * pixels + own.start;
        let product = Product {
            left: weights,
            rows: reads.out_channels,
            depth,
            right: Right::F32(taps),
            right_panel: depth * panel,
            start: epilogue.bias.map_or(Start::Zero, Start::PerRow),
            add: epilogue.residual.map(|residual| (&residual[at..], Steps { row: pixels, panel })),
            activation: epilogue.activation,
            columns: own.len(),
        };
        multiply(isa, &product, out);
    })
}

/// What lies under each tap of each channel at some output pixels: `[in_channels * taps, columns]`.
fn gather(image: &[f32], reads: &Reads, pixels: Range<usize>, columns: usize, taps: &mut [f32]) {
    let [height, width] = reads.input;
    let [kernel_height, kernel_width] = reads.kernel;
    let out_width = reads.output[1];
    if taps.is_empty() {
        return;
    }
    let mut at = 0;
    while pixels.start + at < pixels.end {
        let (y, x) = ((pixels.start + at) / out_width, (pixels.start + at) % out_width);
        let len = (out_width - x).min(pixels.len() - at);
        for (row, to) in taps.chunks_exact_mut(kernel_width * columns).enumerate() {
            let (channel, ky) = (row / kernel_height, row % kernel_height);
            let row =
                (y * reads.stride[0] + ky).checked_add_signed(reads.origin[0]).filter(|&row| row < height);
            let source = row.map(|row| &image[(channel * height + row) * width..][..width]);
            for (kx, to) in to.chunks_exact_mut(columns).enumerate() {
                let to = &mut to[at..at + len];
                match source {
                    Some(source) => take(source, x, kx as isize + reads.origin[1], reads.stride[1], to),
                    None => to.fill(0.0),
                }
            }
        }
        at += len;
    }
}

/// The elements `column * stride + offset` of a row for the output columns from `x` on; zero outside of the row.
fn take(source: &[f32], x: usize, offset: isize, stride: usize, to: &mut [f32]) {
    // Columns from `x` to the first that reads at `place` or behind it.
    let before = |place: usize| {
        place.saturating_add_signed(offset.saturating_neg()).div_ceil(stride).saturating_sub(x).min(to.len())
    };
    let (first, end) = (before(0), before(source.len()));
    to[..first].fill(0.0);
    to[end..].fill(0.0);
    if first == end {
        return;
    }
    let source = &source[((x + first) * stride).saturating_add_signed(offset)..];
    match stride {
        1 => to[first..end].copy_from_slice(&source[..end - first]),
        2 => to[first..end].iter_mut().zip(source.chunks(2)).for_each(|(to, pair)| *to = pair[0]),
        _ => to[first..end].iter_mut().zip(source.iter().step_by(stride)).for_each(|(to, from)| *to = *from),
    }
}
