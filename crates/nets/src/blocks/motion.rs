//! Motion encoders, which encode flow and correlations, and the flow head, which decodes the hidden state (`update.py` of RAFT).

use burn::module::Module;
use burn::tensor::{Device, Tensor};
use srflow_nn::layers::{Conv2d, Conv2dConfig};
use srflow_ops::Activation::{Identity, Relu};
use srflow_ops::concatenate;

use crate::recurrent::LEVELS;

fn conv(channels: [usize; 2], kernel: usize, device: &Device) -> Conv2d {
    Conv2dConfig::new(channels, [kernel; 2]).init(device)
}

/// Correlations per pixel: windows of this radius in all levels of the pyramid.
pub(crate) fn window_entries(radius: usize) -> usize {
    LEVELS * (2 * radius + 1) * (2 * radius + 1)
}

/// `BasicMotionEncoder`: 128 channels, the last two of them the flow. Or `SmallMotionEncoder`: 82 channels.
#[derive(Module, Debug)]
pub(crate) struct MotionEncoder {
    convc1: Conv2d,
    convc2: Option<Conv2d>,
    convf1: Conv2d,
    convf2: Conv2d,
    conv: Conv2d,
}

impl MotionEncoder {
    pub(crate) fn new(radius: usize, device: &Device) -> Self {
        Self::of_entries(window_entries(radius), device)
    }

    /// An encoder for this many correlations per pixel.
    pub(crate) fn of_entries(entries: usize, device: &Device) -> Self {
        Self {
            convc1: conv([entries, 256], 1, device),
            convc2: Some(conv([256, 192], 3, device)),
            convf1: conv([2, 128], 7, device),
            convf2: conv([128, 64], 3, device),
            conv: conv([64 + 192, 128 - 2], 3, device),
        }
    }

    /// `SmallMotionEncoder`.
    pub(crate) fn small(entries: usize, device: &Device) -> Self {
        Self {
            convc1: conv([entries, 96], 1, device),
            convc2: None,
            convf1: conv([2, 64], 7, device),
            convf2: conv([64, 32], 3, device),
            conv: conv([96 + 32, 80], 3, device),
        }
    }

    pub(crate) fn forward(&self, flow: Tensor<4>, windows: Tensor<4>) -> Tensor<4> {
        let mut correlation = self.convc1.forward(windows, Relu);
        if let Some(conv) = &self.convc2 {
            correlation = conv.forward(correlation, Relu);
        }
        let motion = self.convf2.forward(self.convf1.forward(flow.clone(), Relu), Relu);
        let out = self.conv.forward(concatenate(vec![correlation, motion]), Relu);
        concatenate(vec![out, flow])
    }
}

/// `FlowHead`: decodes the change of the flow from the hidden state.
#[derive(Module, Debug)]
pub(crate) struct FlowHead {
    conv1: Conv2d,
    conv2: Conv2d,
}

impl FlowHead {
    pub(crate) fn new(inputs: usize, hidden: usize, device: &Device) -> Self {
        Self::of_outputs(inputs, hidden, 2, device)
    }

    /// With more than the change of the flow.
    pub(crate) fn of_outputs(inputs: usize, hidden: usize, outputs: usize, device: &Device) -> Self {
        Self { conv1: conv([inputs, hidden], 3, device), conv2: conv([hidden, outputs], 3, device) }
    }

    pub(crate) fn forward(&self, hidden: Tensor<4>) -> Tensor<4> {
        self.conv2.forward(self.conv1.forward(hidden, Relu), Identity)
    }
}
