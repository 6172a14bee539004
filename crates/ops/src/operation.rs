//! The adapter between operations and Burn: an [`Operation`] defines forward and backward, and [`apply`] runs it on every device,
//! with gradients.

use std::fmt::Debug;

use burn::backend::autodiff::NodeId;
use burn::backend::autodiff::checkpoint::{base::Checkpointer, strategy::CheckpointStrategy};
use burn::backend::autodiff::grads::Gradients;
use burn::backend::autodiff::ops::{Backward, Ops, OpsKind};
use burn::backend::tensor::FloatTensor;
use burn::backend::{
    Autodiff, AutodiffBackend, Backend, BackendTensor, Dispatch, DispatchAutodiffContext, DispatchTensor,
    DispatchTensorKind, ExtensionType, Flex, TensorMetadata, backend_extension,
};
use burn::tensor::{Slice, Tensor};
#[cfg(feature = "cube")]
use burn_cubecl::{CubeBackend, tensor::CubeTensor};

use crate::Activation;
use crate::activation::{Keeps, tensor::Activate};
use crate::flex::CpuTensor;

/// An operation with `N` inputs. Only the first output has a gradient.
pub(crate) trait Operation<const N: usize>: Composition<N> {
    /// The activation of the first output, if the operation has one. The operation does not handle its derivative: `grad` below
    /// is the gradient of the activation's input.
    fn activation(&mut self) -> Option<&mut Activation> {
        None
    }

    /// Inputs to save for the backward pass.
    fn saved_inputs<T>(inputs: &[T; N]) -> &[T] {
        inputs
    }

    /// Outputs to save for the backward pass.
    fn saved_outputs<T>(_outputs: &[T]) -> &[T] {
        &[]
    }

    fn cpu(&self, inputs: [CpuTensor; N]) -> Vec<CpuTensor>;

    /// Gradients of the inputs, at least of the requested ones.
    fn cpu_backward(&self, back: Backprop<CpuTensor>) -> [Option<CpuTensor>; N];

    #[cfg(feature = "cube")]
    fn cube(&self, inputs: [CubeTensor; N]) -> Vec<CubeTensor> {
        self.composed::<CubeBackend>(inputs)
    }

    #[cfg(feature = "cube")]
    fn cube_backward(&self, back: Backprop<CubeTensor>) -> [Option<CubeTensor>; N] {
        self.composed_backward::<CubeBackend>(back)
    }
}

/// The same composed of a backend's own operations, for devices without a kernel. Operations with kernels in `cube` have no
/// composition, nor have those that their tensor function runs on the CPU alone.
pub(crate) trait Composition<const N: usize>: Clone + Debug + Send + 'static {
    #[allow(dead_code)] // without another device only tests call it
    fn composed<B: Backend>(&self, _inputs: [FloatTensor<B>; N]) -> Vec<FloatTensor<B>> {
        unreachable!("{self:?} is not composed")
    }

    #[allow(dead_code)]
    fn composed_backward<B: Backend>(&self, _back: Backprop<FloatTensor<B>>) -> [Option<FloatTensor<B>>; N] {
        unreachable!("gradients of {self:?} are not composed")
    }
}

/// `count` elements of `x` along an axis, from `first` on.
pub(crate) fn narrow<B: Backend>(
    x: FloatTensor<B>,
    axis: usize,
    first: usize,
    count: usize,
) -> FloatTensor<B> {
    let slice = |(dimension, size): (usize, &usize)| {
        let range = if dimension == axis { first..first + count } else { 0..*size };
        Slice::new(range.start as isize, Some(range.end as isize), 1)
    };
    let shape = x.shape();
    let slices: Vec<Slice> = shape.iter().enumerate().map(slice).collect();
    B::float_slice(x, &slices)
}

/// What a backward pass starts from.
pub(crate) struct Backprop<T> {
    /// The saved inputs, then the saved outputs.
    saved: Vec<T>,
    /// Gradient of the first output.
    grad: T,
    /// The inputs that want a gradient.
    nodes: Vec<Option<NodeId>>,
}

impl<T> Backprop<T> {
    /// What was saved, and the gradient of the first output.
    pub(crate) fn into_parts<const SAVED: usize>(self) -> ([T; SAVED], T) {
        (array(self.saved), self.grad)
    }

    pub(crate) fn map<U>(self, of: impl Fn(T) -> U) -> Backprop<U> {
        let saved = self.saved.into_iter().map(&of).collect();
        Backprop { saved, grad: of(self.grad), nodes: self.nodes }
    }

    /// Whether an input with this index exists and needs a gradient.
    pub(crate) fn wants(&self, input: usize) -> bool {
        self.nodes.get(input).is_some_and(Option::is_some)
    }

    /// Whether two inputs are the same tensor and need a gradient.
    pub(crate) fn are_one(&self, a: usize, b: usize) -> bool {
        self.wants(a) && self.nodes.get(a) == self.nodes.get(b)
    }
}

/// The first output of the operation, on the device of its inputs and with gradients.
pub(crate) fn apply<O: Operation<N>, const N: usize, const D: usize>(
    operation: O,
    inputs: [DispatchTensor; N],
) -> Tensor<D> {
    Tensor::from_dispatch(outputs(operation, inputs).swap_remove(0))
}

/// All outputs; only the first has a gradient.
pub(crate) fn outputs<O: Operation<N>, const N: usize>(
    operation: O,
    inputs: [DispatchTensor; N],
) -> Vec<DispatchTensor> {
    Dispatch::run(Tensors(inputs.into()), operation).0
}

/// Converts to an array; the caller guarantees the length.
pub(crate) fn array<T, const N: usize>(values: Vec<T>) -> [T; N] {
    let count = values.len();
    values.try_into().unwrap_or_else(|_| unreachable!("{count} tensors where there are {N}"))
}

/// Float tensors of one backend during Burn's dispatch.
pub(crate) struct Tensors<B: Backend>(Vec<FloatTensor<B>>);

impl<B: Backend> ExtensionType<B> for Tensors<B> {
    type Target = Tensors<Dispatch>;

    fn map_to_dispatch<F>(self, map_kind: F, autodiff: DispatchAutodiffContext) -> Self::Target
    where
        F: Fn(BackendTensor<B>) -> DispatchTensorKind,
    {
        let wrap = |tensor| DispatchTensor { kind: map_kind(BackendTensor::Float(tensor)), autodiff };
        Tensors(self.0.into_iter().map(wrap).collect())
    }

    fn map_from_dispatch<F>(target: Self::Target, unwrap_kind: F) -> Self
    where
        F: Fn(DispatchTensor) -> BackendTensor<B>,
    {
        Self(target.0.into_iter().map(|tensor| unwrap_kind(tensor).float()).collect())
    }

    fn routing_tensor(target: &Self::Target) -> Option<&DispatchTensor> {
        target.0.first()
    }

    fn routing_float_tensor(target: &Self::Target) -> Option<&DispatchTensor> {
        target.0.first()
    }

    fn autodiff_context(target: &Self::Target) -> DispatchAutodiffContext {
        target.0.iter().fold(DispatchAutodiffContext::Disabled, |all, tensor| all.merge(tensor.autodiff))
    }
}

#[backend_extension(Flex, Cube: cfg(feature = "cube"), Autodiff)]
pub(crate) trait Run: Backend {
    fn run<O: Operation<N>, const N: usize>(
        #[extension_type] inputs: Tensors<Self>,
        operation: O,
    ) -> Tensors<Self>;
}

impl<B: Executor> Run for B {
    fn run<O: Operation<N>, const N: usize>(inputs: Tensors<Self>, operation: O) -> Tensors<Self> {
        Tensors(B::forward(&operation, array(inputs.0)))
    }
}

/// A backend that stores numbers rather than a graph, and the methods of an operation that it uses.
pub(crate) trait Executor: Backend {
    fn forward<O: Operation<N>, const N: usize>(
        operation: &O,
        inputs: [FloatTensor<Self>; N],
    ) -> Vec<FloatTensor<Self>>;

    fn backward<O: Operation<N>, const N: usize>(
        operation: &O,
        back: Backprop<FloatTensor<Self>>,
    ) -> [Option<FloatTensor<Self>>; N];
}

impl Executor for Flex {
    fn forward<O: Operation<N>, const N: usize>(
        operation: &O,
        inputs: [FloatTensor<Self>; N],
    ) -> Vec<FloatTensor<Self>> {
        operation.cpu(inputs.map(CpuTensor::from)).into_iter().map(CpuTensor::into).collect()
    }

    fn backward<O: Operation<N>, const N: usize>(
        operation: &O,
        back: Backprop<FloatTensor<Self>>,
    ) -> [Option<FloatTensor<Self>>; N] {
        operation.cpu_backward(back.map(CpuTensor::from)).map(|gradient| gradient.map(CpuTensor::into))
    }
}

#[cfg(feature = "cube")]
impl Executor for CubeBackend {
    fn forward<O: Operation<N>, const N: usize>(operation: &O, inputs: [CubeTensor; N]) -> Vec<CubeTensor> {
        operation.cube(inputs)
    }

    fn backward<O: Operation<N>, const N: usize>(
        operation: &O,
        back: Backprop<CubeTensor>,
    ) -> [Option<CubeTensor>; N] {
        operation.cube_backward(back)
    }
}

impl<B: Executor, C: CheckpointStrategy> Run for Autodiff<B, C> {
    fn run<O: Operation<N>, const N: usize>(inputs: Tensors<Self>, mut operation: O) -> Tensors<Self> {
        let (inputs, nodes): (Vec<_>, Vec<_>) =
            inputs.0.into_iter().map(|tensor| tensor.into_parts()).unzip();
        let inputs = array(inputs);
        let step = Step(operation.clone());
        let (first, others) = match step.prepare::<C>(array(nodes)).compute_bound().stateful() {
            OpsKind::UnTracked(prep) => {
                let mut others = B::forward(&operation, inputs);
                (prep.finish(others.remove(0)), others)
            }
            OpsKind::Tracked(prep) => {
                let mut saved = O::saved_inputs(&inputs).to_vec();
                let activation =
                    operation.activation().map_or(Activation::Identity, |activation| *activation);
                let keeps = activation.keeps();
                if let (Keeps::Sum, Some(activation)) = (keeps, operation.activation()) {
                    *activation = Activation::Identity;
                }
                let mut others = B::forward(&operation, inputs);
                saved.extend_from_slice(O::saved_outputs(&others));
                let mut first = others.remove(0);
                let kept = (keeps != Keeps::Nothing).then(|| first.clone());
                if keeps == Keeps::Sum {
                    first = B::forward(&Activate(activation), [first]).remove(0);
                }
                (prep.finish(State { saved, kept }, first), others)
            }
        };
        let others = others.into_iter().map(<Self as AutodiffBackend>::from_inner);
        Tensors(std::iter::once(first).chain(others).collect())
    }
}

#[derive(Debug)]
struct Step<O>(O);

#[derive(Debug, Clone)]
struct State<T> {
    saved: Vec<T>,
    /// What the derivative of the activation is computed from.
    kept: Option<T>,
}

impl<B: Executor, O: Operation<N>, const N: usize> Backward<B, N> for Step<O> {
    type State = State<FloatTensor<B>>;

    fn backward(self, ops: Ops<Self::State, N>, grads: &mut Gradients, _: &mut Checkpointer) {
        let Self(mut operation) = self;
        let State { saved, kept } = ops.state;
        let mut grad = grads.consume::<B>(&ops.node);
        if let (Some(kept), Some(activation)) = (kept, operation.activation()) {
            let back = Backprop { saved: vec![kept], grad, nodes: Vec::new() };
            let [of_sums] = B::backward(&Activate(*activation), back);
            grad = of_sums.expect("an activation has a gradient");
        }
        let nodes = ops.parents.map(|parent| parent.map(|node| node.id));
        let gradients = B::backward(&operation, Backprop { saved, grad, nodes: nodes.into() });
        for (node, gradient) in nodes.into_iter().zip(gradients) {
            if let (Some(node), Some(gradient)) = (node, gradient) {
                grads.register::<B>(node, gradient);
            }
        }
    }
}

#[cfg(test)]
pub(crate) mod tests;
