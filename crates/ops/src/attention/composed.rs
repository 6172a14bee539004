//! Attention without gradients composed of Burn's operations, for devices without a kernel: the matrix of all pairs, cut into pieces.

use burn::tensor::Tensor;
use burn::tensor::activation::softmax;

use crate::conv2d::tensor::{Conv2dOptions, Epilogue, conv2d};
use crate::precision::{Precision, precision};

/// What weights are multiplied by before they are rounded to the precision of this thread: among many keys each may be less than the
/// smallest number of `f16` that every device keeps, 6e-5.
pub(super) fn weight_scale() -> f32 {
    if precision() == Precision::F16 { 32768.0 } else { 1.0 }
}

#[derive(Debug)]
pub(super) struct ImagePieces {
    /// `[1, channels, 1, pixels]`.
    queries: Tensor<4>,
    /// Reshaped to a convolution weight, `[pixels, channels, 1, 1]`.
    keys: Tensor<4>,
    /// Pixels in a piece.
    piece: usize,
    /// Of [`weight_scale`], when they were computed.
    scale: f32,
    /// All pieces, if they fit in memory.
    kept: Vec<Tensor<4>>,
}

/// Matrix product: `weight` `[outputs, inputs, 1, 1]`, `x` `[1, inputs, 1, columns]`.
fn product(x: Tensor<4>, weight: Tensor<4>) -> Tensor<4> {
    conv2d(x, weight, Epilogue::default(), Conv2dOptions::new([1, 1], [0, 0]))
}

impl ImagePieces {
    /// Pieces take no more than `piece_bytes`, but each has a column.
    pub(super) fn new(queries: Tensor<4>, keys: Tensor<4>, kept_bytes: usize, piece_bytes: usize) -> Self {
        let [_, channels, height, width] = queries.dims();
        let pixels = height * width;
        let row_bytes = pixels * size_of::<f32>();
        let mut image = Self {
            queries: queries.reshape([1, channels, 1, pixels]),
            keys: keys.reshape([channels, pixels]).transpose().reshape([pixels, channels, 1, 1]),
            piece: (piece_bytes / row_bytes).clamp(1, pixels),
            scale: weight_scale(),
            kept: Vec::new(),
        };
        if pixels * row_bytes <= kept_bytes {
            image.kept = (0..image.pieces()).map(|number| image.compute(number)).collect();
        }
        image
    }

    fn pieces(&self) -> usize {
        self.queries.dims()[3].div_ceil(self.piece)
    }

    /// Attention weights of the pixels of piece `number`: `[1, pixels, 1, columns]`, columns summing to `scale`.
    fn compute(&self, number: usize) -> Tensor<4> {
        let weights = softmax(self.scores(number), 1);
        if self.scale == 1.0 { weights } else { weights * self.scale }
    }

    /// `[1, pixels, 1, columns]`.
    fn scores(&self, number: usize) -> Tensor<4> {
        let first = number * self.piece;
        let count = self.piece.min(self.queries.dims()[3] - first);
        product(self.queries.clone().narrow(3, first, count), self.keys.clone())
    }

    /// `[1, 1, 1, pixels]`.
    pub(super) fn log_sums(&self) -> Tensor<4> {
        let of_piece = |number| {
            let scores = self.scores(number);
            let largest = scores.clone().max_dim(1);
            (scores - largest.clone()).exp().sum_dim(1).log() + largest
        };
        Tensor::cat((0..self.pieces()).map(of_piece).collect(), 3)
    }

    /// Applies the weights to `values` (`[1, channels, height, width]`).
    pub(super) fn gather(&self, values: Tensor<4>) -> Tensor<4> {
        let dims @ [_, channels, height, width] = values.dims();
        let weight = values.reshape([channels, height * width, 1, 1]);
        let pieces = (0..self.pieces()).map(|number| {
            let weights = self.kept.get(number).cloned().unwrap_or_else(|| self.compute(number));
            product(weights, weight.clone())
        });
        let gathered = Tensor::cat(pieces.collect(), 3).reshape(dims);
        if self.scale == 1.0 { gathered } else { gathered / self.scale }
    }
}
