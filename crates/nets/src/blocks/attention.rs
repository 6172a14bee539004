//! Global motion aggregation (Jiang et al. 2021, `gma_utils.py`): attention that propagates motion between pixels with similar
//! context. One head and content only, as in the published networks.

use burn::module::{Module, Param};
use burn::tensor::{Device, Tensor};
use srflow_nn::Initializer;
use srflow_nn::layers::{Conv2d, Conv2dConfig};
use srflow_ops::Activation;
use srflow_ops::attention::tensor::Attention as AttentionMap;

/// Attention weights, which are constant over the iterations, are kept up to this size. The rest is recomputed in each iteration.
pub(crate) const KEPT_BYTES: usize = 800 << 20;
/// The limit with gradients. It suffices for all weights at 256x192; at 800x512, where a map takes 164 MB and as much again for
/// the gradients of values, recomputing all weights takes about 2 % of a training step.
const KEPT_BYTES_IN_TRAINING: usize = 1 << 28;
/// Relative positions with an embedding in the reference, in each direction.
const POSITIONS: usize = 2 * 160 - 1;

/// Queries and keys of attention (`att`).
#[derive(Module, Debug)]
pub(crate) struct Attention {
    to_qk: Conv2d,
    pos_emb: PositionEmbedding,
}

/// Stored in every checkpoint, but not used by the published networks.
#[derive(Module, Debug)]
struct PositionEmbedding {
    rel_height: Embedding,
    rel_width: Embedding,
}

#[derive(Module, Debug)]
struct Embedding {
    weight: Param<Tensor<2>>,
}

/// Adds attention output to motion features (`update_block.aggregator`).
#[derive(Module, Debug)]
pub(crate) struct Aggregate {
    to_v: Conv2d,
    gamma: Param<Tensor<1>>,
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

    /// The attention of a context `[batch, dim, height, width]`.
    pub(crate) fn forward(&self, context: Tensor<4>) -> AttentionMap {
        let [queries, keys] = self.queries_and_keys(context);
        attention_map(queries, keys)
    }

    /// Queries, divided by the square root of `dim`, and keys, both `[batch, dim, height, width]`.
    pub(crate) fn queries_and_keys(&self, context: Tensor<4>) -> [Tensor<4>; 2] {
        let dim = context.dims()[1];
        let both = self.to_qk.forward(context, Activation::Identity);
        [both.clone().narrow(1, 0, dim) * (dim as f64).powf(-0.5), both.narrow(1, dim, dim)]
    }
}

/// Attention that keeps its weights, for use in several iterations.
pub(crate) fn attention_map(queries: Tensor<4>, keys: Tensor<4>) -> AttentionMap {
    let kept_bytes = if queries.is_autodiff() { KEPT_BYTES_IN_TRAINING } else { KEPT_BYTES };
    AttentionMap::new(queries, keys, kept_bytes)
}

impl Aggregate {
    pub(crate) fn new(dim: usize, device: &Device) -> Self {
        Self {
            to_v: Conv2dConfig::new([dim, dim], [1, 1]).with_bias(false).init(device),
            gamma: Initializer::Zeros.init([1], device),
        }
    }

    /// `motion + gamma * attention(values(motion))`.
    pub(crate) fn forward(&self, map: &AttentionMap, motion: Tensor<4>) -> Tensor<4> {
        let gathered = map.gather(self.values(motion.clone()));
        self.add(motion, gathered)
    }

    /// The values of `motion`.
    pub(crate) fn values(&self, motion: Tensor<4>) -> Tensor<4> {
        self.to_v.forward(motion, Activation::Identity)
    }

    /// `motion + gamma * gathered`.
    pub(crate) fn add(&self, motion: Tensor<4>, gathered: Tensor<4>) -> Tensor<4> {
        motion + gathered * self.gamma.val().reshape([1, 1, 1, 1])
    }
}
