//! The parameters of a network in host memory, all tensors concatenated.
//!
//! The optimizer, checkpoints and the exchange between devices work on this form; after every step the parameters are copied
//! back to the devices.

use std::ops::Range;

use burn::module::{Module, ModuleMapper, ModuleVisitor, Param};
use burn::tensor::{Gradients, Tensor, TensorData};

use crate::parameters::parameter_infos;

/// Position of each tensor of a network in the concatenation of all.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Layout {
    segments: Vec<Segment>,
}

/// A tensor of a [`Layout`].
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Segment {
    /// Name in the reference implementation, such as `fnet.layer1.0.conv1.weight`.
    pub name: String,
    pub shape: Vec<usize>,
    /// Position among the values of all tensors.
    pub range: Range<usize>,
    /// Whether it has gradients; running statistics of batch norm have none.
    pub trained: bool,
}

impl Layout {
    /// The layout of a network, in the order of its definition, and the values of its tensors.
    ///
    /// The network must be on a device with automatic differentiation: [`Segment::trained`] is whether a tensor requires
    /// gradients.
    pub fn of(network: &impl Module) -> (Self, Vec<f32>) {
        let mut reader = Reader::default();
        network.visit(&mut reader);
        let names = parameter_infos(network).into_iter().map(|info| info.name);
        let segments = names.zip(reader.tensors).map(|(name, tensor)| Segment { name, ..tensor }).collect();
        (Self { segments }, reader.values)
    }

    /// A layout of these tensors, whose ranges must be consecutive.
    pub fn from_segments(segments: Vec<Segment>) -> Self {
        Self { segments }
    }

    pub fn segments(&self) -> &[Segment] {
        &self.segments
    }

    /// Number of values of all tensors.
    pub fn len(&self) -> usize {
        self.segments.last().map_or(0, |segment| segment.range.end)
    }

    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }
}

/// `network` with the parameters `values`, on its current device.
///
/// # Panics
/// When `layout` is not that of the network, or `values` is shorter than it.
pub fn filled<M: Module>(network: M, layout: &Layout, values: &[f32]) -> M {
    network.map(&mut Filler { segments: layout.segments.iter(), values })
}

/// Gradients of all tensors of a network, in host memory.
#[derive(Debug, Clone, PartialEq)]
pub struct HostGradients {
    /// In the order of the [`Layout`]; zero for tensors without a gradient.
    pub values: Vec<f32>,
    /// Whether each tensor has a gradient.
    pub reached: Vec<bool>,
}

impl HostGradients {
    /// Zeros; no tensor has a gradient yet.
    pub fn zero(layout: &Layout) -> Self {
        Self { values: vec![0.0; layout.len()], reached: vec![false; layout.segments.len()] }
    }

    /// Adds the gradients of a backward pass, times `weight`.
    pub fn add(&mut self, network: &impl Module, layout: &Layout, gradients: &Gradients, weight: f32) {
        let segments = layout.segments.iter().enumerate();
        network.visit(&mut GradientAdder { segments, gradients, weight, sum: self });
    }

    /// Adds gradients of the same layout, times `weight`.
    pub fn add_host(&mut self, other: &Self, weight: f32) {
        for (sum, &value) in self.values.iter_mut().zip(&other.values) {
            *sum += weight * value;
        }
        for (sum, reached) in self.reached.iter_mut().zip(&other.reached) {
            *sum |= reached;
        }
    }
}

#[derive(Default)]
struct Reader {
    /// With empty names.
    tensors: Vec<Segment>,
    values: Vec<f32>,
}

impl ModuleVisitor for Reader {
    fn visit_float<const D: usize>(&mut self, param: &Param<Tensor<D>>) {
        let tensor = param.val();
        let start = self.values.len();
        let shape = tensor.dims().to_vec();
        let trained = tensor.is_require_grad();
        self.values.extend(numbers(tensor));
        self.tensors.push(Segment { name: String::new(), shape, range: start..self.values.len(), trained });
    }
}

struct Filler<'a> {
    segments: std::slice::Iter<'a, Segment>,
    values: &'a [f32],
}

impl ModuleMapper for Filler<'_> {
    fn map_float<const D: usize>(&mut self, param: Param<Tensor<D>>) -> Param<Tensor<D>> {
        let segment = self.segments.next().expect("the layout of this network");
        let data = TensorData::new(self.values[segment.range.clone()].to_vec(), segment.shape.clone());
        let tensor = Tensor::from_data(data, &param.lazy_device());
        let id = param.id;
        param.transform_for_load(tensor, id)
    }
}

struct GradientAdder<'a> {
    segments: std::iter::Enumerate<std::slice::Iter<'a, Segment>>,
    gradients: &'a Gradients,
    weight: f32,
    sum: &'a mut HostGradients,
}

impl ModuleVisitor for GradientAdder<'_> {
    fn visit_float<const D: usize>(&mut self, param: &Param<Tensor<D>>) {
        let (number, segment) = self.segments.next().expect("the layout of this network");
        let Some(gradient) = param.val().grad(self.gradients) else { return };
        self.sum.reached[number] = true;
        for (sum, value) in self.sum.values[segment.range.clone()].iter_mut().zip(numbers(gradient)) {
            *sum += self.weight * value;
        }
    }
}

/// Copies the values of a tensor to host memory, as `f32`, row-major.
pub fn numbers<const D: usize>(tensor: Tensor<D>) -> Vec<f32> {
    tensor.into_data().convert::<f32>().try_to_vec().expect("converted to f32")
}
