//! MemFlow (Dong and Fu, CVPR 2024): <https://arxiv.org/abs/2404.04808>. SKFlow whose attention also covers earlier pairs of a
//! video. Its parameters have the names and shapes of SKFlow's. Parity with the reference: `PARITY.md`.

use burn::module::Module;
use burn::tensor::activation::{log_sigmoid, sigmoid};
use burn::tensor::{Device, Tensor};
use srflow_ops::attention::tensor::Attention as AttentionMap;

use crate::blocks::{Attention, Encoder, attention_map, convex_upsample};
use crate::estimate::Memory;
use crate::facts::{Facts, IterationPresets, ptlflow};
use crate::network::Entry;
use crate::raft::{HIDDEN, RADIUS};
use crate::recurrent::{self, Encoders, Recurrent, Refined};
use crate::settings::{Allowed, Setting};
use crate::skflow::{SkFlow, UpdateBlock};

pub(crate) const MEMFLOW: Entry<MemFlow> = Entry {
    facts: Facts {
        name: "memflow",
        title: "MemFlow",
        paper: "https://arxiv.org/abs/2404.04808",
        parameters: 6_273_149,
        iterations: IterationPresets { default: 15, authors: 15, training: 12 },
        remembers: true,
        memory: recurrent::ATTENDING,
        authors: "https://github.com/DQiaole/MemFlow",
        licence: "Apache-2.0",
        lookalikes: &["SKFlow"],
        ptlflow_prefix: "network.",
        published: &[
            ptlflow!("memflow", "things", "90d0b74c"),
            ptlflow!("memflow", "sintel", "38621d84"),
            ptlflow!("memflow", "kitti", "ee6cbf09"),
            ptlflow!("memflow", "spring", "7ee1b984"),
        ],
        ..recurrent::FACTS
    },
    init: MemFlow::new,
};

/// MemFlow with RAFT's encoders, not the variant MemFlow-T with those of Twins.
///
/// Its [`Memory`] consists of two tensors per pair, oldest pair first: keys and values, `[batch, 128, height / 8, width / 8]`.
#[derive(Module, Debug)]
pub struct MemFlow {
    fnet: Encoder,
    cnet: Encoder,
    update_block: UpdateBlock,
    att: Attention,
    train_avg_length: usize,
    remembered_pairs: usize,
}

impl MemFlow {
    pub(crate) fn new(device: &Device) -> Self {
        let SkFlow { fnet, cnet, update_block, att } = SkFlow::new(device);
        Self { fnet, cnet, update_block, att, train_avg_length: 6750, remembered_pairs: 2 }
    }

    /// Attention from the context of a pair to the pair itself and to the remembered pairs.
    fn attention(&self, context: Tensor<4>, memory: Option<&Memory>) -> Attended {
        let remembered = memory.map_or(&[][..], |Memory(tensors)| tensors);
        let pairs = remembered.as_chunks::<2>().0;
        let pairs = &pairs[pairs.len().saturating_sub(self.remembered_pairs)..];

        let [queries, keys] = self.att.queries_and_keys(context);
        let [_, _, height, width] = keys.dims();
        let tokens = (1 + pairs.len()) * height * width;
        let queries = queries * (tokens as f64).log(self.train_avg_length as f64);
        let of_pair = |[keys, values]: &[Tensor<4>; 2]| {
            // Used only once, so no weights need to be kept.
            let map = AttentionMap::new(queries.clone(), keys.clone(), 0);
            Gathered { values: map.gather(values.clone()), log_sums: map.log_sums() }
        };
        let earlier = pairs.iter().map(of_pair).reduce(Gathered::and);
        let map = attention_map(queries, keys.clone());
        let earlier = earlier.map(|earlier| {
            let share = sigmoid(map.log_sums() - earlier.log_sums);
            Earlier { values: earlier.values * (1.0 - share.clone()), share_of_pair: share }
        });
        let remembered = pairs.iter().flatten().cloned().collect();
        Attended { map, earlier, keys, remembered }
    }
}

/// Attention of a pair. Only the values of the pair itself change between iterations, so the output over earlier pairs is computed
/// once.
struct Attended {
    map: AttentionMap,
    earlier: Option<Earlier>,
    keys: Tensor<4>,
    remembered: Vec<Tensor<4>>,
}

/// Attention output over earlier pairs.
struct Earlier {
    /// Weighted by the total attention to earlier pairs.
    values: Tensor<4>,
    /// Total attention to the pair itself, `[batch, 1, height, width]`.
    share_of_pair: Tensor<4>,
}

/// Attention output over a set of pixels, and the logarithms of its softmax denominators.
struct Gathered {
    values: Tensor<4>,
    log_sums: Tensor<4>,
}

impl Gathered {
    /// The attention output over the pixels of both.
    fn and(self, other: Self) -> Self {
        let difference = self.log_sums.clone() - other.log_sums;
        let share = sigmoid(difference.clone());
        Self {
            values: self.values * share.clone() + other.values * (1.0 - share),
            log_sums: self.log_sums - log_sigmoid(difference),
        }
    }
}

impl Attended {
    /// The attention output for the values of the pair.
    fn gather(&self, values: Tensor<4>) -> Tensor<4> {
        let gathered = self.map.gather(values);
        match &self.earlier {
            Some(Earlier { values, share_of_pair }) => gathered * share_of_pair.clone() + values.clone(),
            None => gathered,
        }
    }

    /// The memory for the next pair.
    fn with(&self, values: Tensor<4>) -> Memory {
        Memory(self.remembered.iter().cloned().chain([self.keys.clone(), values]).collect())
    }
}

impl Recurrent for MemFlow {
    fn encoders(&self) -> Encoders<'_> {
        Encoders { features: &self.fnet, context: &self.cnet, hidden: HIDDEN, radius: RADIUS }
    }

    fn step(
        &self,
        context: Tensor<4>,
        memory: Option<&Memory>,
    ) -> impl Fn(Tensor<4>, Tensor<4>, Tensor<4>) -> Refined<Option<Memory>> {
        let block = &self.update_block;
        let attention = self.attention(context.clone(), memory);
        move |hidden, flow, windows| {
            let motion = block.encoder.forward(flow, windows);
            let values = block.aggregator.values(motion.clone());
            let global = block.aggregator.add(motion.clone(), attention.gather(values.clone()));
            let [hidden, change] = block.forward(hidden, context.clone(), motion, global);
            Refined { hidden, change, further: Some(attention.with(values)) }
        }
    }

    fn upsample(&self, hidden: &Tensor<4>, flow: Tensor<4>) -> Tensor<4> {
        convex_upsample(&self.update_block.mask, hidden, flow)
    }

    fn settings(&mut self) -> Vec<Setting<'_>> {
        vec![
            Setting {
                name: "train_avg_length",
                description: "average number of attended coarse pixels in training; from the weights file, else ptlflow's default",
                allowed: Allowed::Range(2..=1_000_000_000),
                in_files: Some("train_avg_length"),
                value: &mut self.train_avg_length,
            },
            Setting {
                name: "remembered_pairs",
                description: "earlier pairs of a video to attend to; ptlflow's default, the authors' code has 1",
                allowed: Allowed::Range(0..=16),
                in_files: None,
                value: &mut self.remembered_pairs,
            },
        ]
    }
}
