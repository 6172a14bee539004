//! Convolution as a matrix product whose right side, the inputs under each tap, is built panel by panel and never stored as a
//! whole.

use std::ops::Range;

use srflow_simd::{Isa, Product, Start, Steps, fill_columns, multiply, panel_columns};

use super::Epilogue;
use crate::convolution::Conv2dShape;

/// [`super::conv2d`] with weights `[out_channels, in_channels * taps]` in the order of [`srflow_simd::pack_rows`].
pub(super) fn convolve(
    isa: Isa,
    input: &[f32],
    packed: &[f32],
    epilogue: &Epilogue,
    shape: &Conv2dShape,
) -> Vec<f32> {
    let [height, width] = shape.output();
    let pixels = height * width;
    let depth = shape.in_channels * shape.taps();
    let panel = panel_columns(isa);
    let image = shape.in_channels * shape.input[0] * shape.input[1];
    let scratch = || vec![0.0; depth * panel];
    fill_columns(isa, [shape.batch, shape.out_channels, pixels], panel, scratch, |taps, n, own, out| {
        gather(&input[n * image..][..image], shape, own.clone(), panel, taps);
        let at = n * shape.out_channels * pixels + own.start;
        let product = Product {
            left: packed,
            rows: shape.out_channels,
            depth,
            right: taps,
            right_panel: depth * panel,
            start: epilogue.bias.map_or(Start::Zero, Start::PerRow),
            add: epilogue.residual.map(|residual| (&residual[at..], Steps { row: pixels, panel })),
            activation: epilogue.activation,
            columns: own.len(),
        };
        multiply(isa, &product, out);
    })
}

/// The inputs under each tap of each channel for some output pixels: `[in_channels * taps, columns]`.
fn gather(image: &[f32], shape: &Conv2dShape, pixels: Range<usize>, columns: usize, taps: &mut [f32]) {
    let [height, width] = shape.input;
    let [kernel_height, kernel_width] = shape.kernel;
    let out_width = shape.output()[1];
    let mut at = 0;
    while pixels.start + at < pixels.end {
        let (y, x) = ((pixels.start + at) / out_width, (pixels.start + at) % out_width);
        let len = (out_width - x).min(pixels.len() - at);
        for (row, to) in taps.chunks_exact_mut(kernel_width * columns).enumerate() {
            let (channel, ky) = (row / kernel_height, row % kernel_height);
            let row = (y * shape.stride[0] + ky).checked_sub(shape.padding[0]).filter(|&row| row < height);
            let source = row.map(|row| &image[(channel * height + row) * width..][..width]);
            for (kx, to) in to.chunks_exact_mut(columns).enumerate() {
                let to = &mut to[at..at + len];
                match source {
                    Some(source) => take(source, x, kx, shape.stride[1], shape.padding[1], to),
                    None => to.fill(0.0),
                }
            }
        }
        at += len;
    }
}

/// The elements of a row under tap `kx` for the output columns from `x`; zero outside the row.
fn take(source: &[f32], x: usize, kx: usize, stride: usize, padding: usize, to: &mut [f32]) {
    // Output column i reads source column i * stride + kx - padding.
    let first = padding.saturating_sub(kx).div_ceil(stride).saturating_sub(x).min(to.len());
    let end =
        (source.len() + padding).saturating_sub(kx).div_ceil(stride).saturating_sub(x).clamp(first, to.len());
    to[..first].fill(0.0);
    to[end..].fill(0.0);
    if first == end {
        return;
    }
    let source = &source[(x + first) * stride + kx - padding..];
    match stride {
        1 => to[first..end].copy_from_slice(&source[..end - first]),
        2 => to[first..end].iter_mut().zip(source.chunks(2)).for_each(|(to, pair)| *to = pair[0]),
        _ => to[first..end].iter_mut().zip(source.iter().step_by(stride)).for_each(|(to, from)| *to = *from),
    }
}
