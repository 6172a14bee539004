//! Attention on tensors: [`Attention`], with gradients.

use std::sync::{Arc, OnceLock};

use burn::backend::tensor::FloatTensor;
use burn::backend::{Backend, Dispatch, Flex, TensorMetadata, backend_extension};
use burn::tensor::activation::softmax;
use burn::tensor::{Device, Tensor};

use super::AttentionWeights;
use crate::conv2d::tensor::{Conv2dOptions, Finish, conv2d};
use crate::flex::{Contiguous, sizes, tensor};
use crate::simd::Isa;

/// The largest piece of the matrix of all pairs, where it is computed as a matrix.
const PIECE_BYTES: usize = 64 << 20;

/// What the kernel found out about queries and keys, once for all values.
#[derive(Debug, Clone)]
pub struct Prepared {
    kept_bytes: usize,
    images: Arc<OnceLock<Vec<AttentionWeights>>>,
}

/// The kernel.
#[backend_extension(Flex)]
pub trait AttentionOps: Backend {
    /// Queries and keys are `[batch, channels, height, width]`, the same in every call with one `prepared`.
    fn gather_by_attention(
        queries: FloatTensor<Self>,
        keys: FloatTensor<Self>,
        values: FloatTensor<Self>,
        prepared: Prepared,
    ) -> FloatTensor<Self>;
}

impl AttentionOps for Flex {
    fn gather_by_attention(
        queries: FloatTensor<Self>,
        keys: FloatTensor<Self>,
        values: FloatTensor<Self>,
        prepared: Prepared,
    ) -> FloatTensor<Self> {
        let [batch, _, height, width] = sizes(&queries);
        let pixels = height * width;
        let images = prepared.images.get_or_init(|| {
            let (queries, keys) = (Contiguous::new(&queries), Contiguous::new(&keys));
            let image = queries.slice().len() / batch;
            let pairs = queries.slice().chunks_exact(image).zip(keys.slice().chunks_exact(image));
            let kept_bytes = prepared.kept_bytes / batch;
            pairs.map(|(q, k)| AttentionWeights::new(Isa::best(), q, k, pixels, kept_bytes)).collect()
        });
        let shape = values.shape();
        let values = Contiguous::new(&values);
        let planes = values.slice().chunks_exact(values.slice().len() / batch);
        let gathered: Vec<Vec<f32>> = images.iter().zip(planes).map(|(image, v)| image.gather(v)).collect();
        tensor(gathered.concat(), shape)
    }
}

/// Which pixels of an image take how much of which: `softmax_j(q_i . k_j)`.
///
/// On the CPU, without gradients, the pairs are computed block by block in the cache. Elsewhere the matrix is cut into
/// pieces; with gradients all of them stand in memory, since backward needs them.
#[derive(Debug)]
pub struct Attention {
    size: [usize; 4],
    way: Way,
}

#[derive(Debug)]
enum Way {
    /// Queries and keys.
    Kernel {
        pairs: Box<[Tensor<4>; 2]>,
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
    conv2d(x, weight, Finish::default(), Conv2dOptions::new([1, 1], [0, 0]))
}

impl Attention {
    /// From queries and keys, each `[batch, channels, height, width]`. Weights that take no more than `kept_bytes` are kept
    /// from one gathering to the next (with gradients, all are). Panics when the sizes differ.
    pub fn new(queries: Tensor<4>, keys: Tensor<4>, kept_bytes: usize) -> Self {
        assert_eq!(queries.dims(), keys.dims(), "attention: as many keys as queries");
        let size @ [batch, _, _, _] = queries.dims();
        let autodiff = queries.is_autodiff() || keys.is_autodiff();
        let way = if !autodiff && queries.device() == Device::flex() {
            Way::Kernel {
                pairs: Box::new([queries, keys]),
                prepared: Prepared { kept_bytes, images: Arc::default() },
            }
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
            Way::Kernel { pairs, prepared } if !values.is_autodiff() => {
                let [queries, keys] = pairs.as_ref().clone();
                Tensor::from_dispatch(Dispatch::gather_by_attention(
                    queries.into_dispatch(),
                    keys.into_dispatch(),
                    values.into_dispatch(),
                    prepared.clone(),
                ))
            }
            // Constant queries and keys, but values with gradients.
            Way::Kernel { pairs, .. } => {
                let image = |n| {
                    let [queries, keys] = pairs.as_ref().clone().map(|x| x.narrow(0, n, 1));
                    ImagePieces::new(queries, keys, usize::MAX)
                };
                gather_from_pieces(&(0..batch).map(image).collect::<Vec<_>>(), values)
            }
            Way::Pieces(images) => gather_from_pieces(images, values),
        }
    }
}

fn gather_from_pieces(images: &[ImagePieces], values: Tensor<4>) -> Tensor<4> {
    let images = images.iter().enumerate();
    Tensor::cat(images.map(|(n, image)| image.gather(values.clone().narrow(0, n, 1))).collect(), 0)
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
