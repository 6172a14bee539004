//! The regularizers of a single flow, for inspection.

use burn::tensor::{Device, Tensor, TensorData};
use serde::Serialize;
use srflow_core::{FlowField, Image, Mask, Size, SizeMismatch};

use super::config::{LossConfig, REGULARIZERS};
use super::entry::RegularizerValue;
use super::inputs::{LossInputs, Prediction};
use super::regularizers;
use super::weighted_variation::{pixel_weights, total_mask};

/// The value of one regularizer.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct FlowRegularizer {
    /// Name in configurations and logs.
    pub name: &'static str,
    /// The paper's abbreviation.
    #[serde(skip)]
    pub title: &'static str,
    /// Its term of the loss, with the paper's weight.
    pub value: f64,
    /// Pixel weights of MIGAR and IGVAR; `None` for the others.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub weights: Option<ImageWeights>,
}

/// Statistics of the pixel weights.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ImageWeights {
    /// Natural logarithm of the base.
    pub log_base: f64,
    /// Mean weight over the pixels of `M_total`; 0 when it is empty.
    pub mean_weight: f64,
    /// Number of pixels of `M_total`.
    pub pixels: usize,
}

#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum RegularizerError {
    #[error(transparent)]
    SizeMismatch(#[from] SizeMismatch),
    #[error("the flow is {0} (WIDTHxHEIGHT): expected at least one pixel")]
    Empty(Size),
    #[error(
        "the flow at pixel ({x}, {y}) is ({u}, {v}): expected finite values at every pixel, as in an estimated flow"
    )]
    Unknown {
        x: usize,
        y: usize,
        /// Component to the right.
        u: f32,
        /// Component down.
        v: f32,
    },
}

/// Every regularizer of one flow as a term of the loss of a single prediction, with the paper's weights. `head` is `M_bg`;
/// without one, every pixel counts as head. Of `config`, only `m_total`, `border` and `image_max` are used.
///
/// # Errors
/// When the sizes differ, the flow is empty, or a pixel of it is unknown.
pub fn regularizers_of_flow(
    config: &LossConfig,
    flow: &FlowField,
    frame1: &Image,
    head: Option<&Mask>,
) -> Result<Vec<FlowRegularizer>, RegularizerError> {
    let size @ Size { width, height } = flow.size();
    let others = [("the first frame", Some(frame1.size())), ("the mask", head.map(Mask::size))];
    for (second_name, second) in others {
        if let Some(second) = second.filter(|second| *second != size) {
            return Err(SizeMismatch { first_name: "the flow", first: size, second_name, second }.into());
        }
    }
    if width == 0 || height == 0 {
        return Err(RegularizerError::Empty(size));
    }
    if let Some(at) = flow.pixels().iter().position(|[u, v]| !(u.is_finite() && v.is_finite())) {
        let [u, v] = flow.pixels()[at];
        return Err(RegularizerError::Unknown { x: at % width, y: at / width, u, v });
    }
    let flow = planes(size, flow.pixels(), |component| component);
    let first_frame = planes(size, frame1.pixels(), |value| f32::from(value) / 255.0);
    let inputs = LossInputs {
        valid: Tensor::ones([1, 1, height, width], &flow.device()),
        truth: flow.clone(),
        // No regularizer reads the second frame.
        second_frame: first_frame.clone(),
        first_frame,
        foreground: head.map(|head| {
            let inside: Vec<[bool; 1]> = head.pixels().iter().map(|inside| [*inside]).collect();
            planes(size, &inside, |inside| f32::from(u8::from(inside)))
        }),
    };
    let with = |config: LossConfig, regularizer| config.with(regularizer, regularizer.paper_weight);
    let config = REGULARIZERS.iter().fold(config.clone(), with);
    let parts = regularizers(&config, &[Prediction::from(flow)], &inputs);
    let foreground = inputs.foreground_or_all();
    let mask = total_mask(foreground.clone(), config.m_total, config.border);
    let weights_of = |log_base| {
        let (weights, log_base) = pixel_weights(log_base, &config, &inputs.first_frame, &foreground);
        let pixels = mask.clone().into_data().iter::<f32>().filter(|inside| *inside > 0.5).count();
        let mean_weight = first((weights * mask.clone()).sum()) / pixels.max(1) as f64;
        ImageWeights { log_base: first(log_base.reshape([1])), mean_weight, pixels }
    };
    let described = REGULARIZERS.iter().zip(parts).map(|(regularizer, (name, value))| FlowRegularizer {
        name,
        title: regularizer.title,
        value: first(value),
        weights: match regularizer.value {
            RegularizerValue::OfFlow(_) => None,
            RegularizerValue::WeightedVariation { log_base } => Some(weights_of(log_base)),
        },
    });
    Ok(described.collect())
}

/// Pixels, row-major, as a tensor `[1, N, height, width]`.
fn planes<T: Copy, const N: usize>(
    Size { width, height }: Size,
    pixels: &[[T; N]],
    value: impl Fn(T) -> f32,
) -> Tensor<4> {
    let values: Vec<f32> = (0..N).flat_map(|c| pixels.iter().map(move |pixel| pixel[c])).map(value).collect();
    Tensor::from_data(TensorData::new(values, [1, N, height, width]), &Device::flex())
}

fn first(x: Tensor<1>) -> f64 {
    x.into_data().iter::<f64>().next().unwrap_or(f64::NAN)
}
