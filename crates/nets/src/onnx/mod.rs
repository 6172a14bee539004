//! Networks as files of ONNX, for onnxruntime and other programs: the whole way from two frames to the flow in one graph.
//!
//! A network is a function that adds its operators to a [`Graph`], with a line in [`export_of`]. Parameters keep the names of the
//! reference implementation. `tests/nets/onnx.rs` compares every graph, as onnxruntime runs it, with the network itself.

mod graph;
mod operations;
mod proto;
mod raft;
mod raft_small;
mod recurrent;
mod skflow;
mod srflow;

use std::num::NonZeroUsize;
use std::path::Path;

use prost::Message;
use srflow_core::Size;
use srflow_files::{FileError, write_file};
use srflow_nn::parameters;

use crate::Facts;
use crate::table::{Architecture, Network};
use graph::{Axis, Graph, Length, Sides, Value};
use proto::{ModelProto, OperatorSetIdProto, StringStringEntryProto};

/// Version of ONNX's operators, which onnxruntime has since 1.12 (2022). Sampling needs 16.
const OPERATORS: i64 = 17;
/// Version of the format of files that came with it.
const FORMAT: i64 = 8;

/// Adds the operators of a network to a graph, with so many iterations.
type Export = fn(&mut Graph, &Pair, usize);

/// The graph of a network; `None` where there is none.
fn export_of(architecture: Architecture) -> Option<Export> {
    Some(match architecture {
        Architecture::SrFlow => srflow::srflow,
        Architecture::Raft => raft::raft,
        Architecture::RaftSmall => raft_small::raft_small,
        Architecture::SkFlow => skflow::skflow,
        _ => return None,
    })
}

/// What is written; see [`save_network_onnx`].
#[derive(Debug, Clone, Copy)]
pub struct OnnxOptions {
    /// Refinement iterations; each is in the file once.
    pub iterations: NonZeroUsize,
    /// Of the frames; without it, the file takes frames of any size.
    pub size: Option<Size>,
}

/// Errors of [`save_network_onnx`].
#[derive(Debug, thiserror::Error)]
pub enum OnnxError {
    #[error(
        "{network} cannot be written as ONNX, only {}; write its weights as .safetensors or .ckpt",
        listed()
    )]
    NotExported { network: &'static str },
    #[error("{size} is too large for a graph of fixed size: expected sides of up to {LONGEST_SIDE} pixels")]
    TooLarge { size: Size },
    #[error(transparent)]
    File(#[from] FileError),
}

/// Longest side of frames of fixed size, whose lengths are in the file.
const LONGEST_SIDE: usize = 1 << 16;

impl Architecture {
    /// Whether [`save_network_onnx`] has its graph.
    pub fn exports_to_onnx(self) -> bool {
        export_of(self).is_some()
    }
}

fn listed() -> String {
    let names: Vec<&str> =
        Architecture::ALL.into_iter().filter(|of| of.exports_to_onnx()).map(Architecture::name).collect();
    match names.split_last() {
        Some((last, others)) if !others.is_empty() => format!("{} and {last}", others.join(", ")),
        _ => names.concat(),
    }
}

/// Writes a network as a file of ONNX (operators of version 17). The write is atomic.
///
/// Inputs are `frame1` and `frame2`, `[1, 3, height, width]`, `f32`, RGB in 0..255; the output is `flow`, `[1, 2, height, width]`, `f32`, in
/// pixels, u to the right and v down. Padding and cropping are those of [`NetworkEstimator`](crate::NetworkEstimator). The network `srflow`
/// also has the input `start`, the flow to start from, of the shape of `flow` and in its units, and the output `uncertainty`,
/// `[1, 1, height, width]`, as [`LaplaceMixture::mean_scale`](crate::LaplaceMixture::mean_scale).
///
/// # Errors
/// When the network has no graph ([`Architecture::exports_to_onnx`]), the size is too large, or the file cannot be written.
pub fn save_network_onnx(network: &Network, options: OnnxOptions, path: &Path) -> Result<(), OnnxError> {
    Ok(write_file(path, onnx_bytes(network, options)?)?)
}

fn onnx_bytes(network: &Network, options: OnnxOptions) -> Result<Vec<u8>, OnnxError> {
    let facts = network.architecture().facts();
    let export = export_of(network.architecture()).ok_or(OnnxError::NotExported { network: facts.name })?;
    if let Some(size) = options.size.filter(|size| size.width.max(size.height) > LONGEST_SIDE) {
        return Err(OnnxError::TooLarge { size });
    }
    let mut graph = Graph::new(parameters(network));
    let pair = Pair::new(&mut graph, facts, options.size);
    export(&mut graph, &pair, options.iterations.get());
    let iterations = options.iterations.to_string();
    let (size, of_any) = match options.size {
        Some(size) => (size.to_string(), format!("of {size} pixels (WIDTHxHEIGHT), no other size")),
        None => ("any".to_owned(), "of any size".to_owned()),
    };
    let metadata = [
        ("program", "srflow"),
        ("version", env!("CARGO_PKG_VERSION")),
        ("network", facts.name),
        ("paper", facts.paper),
        ("iterations", &iterations),
        ("size", &size),
        ("licence", facts.licence),
        ("authors", facts.authors),
    ];
    let entry = |(key, value): (&str, &str)| StringStringEntryProto {
        key: Some(key.to_owned()),
        value: Some(value.to_owned()),
    };
    let model = ModelProto {
        ir_version: Some(FORMAT),
        producer_name: Some("srflow".to_owned()),
        producer_version: Some(env!("CARGO_PKG_VERSION").to_owned()),
        doc_string: Some(format!(
            "Optical flow by {} with {iterations} iterations, from frame1 to frame2, one pair of frames {of_any}.",
            facts.title
        )),
        graph: Some(graph.finish(facts.name)),
        opset_import: vec![OperatorSetIdProto { domain: Some(String::new()), version: Some(OPERATORS) }],
        metadata_props: metadata.into_iter().filter(|(_, value)| !value.is_empty()).map(entry).collect(),
    };
    Ok(model.encode_to_vec())
}

/// The frames of a graph, and how they are padded.
#[derive(Debug)]
pub(crate) struct Pair {
    /// In -1..1, padded: `[1, 3, height, width]`.
    pub(crate) first: Value,
    pub(crate) second: Value,
    /// Height and width of the frames.
    size: [Length; 2],
    axes: [Axis; 2],
    /// The padding of the smallest side and of the multiple together, as both repeat the border.
    sides: Sides,
    padded: [Length; 2],
}

impl Pair {
    fn new(graph: &mut Graph, facts: &Facts, size: Option<Size>) -> Self {
        let axes = match size {
            Some(size) => [size.height, size.width].map(|side| Axis::Known(side as i64)),
            None => [Axis::Named("height"), Axis::Named("width")],
        };
        let shape = [Axis::Known(1), Axis::Known(3), axes[0], axes[1]];
        graph.begin("frames");
        let frames = [
            ("frame1", "The frame that the flow starts from, RGB in 0..255."),
            ("frame2", "The frame that the flow points to, RGB in 0..255."),
        ]
        .map(|(name, description)| graph.input(name, description, &shape));
        let size = frames[0].size();
        let mut padded = size.clone();
        let mut before = size.clone();
        let mut after = size.clone();
        for axis in 0..2 {
            // `Canvas` of the estimator, then `Border` of the network.
            let extended = graph.at_least(&size[axis], facts.smallest_side as i64);
            padded[axis] = graph.next_multiple(&extended, facts.padding as i64);
            let beside = graph.minus(&extended, &size[axis]);
            let border = graph.minus(&padded[axis], &extended);
            let halves = [beside, border].map(|more| graph.over(&more, 2));
            before[axis] = graph.plus(&halves[0], &halves[1]);
            let rest = graph.minus(&padded[axis], &size[axis]);
            after[axis] = graph.minus(&rest, &before[axis]);
        }
        let ([top, left], [bottom, right]) = (before, after);
        let sides = Sides { top, left, bottom, right };
        let [first, second] = frames.map(|frame| {
            let frame = graph.scale(&frame, 2.0 / 255.0);
            let frame = graph.shift(&frame, -1.0);
            graph.extended(&frame, &sides, padded.clone())
        });
        Self { first, second, size, axes, sides, padded }
    }

    /// Pixels of a padded frame, if its size is fixed.
    pub(crate) fn pixels(&self) -> Option<usize> {
        match self.padded {
            [Length::Known(height), Length::Known(width)] => usize::try_from(height * width).ok(),
            _ => None,
        }
    }

    /// Height and width of inputs that have the size of the frames.
    pub(crate) fn axes(&self) -> [Axis; 2] {
        self.axes
    }

    /// A map of the size of the frames, padded as they are.
    pub(crate) fn extended(&self, graph: &mut Graph, map: &Value) -> Value {
        graph.extended(map, &self.sides, self.padded.clone())
    }

    /// Adds an output, without the padding.
    pub(crate) fn output(&self, graph: &mut Graph, name: &'static str, description: &str, map: &Value) {
        let map = graph.narrow(map, 2, &self.sides.top, &self.size[0]);
        let map = graph.narrow(&map, 3, &self.sides.left, &self.size[1]);
        graph.output(name, description, &map);
    }

    pub(crate) fn output_flow(&self, graph: &mut Graph, flow: &Value) {
        let description = "Where each pixel of frame 1 is in frame 2, less where it is: pixels to the right, then pixels down.";
        self.output(graph, "flow", description, flow);
    }
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;

    use burn::tensor::Device;
    use srflow_nn::parameter_infos;

    use super::proto::{DimensionValue, NodeProto};
    use super::*;

    fn model(network: &Network, iterations: usize, size: Option<Size>) -> ModelProto {
        let iterations = NonZeroUsize::new(iterations).expect("some");
        let bytes = onnx_bytes(network, OnnxOptions { iterations, size }).expect("a graph");
        ModelProto::decode(bytes.as_slice()).expect("its own messages")
    }

    fn count(nodes: &[NodeProto], operator: &str) -> usize {
        nodes.iter().filter(|node| node.op_type.as_deref() == Some(operator)).count()
    }

    #[test]
    fn every_parameter_is_there_under_its_name() {
        for architecture in Architecture::ALL.into_iter().filter(|of| of.exports_to_onnx()) {
            let network = architecture.init(&Device::flex());
            let graph = model(&network, 1, None).graph.expect("a graph");
            let found: Vec<(String, Vec<usize>)> = graph
                .initializer
                .into_iter()
                .filter_map(|tensor| {
                    Some((tensor.name?, tensor.dims.into_iter().map(|length| length as usize).collect()))
                })
                .collect();
            for info in parameter_infos(&network) {
                // Stored in every checkpoint, but used by no published network.
                let unused = info.name.contains(".pos_emb.");
                assert_eq!(found.contains(&(info.name.clone(), info.shape)), !unused, "{}", info.name);
            }
        }
    }

    #[test]
    fn each_iteration_is_in_the_graph_once() {
        let network = Architecture::RaftSmall.init(&Device::flex());
        let lookups = |iterations| {
            let graph = model(&network, iterations, None).graph.expect("a graph");
            count(&graph.node, "GridSample")
        };
        assert_eq!([1, 2, 5].map(lookups), [4, 8, 20], "one for each level of the pyramid");
    }

    #[test]
    fn a_fixed_size_is_in_the_file_and_an_open_one_is_computed() {
        let network = Architecture::SrFlow.init(&Device::flex());
        let of = |size| {
            let graph = model(&network, 2, size).graph.expect("a graph");
            let [shapes, ranges, casts, most, compared] =
                ["Shape", "Range", "Cast", "Max", "Greater"].map(|operator| count(&graph.node, operator));
            // Comparisons are cast too, whatever the size.
            let computed = [shapes, ranges, casts - compared, most];
            let dimensions = graph.input.into_iter().chain(graph.output).flat_map(|value| {
                let shape = value.r#type.and_then(|kind| kind.tensor_type?.shape).expect("a shape");
                shape.dim.into_iter().skip(2).map(|dimension| match dimension.value {
                    Some(DimensionValue::Name(name)) => name,
                    Some(DimensionValue::Length(length)) => length.to_string(),
                    None => "unknown".to_owned(),
                })
            });
            (computed, dimensions.collect::<Vec<_>>())
        };
        let (computed, dimensions) = of(None);
        assert!(computed.into_iter().all(|nodes| nodes >= 1), "{computed:?}");
        assert_eq!(dimensions, ["height", "width"].repeat(5));
        let (computed, dimensions) = of(Some(Size::new(150, 133)));
        assert_eq!(computed, [0; 4]);
        assert_eq!(dimensions, ["133", "150"].repeat(5));
    }

    #[test]
    fn nodes_come_after_what_they_need_and_none_is_for_nothing() {
        let network = Architecture::SrFlow.init(&Device::flex());
        let graph = model(&network, 2, None).graph.expect("a graph");
        let names = |values: Vec<proto::ValueInfoProto>| values.into_iter().filter_map(|value| value.name);
        let mut known: BTreeSet<String> = names(graph.input).collect();
        known.extend(graph.initializer.into_iter().filter_map(|tensor| tensor.name));
        let mut needed: BTreeSet<String> = names(graph.output).collect();
        for mut node in graph.node {
            node.input.retain(|input| !input.is_empty()); // left out
            assert!(node.input.iter().all(|input| known.contains(input)), "{node:?}");
            needed.extend(node.input);
            known.extend(node.output);
        }
        assert_eq!(known, needed);
    }

    #[test]
    fn networks_without_a_graph_are_refused_by_name() {
        let network = Architecture::Gma.init(&Device::flex());
        let options = OnnxOptions { iterations: NonZeroUsize::MIN, size: None };
        let error = onnx_bytes(&network, options).expect_err("no graph").to_string();
        assert!(error.starts_with("gma cannot be written as ONNX, only srflow, raft, raft-small and skflow"));
    }
}
