//! Global motion aggregation (Jiang et al. 2021, `gma_utils.py`): a pixel takes over the motion of pixels whose context is
//! like its own. One head, content only, as the published networks have it.
//!
//! The matrix of all pairs of pixels is cut into pieces of columns. It does not change between iterations: where it fits
//! into [`KEPT_BYTES`] its pieces are kept, else they are computed anew each time and never stand in memory together.

use burn::module::{Initializer, Module, Param};
use burn::tensor::activation::softmax;
use burn::tensor::{Device, Tensor};
use srflow_ops::Activation;

use super::{Conv2d, Conv2dConfig};
use srflow_ops::conv2d::tensor::{Conv2dOptions, Finish, conv2d};

/// The largest matrix that is kept, of all images together.
const KEPT_BYTES: usize = 256 << 20;
/// The largest piece.
const PIECE_BYTES: usize = 64 << 20;
/// Positions that the reference has an embedding for, in each direction.
const POSITIONS: usize = 2 * 160 - 1;

/// Which pixels resemble which (`att`).
#[derive(Module, Debug)]
pub(crate) struct Attention {
    to_qk: Conv2d,
    pos_emb: PositionEmbedding,
}

/// Stored in every checkpoint, used by none of the published networks.
#[derive(Module, Debug)]
struct PositionEmbedding {
    rel_height: Embedding,
    rel_width: Embedding,
}

#[derive(Module, Debug)]
struct Embedding {
    weight: Param<Tensor<2>>,
}

/// Adds what attention gathers to motion features (`update_block.aggregator`).
#[derive(Module, Debug)]
pub(crate) struct Aggregate {
    to_v: Conv2d,
    gamma: Param<Tensor<1>>,
}

/// The attention between the pixels of one context.
pub(crate) struct AttentionMap {
    images: Vec<ImageMap>,
}

struct ImageMap {
    /// `[1, dim, 1, pixels]`, scaled.
    queries: Tensor<4>,
    /// As a weight: `[pixels, dim, 1, 1]`.
    keys: Tensor<4>,
    piece: usize,
    /// Every piece, where all fit.
    kept: Vec<Tensor<4>>,
}

/// A product of matrices: `weight` `[outputs, inputs, 1, 1]`, `x` `[1, inputs, 1, columns]`.
fn product(x: Tensor<4>, weight: Tensor<4>) -> Tensor<4> {
    conv2d(x, weight, Finish::default(), Conv2dOptions { stride: [1, 1], padding: [0, 0] })
}

impl Attention {
    pub(crate) fn new(dim: usize, device: &Device) -> Self {
        let embedding = || Embedding {
            weight: Initializer::Normal { mean: 0.0, std: 1.0 }.init([POSITIONS, dim], device),
        };
        Self {
            to_qk: Conv2dConfig::new([dim, 2 * dim], [1, 1]).with_bias(false).init(device),
            pos_emb: PositionEmbedding { rel_height: embedding(), rel_width: embedding() },
        }
    }

    /// From the context, `[batch, dim, height, width]`.
    pub(crate) fn forward(&self, context: Tensor<4>) -> AttentionMap {
        let [batch, dim, height, width] = context.dims();
        let pixels = height * width;
        let both = self.to_qk.forward(context, Activation::Identity);
        let bytes = pixels * size_of::<f32>();
        let piece = (PIECE_BYTES / bytes).clamp(1, pixels);
        let images = (0..batch).map(|n| {
            let both = both.clone().narrow(0, n, 1);
            let queries = both.clone().narrow(1, 0, dim).reshape([1, dim, 1, pixels]);
            let keys = both.narrow(1, dim, dim).reshape([dim, pixels]).transpose();
            let mut image = ImageMap {
                queries: queries * (dim as f64).powf(-0.5),
                keys: keys.reshape([pixels, dim, 1, 1]),
                piece,
                kept: Vec::new(),
            };
            if batch * pixels * bytes <= KEPT_BYTES {
                image.kept = (0..image.pieces()).map(|number| image.compute(number)).collect();
            }
            image
        });
        AttentionMap { images: images.collect() }
    }
}

impl ImageMap {
    fn pieces(&self) -> usize {
        self.queries.dims()[3].div_ceil(self.piece)
    }

    /// How much of each pixel goes to the pixels of piece `number`: `[1, pixels, 1, columns]`, columns summing to one.
    fn compute(&self, number: usize) -> Tensor<4> {
        let first = number * self.piece;
        let columns = self.piece.min(self.queries.dims()[3] - first);
        let queries = self.queries.clone().narrow(3, first, columns);
        softmax(product(queries, self.keys.clone()), 1)
    }

    /// `values` (`[1, dim, height, width]`), gathered.
    fn gather(&self, values: Tensor<4>) -> Tensor<4> {
        let dims @ [_, dim, height, width] = values.dims();
        let weight = values.reshape([dim, height * width, 1, 1]);
        let pieces = (0..self.pieces()).map(|number| {
            let weights = self.kept.get(number).cloned().unwrap_or_else(|| self.compute(number));
            product(weights, weight.clone())
        });
        Tensor::cat(pieces.collect(), 3).reshape(dims)
    }
}

impl Aggregate {
    pub(crate) fn new(dim: usize, device: &Device) -> Self {
        Self {
            to_v: Conv2dConfig::new([dim, dim], [1, 1]).with_bias(false).init(device),
            gamma: Initializer::Zeros.init([1], device),
        }
    }

    /// `motion` and what is gathered of it, times a learned number.
    pub(crate) fn forward(&self, map: &AttentionMap, motion: Tensor<4>) -> Tensor<4> {
        let values = self.to_v.forward(motion.clone(), Activation::Identity);
        let images = map.images.iter().enumerate();
        let gathered = images.map(|(n, image)| image.gather(values.clone().narrow(0, n, 1))).collect();
        motion + Tensor::cat(gathered, 0) * self.gamma.val().reshape([1, 1, 1, 1])
    }
}
