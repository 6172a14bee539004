//! Attention on tensors: [`Attention`], with gradients.

use std::sync::{Arc, Mutex, OnceLock, PoisonError};

use burn::backend::autodiff::checkpoint::{base::Checkpointer, strategy::CheckpointStrategy};
use burn::backend::autodiff::grads::Gradients;
use burn::backend::autodiff::ops::{Backward, Ops, OpsKind};
use burn::backend::tensor::FloatTensor;
use burn::backend::{Autodiff, Backend, Dispatch, Flex, TensorMetadata, backend_extension};
use burn::tensor::activation::softmax;
use burn::tensor::{Device, Tensor};
use rayon::prelude::*;
use srflow_simd::Isa;

use super::backward::Gathered;
use super::weights::AttentionWeights;
use crate::conv2d::tensor::{Conv2dOptions, Epilogue, conv2d};
use crate::flex::{Contiguous, sizes, tensor};
use crate::gradients;

/// The largest piece of the matrix of all pairs, where it is computed as a matrix.
const PIECE_BYTES: usize = 64 << 20;

/// What the kernel found out about queries and keys, once for all values, and what it needs for their gradients.
#[derive(Debug, Clone)]
pub struct Prepared {
    kept_bytes: usize,
    images: Arc<OnceLock<Images>>,
    /// Of every gathering whose gradient has come.
    gathered: Arc<Mutex<Vec<[FloatTensor<Flex>; 3]>>>,
}

#[derive(Debug)]
struct Images {
    queries: FloatTensor<Flex>,
    keys: FloatTensor<Flex>,
    weights: Vec<AttentionWeights>,
}

/// The kernel.
#[backend_extension(Flex, Autodiff)]
pub trait AttentionOps: Backend {
    /// Prepares gathering by queries and keys, `[batch, channels, height, width]` each. The number returned stands for the
    /// weights where gradients are tracked, and is zero.
    fn attention_weights(
        queries: FloatTensor<Self>,
        keys: FloatTensor<Self>,
        prepared: Prepared,
    ) -> FloatTensor<Self>;

    /// `weights` are those that `prepared` was prepared with.
    fn gather_by_attention(
        weights: FloatTensor<Self>,
        values: FloatTensor<Self>,
        prepared: Prepared,
    ) -> FloatTensor<Self>;
}

/// Gradients of the kernel. Those of the weights are never formed: what they follow from is collected until all has been
/// gathered.
pub trait AttentionGradOps: Backend {
    /// Gradient of the values. Where queries or keys want one too (`collect`), what it needs is set aside.
    fn gather_by_attention_grad(
        values: FloatTensor<Self>,
        gathered: FloatTensor<Self>,
        grad: FloatTensor<Self>,
        prepared: Prepared,
        collect: bool,
    ) -> FloatTensor<Self>;

    /// Gradients of queries and keys, from what was set aside.
    fn attention_weights_grad(prepared: Prepared) -> (FloatTensor<Self>, FloatTensor<Self>);
}

impl Images {
    /// `of` the queries, the keys, the weights and the number of each image.
    fn map<T: Send>(&self, of: impl Fn([&[f32]; 2], &AttentionWeights, usize) -> T + Sync) -> Vec<T> {
        let (queries, keys) = (Contiguous::new(&self.queries), Contiguous::new(&self.keys));
        let image = queries.slice().len() / self.weights.len();
        let pairs = queries.slice().par_chunks_exact(image).zip(keys.slice().par_chunks_exact(image));
        let images = pairs.zip(&self.weights).enumerate();
        images.map(|(number, ((queries, keys), weights))| of([queries, keys], weights, number)).collect()
    }
}

impl Prepared {
    fn new(kept_bytes: usize) -> Self {
        Self { kept_bytes, images: Arc::default(), gathered: Arc::default() }
    }

    fn images(&self) -> &Images {
        self.images.get().expect("gathering follows the weights it goes by")
    }
}

/// Image number `n` of a tensor of `batch` images.
fn image(tensor: &Contiguous, batch: usize, n: usize) -> &[f32] {
    let len = tensor.slice().len() / batch;
    &tensor.slice()[n * len..][..len]
}

impl AttentionOps for Flex {
    fn attention_weights(
        queries: FloatTensor<Self>,
        keys: FloatTensor<Self>,
        prepared: Prepared,
    ) -> FloatTensor<Self> {
        let [batch, _, height, width] = sizes(&queries);
        prepared.images.get_or_init(|| {
            let (q, k) = (Contiguous::new(&queries), Contiguous::new(&keys));
            let kept_bytes = prepared.kept_bytes / batch;
            let weights = |n| {
                let (queries, keys) = (image(&q, batch, n), image(&k, batch, n));
                AttentionWeights::new(Isa::best(), queries, keys, height * width, kept_bytes)
            };
            let weights = (0..batch).into_par_iter().map(weights).collect();
            Images { queries, keys, weights }
        });
        tensor(vec![0.0], [1])
    }

    fn gather_by_attention(
        _weights: FloatTensor<Self>,
        values: FloatTensor<Self>,
        prepared: Prepared,
    ) -> FloatTensor<Self> {
        let shape = values.shape();
        let [batch, _, _, _] = sizes(&values);
        let values = Contiguous::new(&values);
        let weights = prepared.images().weights.par_iter().enumerate();
        let gathered: Vec<Vec<f32>> =
            weights.map(|(n, weights)| weights.gather(image(&values, batch, n))).collect();
        tensor(gathered.concat(), shape)
    }
}

impl AttentionGradOps for Flex {
    fn gather_by_attention_grad(
        values: FloatTensor<Self>,
        gathered: FloatTensor<Self>,
        grad: FloatTensor<Self>,
        prepared: Prepared,
        collect: bool,
    ) -> FloatTensor<Self> {
        let shape = values.shape();
        let [batch, _, _, _] = sizes(&values);
        let of_output = Contiguous::new(&grad);
        let of_values = prepared.images().map(|[queries, keys], weights, n| {
            weights.gather_backward(queries, keys, image(&of_output, batch, n))
        });
        if collect {
            let mut all = prepared.gathered.lock().unwrap_or_else(PoisonError::into_inner);
            all.push([values, gathered, grad]);
        }
        tensor(of_values.concat(), shape)
    }

    fn attention_weights_grad(prepared: Prepared) -> (FloatTensor<Self>, FloatTensor<Self>) {
        let all = std::mem::take(&mut *prepared.gathered.lock().unwrap_or_else(PoisonError::into_inner));
        let all: Vec<[Contiguous; 3]> =
            all.iter().map(|tensors| tensors.each_ref().map(Contiguous::new)).collect();
        let images = prepared.images();
        let gradients = images.map(|[queries, keys], weights, n| {
            let of_image = |tensor| image(tensor, images.weights.len(), n);
            let gathered: Vec<Gathered> = all
                .iter()
                .map(|[values, gathered, grad]| Gathered {
                    values: of_image(values),
                    gathered: of_image(gathered),
                    grad: of_image(grad),
                })
                .collect();
            weights.backward(queries, keys, &gathered)
        });
        let (of_queries, of_keys): (Vec<_>, Vec<_>) =
            gradients.into_iter().map(|[queries, keys]| (queries, keys)).unzip();
        let shape = images.queries.shape();
        (tensor(of_queries.concat(), shape.clone()), tensor(of_keys.concat(), shape))
    }
}

#[derive(Debug)]
struct WeightsBackward;

impl<B: AttentionGradOps> Backward<B, 2> for WeightsBackward {
    type State = Prepared;

    fn backward(self, ops: Ops<Prepared, 2>, grads: &mut Gradients, _: &mut Checkpointer) {
        gradients::register::<B, _, 2>(ops, grads, |prepared, _| B::attention_weights_grad(prepared).into());
    }
}

#[derive(Debug)]
struct GatherBackward;

impl<B: AttentionGradOps> Backward<B, 2> for GatherBackward {
    /// Weights, values and what was gathered of them.
    type State = ([FloatTensor<B>; 3], Prepared);

    fn backward(self, ops: Ops<Self::State, 2>, grads: &mut Gradients, _: &mut Checkpointer) {
        let grad = grads.consume::<B>(&ops.node);
        let ([weights, values, gathered], prepared) = ops.state;
        let [of_weights, of_values] = ops.parents;
        let d_values = B::gather_by_attention_grad(values, gathered, grad, prepared, of_weights.is_some());
        if let Some(node) = of_weights {
            // The zero that stands for the weights stands for their gradient as well.
            grads.register::<B>(node.id, weights);
        }
        if let Some(node) = of_values {
            grads.register::<B>(node.id, d_values);
        }
    }
}

impl<B: AttentionOps + AttentionGradOps, C: CheckpointStrategy> AttentionOps for Autodiff<B, C> {
    fn attention_weights(
        queries: FloatTensor<Self>,
        keys: FloatTensor<Self>,
        prepared: Prepared,
    ) -> FloatTensor<Self> {
        let guards = [queries.node(), keys.node()];
        let out = B::attention_weights(queries.into_primitive(), keys.into_primitive(), prepared.clone());
        match WeightsBackward.prepare::<C>(guards).compute_bound().stateful() {
            OpsKind::Tracked(prep) => prep.finish(prepared, out),
            OpsKind::UnTracked(prep) => prep.finish(out),
        }
    }

    fn gather_by_attention(
        weights: FloatTensor<Self>,
        values: FloatTensor<Self>,
        prepared: Prepared,
    ) -> FloatTensor<Self> {
        let guards = [weights.node(), values.node()];
        let (weights, values) = (weights.into_primitive(), values.into_primitive());
        let out = B::gather_by_attention(weights.clone(), values.clone(), prepared.clone());
        match GatherBackward.prepare::<C>(guards).compute_bound().stateful() {
            OpsKind::Tracked(prep) => prep.finish(([weights, values, out.clone()], prepared), out),
            OpsKind::UnTracked(prep) => prep.finish(out),
        }
    }
}

/// Which pixels of an image take how much of which: `softmax_j(q_i . k_j)`.
///
/// On the CPU the pairs are computed block by block in the cache, for the gradients once more. Elsewhere the matrix is cut
/// into pieces; with gradients all of them stand in memory, since backward needs them.
#[derive(Debug)]
pub struct Attention {
    size: [usize; 4],
    way: Way,
}

#[derive(Debug)]
enum Way {
    /// The tensor that stands for the weights.
    Kernel {
        weights: Box<Tensor<1>>,
        prepared: Prepared,
    },
    Pieces(Vec<ImagePieces>),
}

#[derive(Debug)]
struct ImagePieces {
    /// `[1, channels, 1, pixels]`.
    queries: Tensor<4>,
    /// As a weight: `[pixels, channels, 1, 1]`.
    keys: Tensor<4>,
    /// Pixels of a piece.
    piece: usize,
    /// Every piece, where all fit.
    kept: Vec<Tensor<4>>,
}

/// A product of matrices: `weight` `[outputs, inputs, 1, 1]`, `x` `[1, inputs, 1, columns]`.
fn product(x: Tensor<4>, weight: Tensor<4>) -> Tensor<4> {
    conv2d(x, weight, Epilogue::default(), Conv2dOptions::new([1, 1], [0, 0]))
}

impl Attention {
    /// From queries and keys, each `[batch, channels, height, width]`. Weights that take no more than `kept_bytes` are kept
    /// from one gathering to the next (with gradients elsewhere than on the CPU, all are). Panics when the sizes differ.
    pub fn new(queries: Tensor<4>, keys: Tensor<4>, kept_bytes: usize) -> Self {
        assert_eq!(queries.dims(), keys.dims(), "attention: as many keys as queries");
        let size @ [batch, _, _, _] = queries.dims();
        let autodiff = queries.is_autodiff() || keys.is_autodiff();
        let way = if queries.device() == Device::flex() {
            // The gradients of values want their weights in another order: half for each.
            let prepared = Prepared::new(if autodiff { kept_bytes / 2 } else { kept_bytes });
            let (queries, keys) = (queries.into_dispatch(), keys.into_dispatch());
            let weights = Dispatch::attention_weights(queries, keys, prepared.clone());
            Way::Kernel { weights: Box::new(Tensor::from_dispatch(weights)), prepared }
        } else {
            let kept_bytes = if autodiff { usize::MAX } else { kept_bytes / batch };
            let image = |n| {
                ImagePieces::new(queries.clone().narrow(0, n, 1), keys.clone().narrow(0, n, 1), kept_bytes)
            };
            Way::Pieces((0..batch).map(image).collect())
        };
        Self { size, way }
    }

    /// What each pixel gathers of `values`, `[batch, value channels, height, width]`. Panics when the sizes do not fit.
    pub fn gather(&self, values: Tensor<4>) -> Tensor<4> {
        let ([batch, _, height, width], [of, _, rows, columns]) = (self.size, values.dims());
        assert_eq!([of, rows, columns], [batch, height, width], "attention: values of the same pixels");
        match &self.way {
            Way::Kernel { weights, prepared } => Tensor::from_dispatch(Dispatch::gather_by_attention(
                weights.as_ref().clone().into_dispatch(),
                values.into_dispatch(),
                prepared.clone(),
            )),
            Way::Pieces(images) => {
                let images = images.iter().enumerate();
                let gathered = images.map(|(n, image)| image.gather(values.clone().narrow(0, n, 1)));
                Tensor::cat(gathered.collect(), 0)
            }
        }
    }
}

impl ImagePieces {
    fn new(queries: Tensor<4>, keys: Tensor<4>, kept_bytes: usize) -> Self {
        let [_, channels, height, width] = queries.dims();
        let pixels = height * width;
        let row_bytes = pixels * size_of::<f32>();
        let mut image = Self {
            queries: queries.reshape([1, channels, 1, pixels]),
            keys: keys.reshape([channels, pixels]).transpose().reshape([pixels, channels, 1, 1]),
            piece: (PIECE_BYTES / row_bytes).clamp(1, pixels),
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

    /// How much of each pixel goes to the pixels of piece `number`: `[1, pixels, 1, columns]`, columns summing to one.
    fn compute(&self, number: usize) -> Tensor<4> {
        let first = number * self.piece;
        let count = self.piece.min(self.queries.dims()[3] - first);
        let queries = self.queries.clone().narrow(3, first, count);
        softmax(product(queries, self.keys.clone()), 1)
    }

    /// `values` (`[1, channels, height, width]`), gathered.
    fn gather(&self, values: Tensor<4>) -> Tensor<4> {
        let dims @ [_, channels, height, width] = values.dims();
        let weight = values.reshape([channels, height * width, 1, 1]);
        let pieces = (0..self.pieces()).map(|number| {
            let weights = self.kept.get(number).cloned().unwrap_or_else(|| self.compute(number));
            product(weights, weight.clone())
        });
        Tensor::cat(pieces.collect(), 3).reshape(dims)
    }
}
