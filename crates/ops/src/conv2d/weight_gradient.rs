//! The gradient of a convolution's weight: the matrix product of the output's gradient and the patches of the input.

use std::ops::Range;

use srflow_simd::{
    Activation, Isa, MAX_LANES, Packed, Precision, Product, Right, Scratch, Simd, Start, dispatch,
    fill_columns, multiply, panel_columns,
};

use super::forward::{Padded, possible};
use crate::convolution::Conv2dShape;
use crate::precision::cpu_precision;

/// Pixels whose products are accumulated before the sums are stored: a panel of patches must fit in the second-level cache.
const BLOCK_PIXELS: usize = 256;

/// Gradient of the weight given the input and `grad`, the gradient of the output; `[C_out, C_in, kernel]`.
///
/// Pixels are summed in blocks of fixed size, in order, so the result does not depend on the number of threads. Panics when the
/// length of a slice does not match `shape`.
pub fn conv2d_backward_weight(input: &[f32], grad: &[f32], shape: &Conv2dShape) -> Vec<f32> {
    backward_weight_with(Isa::best(), cpu_precision(), input, grad, shape)
}

/// [`conv2d_backward_weight`] with a chosen instruction set.
pub(super) fn backward_weight_with(
    isa: Isa,
    precision: Precision,
    input: &[f32],
    grad: &[f32],
    shape: &Conv2dShape,
) -> Vec<f32> {
    shape.check_dense();
    assert_eq!(input.len(), shape.input_len(), "input of {shape:?}");
    assert_eq!(grad.len(), shape.output_len(), "gradient of {shape:?}");
    if shape.weight_len() == 0 || grad.is_empty() {
        return vec![0.0; shape.weight_len()];
    }
    let patches = Patches::of(input, shape);
    let blocks = blocks(shape);
    let left = packed_gradient(
        isa,
        possible(precision, [shape.in_channels, shape.out_channels]),
        grad,
        shape,
        &blocks,
    );
    let columns = shape.in_channels * patches.taps.len();
    let width = panel_columns(isa);
    let longest = blocks.iter().map(Block::pixels).max().unwrap_or(0);
    fill_columns(
        isa,
        [1, shape.out_channels, columns],
        width,
        || Scratch::of(longest * width),
        |panel, _, own, out| {
            for (number, block) in blocks.iter().enumerate() {
                transpose(isa, &patches, block, own.clone(), width, panel);
                let product = Product {
                    left: left.part(number),
                    rows: shape.out_channels,
                    depth: block.pixels(),
                    right: Right::F32(panel),
                    right_panel: block.pixels() * width,
                    start: if number == 0 { Start::Zero } else { Start::Output },
                    add: None,
                    activation: Activation::Identity,
                    columns: own.len(),
                };
                multiply(isa, &product, out);
            }
        },
    )
}

/// Pixels of one image of the output.
struct Block {
    image: usize,
    rows: Range<usize>,
    columns: Range<usize>,
}

impl Block {
    fn pixels(&self) -> usize {
        self.rows.len() * self.columns.len()
    }
}

/// All pixels: short rows are grouped, long rows are split.
fn blocks(shape: &Conv2dShape) -> Vec<Block> {
    let [height, width] = shape.output();
    let rows_together = (BLOCK_PIXELS / width).max(1);
    let columns_together = width.min(BLOCK_PIXELS);
    let mut blocks = Vec::new();
    for image in 0..shape.batch {
        for top in (0..height).step_by(rows_together) {
            for left in (0..width).step_by(columns_together) {
                let rows = top..height.min(top + rows_together);
                let columns = left..width.min(left + columns_together);
                blocks.push(Block { image, rows, columns });
            }
        }
    }
    blocks
}

/// The output's gradient, block by block.
fn packed_gradient(
    isa: Isa,
    precision: Precision,
    grad: &[f32],
    shape: &Conv2dShape,
    blocks: &[Block],
) -> Packed {
    let [height, width] = shape.output();
    let channels = shape.out_channels;
    let depths: Vec<usize> = blocks.iter().map(Block::pixels).collect();
    Packed::parts(isa, precision, channels, &depths, |number, matrix| {
        let block = &blocks[number];
        let rows = matrix.chunks_exact_mut(block.columns.len());
        for (at, to) in rows.enumerate() {
            let (channel, row) = (at / block.rows.len(), block.rows.start + at % block.rows.len());
            let plane = &grad[(block.image * channels + channel) * height * width..][..height * width];
            to.copy_from_slice(&plane[row * width..][block.columns.clone()]);
        }
    })
}

/// The factors of the weight's elements: for each input channel and tap an image of the output's size.
struct Patches<'a> {
    padded: Padded<'a>,
    taps: Vec<usize>,
    source_row: usize,
}

impl<'a> Patches<'a> {
    fn of(input: &'a [f32], shape: &Conv2dShape) -> Self {
        let padded = Padded::of(input, shape);
        let taps = padded.taps(shape);
        let source_row = padded.row * shape.stride[0];
        Self { padded, taps, source_row }
    }

    /// Address of the first pixel of a row of the block in the image of a column (channel by channel, tap by tap).
    fn source(&self, block: &Block, row: usize, column: usize) -> *const f32 {
        let (channel, tap) = (column / self.taps.len(), column % self.taps.len());
        let start = block.image * self.padded.image
            + channel * self.padded.channel
            + row * self.source_row
            + self.taps[tap]
            + block.columns.start;
        self.padded.data()[start..start + block.columns.len()].as_ptr()
    }
}

dispatch! {
    /// The patches of `columns`, transposed: a row of `panel`, `width` elements long, for each pixel of the block.
    fn transpose = transpose_kernel(patches: &Patches, block: &Block, columns: Range<usize>, width: usize, panel: &mut [f32])
}

#[inline(always)]
fn transpose_kernel<S: Simd>(
    s: S,
    patches: &Patches,
    block: &Block,
    columns: Range<usize>,
    width: usize,
    panel: &mut [f32],
) {
    let pixels = block.columns.len();
    for (row, panel) in block.rows.clone().zip(panel.chunks_mut(pixels * width)) {
        let mut column = columns.start;
        while column < columns.end {
            let together = S::LANES.min(columns.end - column);
            let mut sources = [std::ptr::null(); MAX_LANES];
            for (i, source) in sources.iter_mut().enumerate().take(together) {
                *source = patches.source(block, row, column + i);
            }
            let mut pixel = 0;
            while pixel < pixels {
                let count = S::LANES.min(pixels - pixel);
                let to = &mut panel[pixel * width + column - columns.start..];
                if count == S::LANES && together == S::LANES {
                    let mut from = sources;
                    for from in from.iter_mut().take(together) {
                        // SAFETY: every source contains the row's pixels.
                        *from = unsafe { from.add(pixel) };
                    }
                    assert!(to.len() >= (S::LANES - 1) * width + S::LANES);
                    // SAFETY: as above, and the panel contains the square.
                    unsafe { s.transpose(&from, to.as_mut_ptr(), width) }
                } else {
                    for (i, source) in sources.iter().enumerate().take(together) {
                        for j in 0..count {
                            // SAFETY: as above.
                            to[j * width + i] = unsafe { *source.add(pixel + j) };
                        }
                    }
                }
                pixel += count;
            }
            column += together;
        }
    }
}
