//! Attention with gradients composed of a backend's own operations, for devices without a kernel: the weights of some queries at a time,
//! computed for the forward pass and once more for the gradients, so that the matrix of all pairs never stands in memory.

#[cfg(feature = "cube")]
use burn::backend::ops::FloatTensorOps as _;
use burn::backend::tensor::FloatTensor;
use burn::backend::{Backend, Flex, TensorMetadata};
use burn::tensor::Shape;
#[cfg(feature = "cube")]
use burn_cubecl::{CubeBackend, tensor::CubeTensor};

#[cfg(feature = "cube")]
use super::composed::weight_scale;
#[cfg(feature = "cube")]
use crate::cube::{magnified, product};
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

/// Of matrices, `[batch, rows, columns]`.
type Product<B> = fn(FloatTensor<B>, FloatTensor<B>) -> FloatTensor<B>;

/// Products where a device may multiply numbers of 16 bits.
struct Products<B: Backend> {
    of_values: Product<B>,
    /// Of which the first may be small: a gradient.
    of_gradients: Product<B>,
    /// Of values or a gradient, and weights, of which any may be small, but not all of a sum.
    of_weights: Product<B>,
}

impl<B: Backend> Products<B> {
    /// In `f32`.
    fn plain() -> Self {
        Self { of_values: B::float_matmul, of_gradients: B::float_matmul, of_weights: B::float_matmul }
    }
}

#[cfg(feature = "cube")]
impl Products<CubeBackend> {
    /// At the precision of the thread.
    fn at_precision() -> Self {
        Self {
            of_values: product,
            of_gradients: |grad, other| magnified(grad, |grad| product(grad, other)),
            of_weights: |of, weights| {
                let scale = weight_scale();
                if scale == 1.0 {
                    return product(of, weights);
                }
                let weights = CubeBackend::float_mul_scalar(weights, scale.into());
                let sums = magnified(of, |of| product(of, weights));
                CubeBackend::float_mul_scalar(sums, scale.recip().into())
            },
        }
    }
}

/// Maps as matrices, `[batch, channels, pixels]`, and the queries divided into pieces.
struct Pieces<B: Backend> {
    products: Products<B>,
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
    fn new(products: Products<B>, queries: FloatTensor<B>, keys: FloatTensor<B>, piece_bytes: usize) -> Self {
        let (queries, keys) = (matrix::<B>(queries), matrix::<B>(keys));
        let [batch, _, pixels] = keys.shape().dims();
        let length = (piece_bytes / (batch * pixels * size_of::<f32>())).clamp(1, pixels);
        Self { products, queries, keys, length, pixels }
    }

    /// A piece of the columns of a matrix.
    fn columns(&self, matrix: &FloatTensor<B>, first: usize) -> FloatTensor<B> {
        narrow::<B>(matrix.clone(), 2, first, self.length.min(self.pixels - first))
    }

    /// `[batch, queries, keys]`.
    fn scores(&self, first: usize) -> FloatTensor<B> {
        (self.products.of_values)(transposed::<B>(self.columns(&self.queries, first)), self.keys.clone())
    }

    /// The transpose of a gradient times another matrix.
    fn of_gradients(&self, grad: FloatTensor<B>, other: FloatTensor<B>) -> FloatTensor<B> {
        transposed::<B>((self.products.of_gradients)(grad, other))
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
            let to_keys = transposed::<B>(of_scores.clone());
            let more = self.of_gradients(to_keys, transposed::<B>(self.columns(&self.queries, first)));
            of_keys = Some(match of_keys.take() {
                Some(sum) => B::float_add(sum, more),
                None => more,
            });
            self.of_gradients(of_scores, transposed::<B>(self.keys.clone()))
        });
        let of_keys = of_keys.unwrap_or_else(|| unreachable!("an image has pixels"));
        [of_queries, of_keys]
    }
}

impl GatherInPieces {
    fn gathered<B: Backend>(
        &self,
        products: Products<B>,
        [queries, keys, values]: [FloatTensor<B>; 3],
    ) -> Vec<FloatTensor<B>> {
        let shape = values.shape();
        let (pieces, values) = (Pieces::new(products, queries, keys, self.piece_bytes), matrix::<B>(values));
        let gathered = pieces.joined(|first| {
            let weights = B::softmax(pieces.scores(first), 2);
            (pieces.products.of_weights)(values.clone(), transposed::<B>(weights))
        });
        vec![B::float_reshape(gathered, shape)]
    }

    fn gradients<B: Backend>(
        &self,
        products: Products<B>,
        back: Backprop<FloatTensor<B>>,
    ) -> [Option<FloatTensor<B>>; 3] {
        let ([queries, keys, values, gathered], grad) = back.into_parts();
        let shapes = [queries.shape(), values.shape()];
        // The mean of the gradients of a query's weights, by these weights.
        let means = B::float_sum_dim(matrix::<B>(B::float_mul(grad.clone(), gathered)), 1);
        let pieces = Pieces::new(products, queries, keys, self.piece_bytes);
        let [values, grad] = [values, grad].map(matrix::<B>);
        let mut of_values: Option<FloatTensor<B>> = None;
        let [of_queries, of_keys] = pieces.backward(|first, weights| {
            let grad = pieces.columns(&grad, first);
            let more = (pieces.products.of_weights)(grad.clone(), weights.clone());
            of_values = Some(match of_values.take() {
                Some(sum) => B::float_add(sum, more),
                None => more,
            });
            let of_weights = (pieces.products.of_gradients)(transposed::<B>(grad), values.clone());
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

impl Composition<3> for GatherInPieces {
    fn composed<B: Backend>(&self, inputs: [FloatTensor<B>; 3]) -> Vec<FloatTensor<B>> {
        self.gathered(Products::<B>::plain(), inputs)
    }

    fn composed_backward<B: Backend>(&self, back: Backprop<FloatTensor<B>>) -> [Option<FloatTensor<B>>; 3] {
        self.gradients(Products::<B>::plain(), back)
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

    #[cfg(feature = "cube")]
    fn cube(&self, inputs: [CubeTensor; 3]) -> Vec<CubeTensor> {
        self.gathered(Products::at_precision(), inputs)
    }

    #[cfg(feature = "cube")]
    fn cube_backward(&self, back: Backprop<CubeTensor>) -> [Option<CubeTensor>; 3] {
        self.gradients(Products::at_precision(), back)
    }
}

impl LogSumsInPieces {
    fn log_sums<B: Backend>(
        &self,
        products: Products<B>,
        [queries, keys]: [FloatTensor<B>; 2],
    ) -> Vec<FloatTensor<B>> {
        let [batch, _, height, width] = queries.shape().dims();
        let pieces = Pieces::new(products, queries, keys, self.piece_bytes);
        let log_sums = pieces.joined(|first| {
            let scores = pieces.scores(first);
            let largest = B::float_max_dim(scores.clone(), 2);
            let sums = B::float_sum_dim(B::float_exp(B::float_sub(scores, largest.clone())), 2);
            transposed::<B>(B::float_add(B::float_log(sums), largest))
        });
        vec![B::float_reshape(log_sums, [batch, 1, height, width].into())]
    }

    fn gradients<B: Backend>(
        &self,
        products: Products<B>,
        back: Backprop<FloatTensor<B>>,
    ) -> [Option<FloatTensor<B>>; 2] {
        let ([queries, keys], grad) = back.into_parts();
        let (shape, grad) = (queries.shape(), matrix::<B>(grad));
        let pieces = Pieces::new(products, queries, keys, self.piece_bytes);
        let gradients = pieces
            .backward(|first, weights| B::float_mul(weights, transposed::<B>(pieces.columns(&grad, first))));
        gradients.map(|gradient| Some(B::float_reshape(gradient, shape.clone())))
    }
}

impl Composition<2> for LogSumsInPieces {
    fn composed<B: Backend>(&self, inputs: [FloatTensor<B>; 2]) -> Vec<FloatTensor<B>> {
        self.log_sums(Products::<B>::plain(), inputs)
    }

    fn composed_backward<B: Backend>(&self, back: Backprop<FloatTensor<B>>) -> [Option<FloatTensor<B>>; 2] {
        self.gradients(Products::<B>::plain(), back)
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

    #[cfg(feature = "cube")]
    fn cube(&self, inputs: [CubeTensor; 2]) -> Vec<CubeTensor> {
        self.log_sums(Products::at_precision(), inputs)
    }

    #[cfg(feature = "cube")]
    fn cube_backward(&self, back: Backprop<CubeTensor>) -> [Option<CubeTensor>; 2] {
        self.gradients(Products::at_precision(), back)
    }
}
