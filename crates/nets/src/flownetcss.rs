//! FlowNet2-CSS (Ilg et al., *FlowNet 2.0*, CVPR 2017, section 4): <https://arxiv.org/abs/1612.01925>. FlowNetC followed by two
//! FlowNetS, each of which sees the frames, the frame warped by the previous flow, and the remaining error. Parity with the
//! reference: `PARITY.md`.

use burn::module::Module;
use burn::tensor::{Device, Tensor};
use srflow_ops::concatenate;
use srflow_ops::warp::tensor::warp;

use crate::estimate::{Estimate, Request};
use crate::facts::{Facts, ptlflow};
use crate::features::Features;
use crate::flownet::{FLOW_SCALE, FLOWNETS, FlowNet, Kind, estimate, full_size, prepared, towers};
use crate::frames::Frames;
use crate::memory_need::MemoryNeed;
use crate::network::{Entry, FlowNetwork};

/// Both images, the warped second image, the flow, and the brightness error.
const CHANNELS: usize = 3 + 3 + 3 + 2 + 1;
/// A warped pixel counts if at least this share of its interpolation weights lies inside the image.
const INSIDE: f64 = 0.9999;

pub(crate) const FLOWNETCSS: Entry<FlowNetCss> = Entry {
    facts: Facts {
        name: "flownetcss",
        title: "FlowNet2-CSS",
        paper: "https://arxiv.org/abs/1612.01925",
        parameters: 116_565_942,
        memory: MemoryNeed { fixed: 150_000_000, per_pixel: 400, attending: 0, most_weights: 0 },
        published: &[ptlflow!("flownetcss", "things", "b42e67d0")],
        ..FLOWNETS.facts
    },
    init: FlowNetCss::new,
};

#[derive(Module, Debug)]
pub struct FlowNetCss {
    flownetc: FlowNet,
    flownets_1: FlowNet,
    flownets_2: FlowNet,
}

impl FlowNetCss {
    pub(crate) fn new(device: &Device) -> Self {
        let simple = Kind::Simple { channels: CHANNELS };
        Self {
            flownetc: FlowNet::new(Kind::Correlating, device),
            flownets_1: FlowNet::new(simple, device),
            flownets_2: FlowNet::new(simple, device),
        }
    }
}

impl FlowNetwork for FlowNetCss {
    fn features(&self, frames: Tensor<4>) -> Features {
        let batch = frames.dims()[0];
        self.flownetc.tower(prepared(frames)).into_features(batch)
    }

    fn forward(&self, frames: Frames, request: &Request) -> Estimate {
        let size = frames.size();
        let [first, second] = towers(&self.flownetc, frames.clone(), request);
        let mut flows = self.flownetc.correlating(first, second.conv3);
        let images = [frames.first, frames.second].map(prepared);
        for network in [&self.flownets_1, &self.flownets_2] {
            let Some(finest) = flows.pop() else { break };
            flows = network.simple(stacked_input(&images, finest));
        }
        estimate(flows, size, request)
    }
}

/// Input of the next network of the stack, `[batch, CHANNELS, height, width]`, from prepared images and the previous flow.
fn stacked_input([first, second]: &[Tensor<4>; 2], flow: Tensor<4>) -> Tensor<4> {
    let [batch, _, height, width] = first.dims();
    let flow = full_size(flow, [height, width]);
    let ones = Tensor::ones([batch, 1, height, width], &first.device());
    let warped = warp(concatenate(vec![second.clone(), ones]), flow.clone());
    let inside = warped.clone().narrow(1, 3, 1).detach().greater_equal_elem(INSIDE).float();
    let warped = warped.narrow(1, 0, 3) * inside;
    let squares = (first.clone() - warped.clone()).square().sum_dim(1);
    // The gradient of the square root is infinite at zero; the reference uses a gradient of zero there.
    let brightness = squares.clamp_min(1e-30).sqrt();
    concatenate(vec![first.clone(), second.clone(), warped, flow / FLOW_SCALE, brightness])
}
