//! A network's parameters in host memory, one tensor after the other.
//!
//! The optimizer, checkpoints and the exchange between devices work on these; a device holds a copy that is filled again
//! after every step.

use std::ops::Range;

use burn::module::{Module, ModuleMapper, ModuleVisitor, Param};
use burn::tensor::{Gradients, Tensor, TensorData};

use crate::parameters::parameter_infos;

/// Where each tensor of a network is among its numbers.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Layout {
    segments: Vec<Segment>,
}

/// One tensor.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Segment {
    /// As the reference implementation calls it, such as `fnet.layer1.0.conv1.weight`.
    pub name: String,
    pub shape: Vec<usize>,
    /// Its place among all numbers.
    pub range: Range<usize>,
    /// Whether it has gradients; the running statistics of batch norm have none.
    pub trained: bool,
}

impl Layout {
    /// The tensors of a network in the order of its definition, and their numbers.
    ///
    /// The network must be on a device with automatic differentiation, which knows which tensors are trained.
    pub fn of(network: &impl Module) -> (Self, Vec<f32>) {
        let mut reading = Reading::default();
        network.visit(&mut reading);
        let names = parameter_infos(network).into_iter().map(|info| info.name);
        let segments = names.zip(reading.tensors).map(|(name, tensor)| Segment { name, ..tensor }).collect();
        (Self { segments }, reading.values)
    }

    /// Of consecutive tensors.
    pub fn from_segments(segments: Vec<Segment>) -> Self {
        Self { segments }
    }

    pub fn segments(&self) -> &[Segment] {
        &self.segments
    }

    /// How many numbers there are.
    pub fn len(&self) -> usize {
        self.segments.last().map_or(0, |segment| segment.range.end)
    }

    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }
}

/// `network` with these numbers, on the device that it is on.
pub fn filled<M: Module>(network: M, layout: &Layout, values: &[f32]) -> M {
    network.map(&mut Filling { segments: layout.segments.iter(), values })
}

/// Gradients of all tensors of a network.
#[derive(Debug, Clone, PartialEq)]
pub struct HostGradients {
    /// In the order of the [`Layout`]; zero where there are none.
    pub values: Vec<f32>,
    /// For each tensor whether a gradient reached it.
    pub reached: Vec<bool>,
}

impl HostGradients {
    /// Zero, with no tensor reached.
    pub fn zero(layout: &Layout) -> Self {
        Self { values: vec![0.0; layout.len()], reached: vec![false; layout.segments.len()] }
    }

    /// Adds the gradients of a backward pass, times `weight`.
    pub fn add(&mut self, network: &impl Module, layout: &Layout, gradients: &Gradients, weight: f32) {
        let segments = layout.segments.iter().enumerate();
        network.visit(&mut Adding { segments, gradients, weight, sum: self });
    }

    /// Adds other gradients, times `weight`.
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
struct Reading {
    /// Without their names.
    tensors: Vec<Segment>,
    values: Vec<f32>,
}

impl ModuleVisitor for Reading {
    fn visit_float<const D: usize>(&mut self, param: &Param<Tensor<D>>) {
        let tensor = param.val();
        let start = self.values.len();
        let shape = tensor.dims().to_vec();
        let trained = tensor.is_require_grad();
        self.values.extend(numbers(tensor));
        self.tensors.push(Segment { name: String::new(), shape, range: start..self.values.len(), trained });
    }
}

struct Filling<'a> {
    segments: std::slice::Iter<'a, Segment>,
    values: &'a [f32],
}

impl ModuleMapper for Filling<'_> {
    fn map_float<const D: usize>(&mut self, param: Param<Tensor<D>>) -> Param<Tensor<D>> {
        let segment = self.segments.next().expect("the layout of this network");
        let data = TensorData::new(self.values[segment.range.clone()].to_vec(), segment.shape.clone());
        let tensor = Tensor::from_data(data, &param.lazy_device());
        let id = param.id;
        param.transform_for_load(tensor, id)
    }
}

struct Adding<'a> {
    segments: std::iter::Enumerate<std::slice::Iter<'a, Segment>>,
    gradients: &'a Gradients,
    weight: f32,
    sum: &'a mut HostGradients,
}

impl ModuleVisitor for Adding<'_> {
    fn visit_float<const D: usize>(&mut self, param: &Param<Tensor<D>>) {
        let (number, segment) = self.segments.next().expect("the layout of this network");
        let Some(gradient) = param.val().grad(self.gradients) else { return };
        self.sum.reached[number] = true;
        for (sum, value) in self.sum.values[segment.range.clone()].iter_mut().zip(numbers(gradient)) {
            *sum += self.weight * value;
        }
    }
}

/// The numbers of a tensor in host memory.
pub fn numbers<const D: usize>(tensor: Tensor<D>) -> Vec<f32> {
    tensor.into_data().convert::<f32>().try_to_vec().expect("converted to f32")
}
