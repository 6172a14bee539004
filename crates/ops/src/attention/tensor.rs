//! Attention on tensors, with gradients: [`attention`], and [`Attention`] for weights that are used many times.

use std::ops::Range;
use std::sync::{Arc, Mutex, OnceLock, PoisonError};

use burn::tensor::{Device, Tensor};
use rayon::prelude::*;
use srflow_simd::Isa;

use super::backward::Gathered;
use super::composed::ImagePieces;
use super::image;
use super::recomputed::{GatherInPieces, LogSumsInPieces};
use super::weights::AttentionWeights;
use super::{Windows, windowed_attention, windowed_attention_backward};
use crate::flex::CpuTensor;
use crate::operation::{Backprop, Composition, Operation, apply};
use crate::precision::cpu_precision;

/// The largest piece of a matrix of all pairs, for devices without the kernel.
const PIECE_BYTES: usize = 64 << 20;

/// What the kernel found out about queries and keys, once for all values, and what it needs for their gradients. Those of
/// the weights are never formed: what they follow from is collected until all has been gathered.
#[derive(Debug, Clone)]
struct Prepared {
    kept_bytes: usize,
    images: Arc<OnceLock<Images>>,
    /// Values, what was gathered of them and its gradient, of every gathering whose gradient has come.
    gathered: Arc<Mutex<Vec<[CpuTensor; 3]>>>,
}

#[derive(Debug)]
struct Images {
    queries: CpuTensor,
    keys: CpuTensor,
    weights: Vec<AttentionWeights>,
}

impl Images {
    /// `of` the queries, the keys, the weights and the number of each image.
    fn map<T: Send>(&self, of: impl Fn([&[f32]; 2], &AttentionWeights, usize) -> T + Sync) -> Vec<T> {
        let (queries, keys) = (self.queries.slice(), self.keys.slice());
        let image = queries.len() / self.weights.len();
        let pairs = queries.par_chunks_exact(image).zip(keys.par_chunks_exact(image));
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

/// Prepares gathering by queries and keys, `[batch, channels, height, width]` each, and gives the logarithms of the sums,
/// `[batch, 1, height, width]`, which stand for the weights where gradients are tracked.
#[derive(Debug, Clone)]
struct Weigh(Prepared);

impl Composition<2> for Weigh {}

impl Operation<2> for Weigh {
    fn saved_inputs<T>(_: &[T; 2]) -> &[T] {
        &[]
    }

    fn cpu(&self, [queries, keys]: [CpuTensor; 2]) -> Vec<CpuTensor> {
        let Self(prepared) = self;
        let [batch, _, height, width] = queries.dims();
        let precision = cpu_precision();
        let images = prepared.images.get_or_init(|| {
            let kept_bytes = prepared.kept_bytes / batch;
            let (q, k) = (queries.slice(), keys.slice());
            let weights = |n| {
                let pair = [image(q, batch, n), image(k, batch, n)];
                AttentionWeights::new(Isa::best(), precision, pair, height * width, kept_bytes)
            };
            let weights = (0..batch).into_par_iter().map(weights).collect();
            Images { weights, queries, keys }
        });
        let log_sums = images.weights.iter().flat_map(AttentionWeights::log_sums);
        vec![CpuTensor::new(log_sums.collect(), [batch, 1, height, width])]
    }

    fn cpu_backward(&self, back: Backprop<CpuTensor>) -> [Option<CpuTensor>; 2] {
        let Self(prepared) = self;
        let ([], of_log_sums) = back.into_parts();
        let all = std::mem::take(&mut *prepared.gathered.lock().unwrap_or_else(PoisonError::into_inner));
        let all: Vec<[&[f32]; 3]> =
            all.iter().map(|tensors| tensors.each_ref().map(CpuTensor::slice)).collect();
        let images = prepared.images();
        let gradients = images.map(|[queries, keys], weights, n| {
            let of_image = |values| image(values, images.weights.len(), n);
            let gathered: Vec<Gathered> = all
                .iter()
                .map(|[values, gathered, grad]| Gathered {
                    values: of_image(values),
                    gathered: of_image(gathered),
                    grad: of_image(grad),
                })
                .collect();
            weights.backward(queries, keys, &gathered, of_image(of_log_sums.slice()))
        });
        [0, 1].map(|of| {
            let values: Vec<&[f32]> = gradients.iter().map(|gradients| &gradients[of][..]).collect();
            Some(CpuTensor::new(values.concat(), images.queries.shape()))
        })
    }
}

/// Gathers values by the weights that were prepared.
#[derive(Debug, Clone)]
struct Gather(Prepared);

impl Composition<2> for Gather {}

impl Operation<2> for Gather {
    fn saved_outputs<T>(outputs: &[T]) -> &[T] {
        outputs
    }

    fn cpu(&self, [_, values]: [CpuTensor; 2]) -> Vec<CpuTensor> {
        let [batch, _, _, _] = values.dims();
        let all = values.slice();
        let images = self.0.images();
        let gather = |(n, weights): (usize, &AttentionWeights)| weights.gather(image(all, batch, n));
        let gathered: Vec<Vec<f32>> = images.weights.par_iter().enumerate().map(gather).collect();
        vec![values.like(gathered.concat())]
    }

    fn cpu_backward(&self, back: Backprop<CpuTensor>) -> [Option<CpuTensor>; 2] {
        let Self(prepared) = self;
        let collect = back.wants(0);
        let ([weights, values, gathered], grad) = back.into_parts();
        let [batch, _, _, _] = values.dims();
        let of_output = grad.slice();
        let images = prepared.images();
        let of_values = images.map(|[queries, keys], weights, n| {
            weights.gather_backward(queries, keys, image(of_output, batch, n))
        });
        let of_values = values.like(of_values.concat());
        if collect {
            let mut all = prepared.gathered.lock().unwrap_or_else(PoisonError::into_inner);
            all.push([values, gathered, grad]);
        }
        // The gradients of the weights are not formed: zeros stand for them.
        let of_weights = collect.then(|| weights.like(vec![0.0; weights.slice().len()]));
        [of_weights, Some(of_values)]
    }
}

/// Which pixels of an image take how much of which: `softmax_j(q_i . k_j)`.
///
/// On the CPU the pairs are computed block by block in the cache, for the gradients once more. Elsewhere the matrix is cut
/// into pieces, which with gradients are computed for each gathering, and for its gradients once more.
#[derive(Debug)]
pub struct Attention {
    size: [usize; 4],
    way: Way,
}

#[derive(Debug)]
enum Way {
    Kernel { log_sums: Box<Tensor<4>>, prepared: Prepared },
    Pieces(Vec<ImagePieces>),
    Recomputed { inputs: Box<[Tensor<4>; 2]>, piece_bytes: usize },
}

impl Attention {
    /// From queries and keys, each `[batch, channels, height, width]`. Weights that take no more than `kept_bytes` are kept
    /// from one gathering to the next (with gradients elsewhere than on the CPU, none are). Panics when the sizes differ.
    pub fn new(queries: Tensor<4>, keys: Tensor<4>, kept_bytes: usize) -> Self {
        if queries.device() != Device::flex() {
            return Self::in_pieces(queries, keys, kept_bytes, PIECE_BYTES);
        }
        let (size, autodiff) = Self::check(&queries, &keys);
        // The gradients of values want their weights in another order: half for each.
        let prepared = Prepared::new(if autodiff { kept_bytes / 2 } else { kept_bytes });
        let log_sums = apply(Weigh(prepared.clone()), [queries.into_dispatch(), keys.into_dispatch()]);
        Self { size, way: Way::Kernel { log_sums: Box::new(log_sums), prepared } }
    }

    /// For devices without the kernel.
    pub(super) fn in_pieces(
        queries: Tensor<4>,
        keys: Tensor<4>,
        kept_bytes: usize,
        piece_bytes: usize,
    ) -> Self {
        let (size @ [batch, _, _, _], autodiff) = Self::check(&queries, &keys);
        if autodiff {
            return Self { size, way: Way::Recomputed { inputs: Box::new([queries, keys]), piece_bytes } };
        }
        let kept_bytes = kept_bytes / batch;
        let image = |x: &Tensor<4>, n| x.clone().narrow(0, n, 1);
        let pieces = |n| ImagePieces::new(image(&queries, n), image(&keys, n), kept_bytes, piece_bytes);
        let images = (0..batch).map(pieces);
        Self { size, way: Way::Pieces(images.collect()) }
    }

    /// Their size, and whether gradients are tracked.
    fn check(queries: &Tensor<4>, keys: &Tensor<4>) -> ([usize; 4], bool) {
        assert_eq!(queries.dims(), keys.dims(), "attention: as many keys as queries");
        (queries.dims(), queries.is_autodiff() || keys.is_autodiff())
    }

    /// `ln sum_j exp(q_i . k_j)`, `[batch, 1, height, width]`: by them, what is gathered from several images is weighted to
    /// what one softmax over all of them would gather.
    pub fn log_sums(&self) -> Tensor<4> {
        match &self.way {
            Way::Kernel { log_sums, .. } => log_sums.as_ref().clone(),
            Way::Pieces(images) => {
                let [_, _, height, width] = self.size;
                let of_image = |image: &ImagePieces| image.log_sums().reshape([1, 1, height, width]);
                Tensor::cat(images.iter().map(of_image).collect(), 0)
            }
            Way::Recomputed { inputs, piece_bytes } => apply(
                LogSumsInPieces { piece_bytes: *piece_bytes },
                inputs.as_ref().clone().map(Tensor::into_dispatch),
            ),
        }
    }

    /// What each pixel gathers of `values`, `[batch, value channels, height, width]`. Panics when the sizes do not fit.
    pub fn gather(&self, values: Tensor<4>) -> Tensor<4> {
        let ([batch, _, height, width], [of, _, rows, columns]) = (self.size, values.dims());
        assert_eq!([of, rows, columns], [batch, height, width], "attention: values of the same pixels");
        match &self.way {
            Way::Kernel { log_sums, prepared } => {
                let weights = log_sums.as_ref().clone().into_dispatch();
                apply(Gather(prepared.clone()), [weights, values.into_dispatch()])
            }
            Way::Pieces(images) => {
                let images = images.iter().enumerate();
                let gathered = images.map(|(n, image)| image.gather(values.clone().narrow(0, n, 1)));
                Tensor::cat(gathered.collect(), 0)
            }
            Way::Recomputed { inputs, piece_bytes } => {
                let [queries, keys] = inputs.as_ref().clone();
                let inputs = [queries, keys, values].map(Tensor::into_dispatch);
                apply(GatherInPieces { piece_bytes: *piece_bytes }, inputs)
            }
        }
    }
}

/// Attention within windows of queries, keys and values.
#[derive(Debug, Clone)]
struct Windowed(Windows);

impl Composition<3> for Windowed {}

impl Operation<3> for Windowed {
    fn saved_outputs<T>(outputs: &[T]) -> &[T] {
        outputs
    }

    fn cpu(&self, [queries, keys, values]: [CpuTensor; 3]) -> Vec<CpuTensor> {
        let shape = queries.map_shape();
        let [out, statistics] =
            windowed_attention(queries.slice(), keys.slice(), values.slice(), &shape, &self.0);
        vec![values.like(out), CpuTensor::new(statistics, shape.with_channels(2).dims())]
    }

    fn cpu_backward(&self, back: Backprop<CpuTensor>) -> [Option<CpuTensor>; 3] {
        let wants_values = back.wants(2);
        let ([queries, keys, values, out, statistics], grad) = back.into_parts();
        let inputs = [&queries, &keys, &values].map(CpuTensor::slice);
        let outputs = [out.slice(), statistics.slice()];
        let shape = queries.map_shape();
        let [d_queries, d_keys, d_values] =
            windowed_attention_backward(inputs, outputs, grad.slice(), &shape, &self.0, wants_values);
        let d_values = wants_values.then(|| values.like(d_values));
        [Some(queries.like(d_queries)), Some(keys.like(d_keys)), d_values]
    }
}

/// `out_i = sum_j softmax_j(q_i . k_j) v_j` over the pixels `j` of the window of pixel `i`.
///
/// Queries and keys are `[batch, channels, height, width]`, values and output `[batch, value channels, height, width]`. No
/// weight is stored on the CPU; elsewhere they are computed in pieces. Panics when the sizes do not fit.
pub fn attention(queries: Tensor<4>, keys: Tensor<4>, values: Tensor<4>, windows: &Windows) -> Tensor<4> {
    let ([batch, _, height, width], [of, _, rows, columns]) = (queries.dims(), values.dims());
    assert_eq!(queries.dims(), keys.dims(), "attention: as many keys as queries");
    assert_eq!([of, rows, columns], [batch, height, width], "attention: values of the same pixels");
    assert_eq!(windows.sides(), [height, width], "attention: windows of the image");
    if queries.device() != Device::flex() {
        return attention_in_pieces(queries, keys, values, windows.clone(), PIECE_BYTES);
    }
    apply(Windowed(windows.clone()), [queries, keys, values].map(Tensor::into_dispatch))
}

/// For devices without the kernel.
pub(super) fn attention_in_pieces(
    queries: Tensor<4>,
    keys: Tensor<4>,
    values: Tensor<4>,
    windows: Windows,
    piece_bytes: usize,
) -> Tensor<4> {
    let [rows, columns] = windows.into_bands();
    let of_window = |rows: &Range<usize>, columns: &Range<usize>| {
        let part = |map: &Tensor<4>| {
            let band = map.clone().narrow(2, rows.start, rows.len());
            band.narrow(3, columns.start, columns.len())
        };
        Attention::in_pieces(part(&queries), part(&keys), 0, piece_bytes).gather(part(&values))
    };
    let of_band = |rows: &Range<usize>| {
        Tensor::cat(columns.iter().map(|columns| of_window(rows, columns)).collect(), 3)
    };
    Tensor::cat(rows.iter().map(of_band).collect(), 2)
}
