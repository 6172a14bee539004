//! What classifies a clip by its features: one file per classifier, and a table of all in `table.rs`.

mod linear;
mod offapexnet;
mod offtanet;
mod sssnet;
mod ststnet;
mod table;

use burn::module::Module;
use burn::tensor::{Device, Tensor, TensorData};
use srflow_core::random::{Key, Stream};
use srflow_nn::{ParameterInfo, Parameters, parameter_infos, with_parameters};

pub(crate) use linear::input_len as linear_input_len;
pub use linear::{INVERSE_STRENGTHS, LogisticRegression, Observation, validation_losses};
pub use offapexnet::OffApexNet;
pub use offtanet::OffTaNet;
pub use sssnet::SssNet;
pub use ststnet::StstNet;
pub use table::{CLASSIFIERS, ClassifierEntry};

use crate::features::{FEATURE_SIDE, Features};

/// A network from features to one score per class. Its parameters carry the reference's names, so that
/// [`srflow_nn::load`] reads published checkpoints.
pub trait Classifier: Module + 'static {
    const FACTS: ClassifierFacts;
    /// Channels, height and width of its input.
    const INPUT: [usize; 3];

    /// A network for this number of classes, with placeholder parameters: use [`initialized`] or a checkpoint.
    fn new(device: &Device, classes: usize) -> Self;

    /// The input for a clip, `INPUT` row-major.
    fn input(features: &Features) -> Vec<f32>;

    /// Scores `[batch, classes]`, before any softmax, of inputs `[batch, INPUT...]`. Without a stream there is no dropout; for batch
    /// norm see [`srflow_nn::with_batch_statistics`].
    fn scores(&self, inputs: Tensor<4>, dropout: Option<&mut Stream>) -> Tensor<2>;
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct ClassifierFacts {
    /// Name on the command line.
    pub name: &'static str,
    /// Name in its paper.
    pub title: &'static str,
    /// Authors, venue and year.
    pub paper: &'static str,
    /// The reference implementation, whose results it reproduces.
    pub reference: &'static str,
    /// Number of learned parameters for three classes, without the statistics of batch norm.
    pub parameters: usize,
    /// Description of the input.
    pub input: &'static str,
}

/// A network with random parameters by PyTorch's rules for convolutions and linear layers (uniform within
/// `1 / sqrt(inputs of an output)`), drawn from `key` and `purpose`.
pub fn initialized<C: Classifier>(device: &Device, classes: usize, key: Key, purpose: &str) -> C {
    let network = C::new(device, classes);
    let infos = parameter_infos(&network);
    let value = |info: &ParameterInfo| {
        let count: usize = info.shape.iter().product();
        let (layer, last) = info.name.rsplit_once('.').unwrap_or(("", &info.name));
        let weight = format!("{layer}.weight");
        let inputs = infos
            .iter()
            .find(|info| info.name == weight && info.shape.len() > 1)
            .map(|weight| weight.shape[1..].iter().product::<usize>());
        match (last, inputs) {
            ("weight" | "bias", Some(inputs)) => {
                let bound = 1.0 / (inputs as f32).sqrt();
                let mut stream = key.stream(&format!("{purpose}: {}", info.name));
                (0..count).map(|_| stream.uniform(-bound, bound)).collect()
            }
            ("weight" | "running_var", _) => vec![1.0; count],
            _ => vec![0.0; count],
        }
    };
    let parameters: Parameters = infos
        .iter()
        .map(|info| (info.name.clone(), TensorData::new(value(info), info.shape.clone())))
        .collect();
    with_parameters(network, parameters).expect("its own names and shapes")
}

/// Means of `FACTOR x FACTOR` pixels of the first `channels` feature maps: 112x112 becomes 28x28. Flow stays in pixels of
/// 112x112.
fn reduced<const FACTOR: usize>(features: &Features, channels: usize) -> Vec<f32> {
    let side = FEATURE_SIDE / FACTOR;
    let mut out = Vec::with_capacity(channels * side * side);
    for map in features.values().chunks_exact(FEATURE_SIDE * FEATURE_SIDE).take(channels) {
        for (y, x) in (0..side).flat_map(|y| (0..side).map(move |x| (y, x))) {
            let rows = map.chunks_exact(FEATURE_SIDE).skip(y * FACTOR).take(FACTOR);
            let sum: f32 = rows.flat_map(|row| &row[x * FACTOR..][..FACTOR]).sum();
            out.push(sum / (FACTOR * FACTOR) as f32);
        }
    }
    out
}
