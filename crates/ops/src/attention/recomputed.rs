//! Attention with gradients composed of a backend's own operations, for devices without a kernel: the weights of some queries at a time,
//! computed for the forward pass and once more for the gradients, so that the matrix of all pairs never stands in memory.

use burn::backend::tensor::FloatTensor;
use burn::backend::{Backend, Flex, TensorMetadata};
use burn::tensor::Shape;

use crate::flex::CpuTensor;
use crate::operation::{Backprop, Composition, Operation, narrow};

/// Gathers values by queries and keys.
#[derive(Debug, Clone)]
pub(super) struct GatherInPieces {
    /// What the weights of a piece may take.
    pub piece_bytes: usize,
}

/// The logarithms of the sums, by queries and keys.
#[derive(Debug, Clone)]
pub(super) struct LogSumsInPieces {
    /// What the weights of a piece may take.
    pub piece_bytes: usize,
}

/// Maps as matrices, `[batch, channels, pixels]`, and the queries divided into pieces.
struct Pieces<B: Backend> {
    queries: FloatTensor<B>,
    keys: FloatTensor<B>,
    /// Queries in a piece.
    length: usize,
    pixels: usize,
}

fn matrix<B: Backend>(map: FloatTensor<B>) -> FloatTensor<B> {
    let [batch, channels, height, width] = map.shape().dims();
    B::float_reshape(map, [batch, channels, height * width].into())
}

fn transposed<B: Backend>(x: FloatTensor<B>) -> FloatTensor<B> {
    B::float_swap_dims(x, 1, 2)
}

impl<B: Backend> Pieces<B> {
    fn new(queries: FloatTensor<B>, keys: FloatTensor<B>, piece_bytes: usize) -> Self {
        let (queries, keys) = (matrix::<B>(queries), matrix::<B>(keys));
        let [batch, _, pixels] = keys.shape().dims();
        let length = (piece_bytes / (batch * pixels * size_of::<f32>())).clamp(1, pixels);
        Self { queries, keys, length, pixels }
    }

    /// A piece of the columns of a matrix.
    fn columns(&self, matrix: &FloatTensor<B>, first: usize) -> FloatTensor<B> {
        narrow::<B>(matrix.clone(), 2, first, self.length.min(self.pixels - first))
    }

    /// `[batch, queries, keys]`.
    fn scores(&self, first: usize) -> FloatTensor<B> {
        B::float_matmul(transposed::<B>(self.columns(&self.queries, first)), self.keys.clone())
    }

    /// The columns that `of` gives for the first query of each piece, one beside the other.
    fn joined(&self, of: impl FnMut(usize) -> FloatTensor<B>) -> FloatTensor<B> {
        B::float_cat((0..self.pixels).step_by(self.length).map(of).collect(), 2)
    }

    /// Gradients of queries and keys, as matrices, from those of the scores of each piece, given its first query and weights.
    fn backward(
        &self,
        mut of_scores: impl FnMut(usize, FloatTensor<B>) -> FloatTensor<B>,
    ) -> [FloatTensor<B>; 2] {
        let mut of_keys: Option<FloatTensor<B>> = None;
        let of_queries = self.joined(|first| {
            let of_scores = of_scores(first, B::softmax(self.scores(first), 2));
            let more = B::float_matmul(self.columns(&self.queries, first), of_scores.clone());
            of_keys = Some(match of_keys.take() {
                Some(sum) => B::float_add(sum, more),
                None => more,
            });
            B::float_matmul(self.keys.clone(), transposed::<B>(of_scores))
        });
        let of_keys = of_keys.unwrap_or_else(|| unreachable!("an image has pixels"));
        [of_queries, of_keys]
    }
}

impl Composition<3> for GatherInPieces {
    fn composed<B: Backend>(&self, [queries, keys, values]: [FloatTensor<B>; 3]) -> Vec<FloatTensor<B>> {
        let shape = values.shape();
        let (pieces, values) = (Pieces::<B>::new(queries, keys, self.piece_bytes), matrix::<B>(values));
        let gathered = pieces.joined(|first| {
            let weights = B::softmax(pieces.scores(first), 2);
            B::float_matmul(values.clone(), transposed::<B>(weights))
        });
        vec![B::float_reshape(gathered, shape)]
    }

    fn composed_backward<B: Backend>(&self, back: Backprop<FloatTensor<B>>) -> [Option<FloatTensor<B>>; 3] {
        let ([queries, keys, values, gathered], grad) = back.into_parts();
        let shapes = [queries.shape(), values.shape()];
        // The mean of the gradients of a query's weights, by these weights.
        let means = B::float_sum_dim(matrix::<B>(B::float_mul(grad.clone(), gathered)), 1);
        let pieces = Pieces::<B>::new(queries, keys, self.piece_bytes);
        let [values, grad] = [values, grad].map(matrix::<B>);
        let mut of_values: Option<FloatTensor<B>> = None;
        let [of_queries, of_keys] = pieces.backward(|first, weights| {
            let grad = pieces.columns(&grad, first);
            let more = B::float_matmul(grad.clone(), weights.clone());
            of_values = Some(match of_values.take() {
                Some(sum) => B::float_add(sum, more),
                None => more,
            });
            let of_weights = B::float_matmul(transposed::<B>(grad), values.clone());
            let mean = transposed::<B>(pieces.columns(&means, first));
            B::float_mul(weights, B::float_sub(of_weights, mean))
        });
        let like = |x, shape: &Shape| B::float_reshape(x, shape.clone());
        [
            Some(like(of_queries, &shapes[0])),
            Some(like(of_keys, &shapes[0])),
            of_values.map(|of_values| like(of_values, &shapes[1])),
        ]
    }
}

impl Operation<3> for GatherInPieces {
    fn saved_outputs<T>(outputs: &[T]) -> &[T] {
        outputs
    }

    fn cpu(&self, inputs: [CpuTensor; 3]) -> Vec<CpuTensor> {
        self.composed::<Flex>(inputs.map(CpuTensor::into)).into_iter().map(CpuTensor::from).collect()
    }

    fn cpu_backward(&self, back: Backprop<CpuTensor>) -> [Option<CpuTensor>; 3] {
        self.composed_backward::<Flex>(back.map(CpuTensor::into))
            .map(|gradient| gradient.map(CpuTensor::from))
    }
}

impl Composition<2> for LogSumsInPieces {
    fn composed<B: Backend>(&self, [queries, keys]: [FloatTensor<B>; 2]) -> Vec<FloatTensor<B>> {
        let [batch, _, height, width] = queries.shape().dims();
        let pieces = Pieces::<B>::new(queries, keys, self.piece_bytes);
        let log_sums = pieces.joined(|first| {
            let scores = pieces.scores(first);
            let largest = B::float_max_dim(scores.clone(), 2);
            let sums = B::float_sum_dim(B::float_exp(B::float_sub(scores, largest.clone())), 2);
            transposed::<B>(B::float_add(B::float_log(sums), largest))
        });
        vec![B::float_reshape(log_sums, [batch, 1, height, width].into())]
    }

    fn composed_backward<B: Backend>(&self, back: Backprop<FloatTensor<B>>) -> [Option<FloatTensor<B>>; 2] {
        let ([queries, keys], grad) = back.into_parts();
        let (shape, grad) = (queries.shape(), matrix::<B>(grad));
        let pieces = Pieces::<B>::new(queries, keys, self.piece_bytes);
        let gradients = pieces
            .backward(|first, weights| B::float_mul(weights, transposed::<B>(pieces.columns(&grad, first))));
        gradients.map(|gradient| Some(B::float_reshape(gradient, shape.clone())))
    }
}

impl Operation<2> for LogSumsInPieces {
    fn cpu(&self, inputs: [CpuTensor; 2]) -> Vec<CpuTensor> {
        self.composed::<Flex>(inputs.map(CpuTensor::into)).into_iter().map(CpuTensor::from).collect()
    }

    fn cpu_backward(&self, back: Backprop<CpuTensor>) -> [Option<CpuTensor>; 2] {
        self.composed_backward::<Flex>(back.map(CpuTensor::into))
            .map(|gradient| gradient.map(CpuTensor::from))
    }
}
