//! A convolution with its epilogue as one operation of automatic differentiation.

use std::fmt::Debug;

use burn::backend::autodiff::checkpoint::{base::Checkpointer, strategy::CheckpointStrategy};
use burn::backend::autodiff::grads::Gradients;
use burn::backend::autodiff::ops::{Backward, NodeGuard, Ops, OpsKind};
use burn::backend::tensor::FloatTensor;
use burn::backend::{Autodiff, Backend, Flex, TensorMetadata};

use crate::Activation;
use crate::activation::{Keeps, activate_tensor, activated, activation_backward};
use crate::conv2d::conv2d_backward_bias;
use crate::flex::{Contiguous, sizes, tensor, with_elements};

/// A convolution on a backend's own tensors.
pub(crate) trait Convolution<B: Backend>: Clone + Debug + Send + 'static {
    /// `activation(conv(input, weight) + bias + residual)`.
    fn forward(
        self,
        input: FloatTensor<B>,
        weight: FloatTensor<B>,
        bias: FloatTensor<B>,
        residual: Option<FloatTensor<B>>,
        activation: Activation,
    ) -> FloatTensor<B>;

    /// Gradient of the input from that of the sums, plus `add`.
    fn input_grad(
        self,
        input: FloatTensor<B>,
        weight: FloatTensor<B>,
        grad: FloatTensor<B>,
        add: Option<FloatTensor<B>>,
    ) -> FloatTensor<B>;

    /// Gradient of the weight from that of the sums.
    fn weight_grad(
        self,
        input: FloatTensor<B>,
        weight: FloatTensor<B>,
        grad: FloatTensor<B>,
    ) -> FloatTensor<B>;
}

/// Activations and gradients of an epilogue. The defaults are made of Burn's operations.
pub trait EpilogueGradOps: Backend {
    /// The activation of `sums`.
    fn activated(sums: FloatTensor<Self>, activation: Activation) -> FloatTensor<Self> {
        activate_tensor::<Self>(sums, activation)
    }

    /// Gradient of the sums from that of the activation. `kept` is what the activation gave; for Gelu, what it was given.
    fn sums_grad(
        grad: FloatTensor<Self>,
        kept: FloatTensor<Self>,
        activation: Activation,
    ) -> FloatTensor<Self> {
        match activation {
            Activation::Identity => grad,
            Activation::Relu => Self::relu_backward(kept, grad),
            Activation::Gelu => {
                // Burn's own is that of the approximation by tanh.
                let half_squares = Self::float_mul(kept.clone(), kept.clone());
                let density = Self::float_exp(Self::float_mul_scalar(half_squares, (-0.5).into()));
                let density = Self::float_mul_scalar(
                    density,
                    (0.5 * std::f64::consts::FRAC_2_SQRT_PI / std::f64::consts::SQRT_2).into(),
                );
                let erf = Self::float_erf(Self::float_mul_scalar(
                    kept.clone(),
                    std::f64::consts::FRAC_1_SQRT_2.into(),
                ));
                let cumulative = Self::float_mul_scalar(Self::float_add_scalar(erf, 1.0.into()), 0.5.into());
                Self::float_mul(grad, Self::float_add(cumulative, Self::float_mul(kept, density)))
            }
            Activation::Tanh => {
                let squares = Self::float_mul(kept.clone(), kept);
                let derivative = Self::float_add_scalar(Self::float_neg(squares), 1.0.into());
                Self::float_mul(grad, derivative)
            }
            Activation::Sigmoid => Self::sigmoid_backward(kept, grad),
        }
    }

    /// Gradient of the bias, `[channels]`.
    fn bias_grad(grad: FloatTensor<Self>) -> FloatTensor<Self> {
        let [_, channels, _, _] = sizes(&grad);
        let sum = [0, 2, 3].into_iter().fold(grad, Self::float_sum_dim);
        Self::float_reshape(sum, [channels].into())
    }
}

#[cfg(feature = "cube")]
impl EpilogueGradOps for burn_cubecl::CubeBackend {}

impl EpilogueGradOps for Flex {
    fn activated(sums: FloatTensor<Self>, activation: Activation) -> FloatTensor<Self> {
        tensor(activated(activation, Contiguous::new(&sums).slice(), None), sums.shape())
    }

    fn sums_grad(
        grad: FloatTensor<Self>,
        kept: FloatTensor<Self>,
        activation: Activation,
    ) -> FloatTensor<Self> {
        let kept = Contiguous::new(&kept);
        with_elements(grad, |grad| activation_backward(activation, kept.slice(), grad))
    }

    fn bias_grad(grad: FloatTensor<Self>) -> FloatTensor<Self> {
        let [_, channels, height, width] = sizes(&grad);
        let grad = Contiguous::new(&grad);
        tensor(conv2d_backward_bias(grad.slice(), channels, height * width), [channels])
    }
}

/// Parents: input, weight, bias and, where there is one, the residual.
#[derive(Debug)]
struct ConvolutionBackward<M>(M);

#[derive(Debug, Clone)]
struct State<T> {
    input: T,
    weight: T,
    /// For the derivative of the activation; not of the identity.
    kept: Option<T>,
    activation: Activation,
}

impl<B: EpilogueGradOps, M: Convolution<B>, const N: usize> Backward<B, N> for ConvolutionBackward<M> {
    type State = State<FloatTensor<B>>;

    fn backward(self, ops: Ops<Self::State, N>, grads: &mut Gradients, _: &mut Checkpointer) {
        let mut grad = grads.consume::<B>(&ops.node);
        let State { input, weight, kept, activation } = ops.state;
        if let Some(kept) = kept {
            grad = B::sums_grad(grad, kept, activation);
        }
        let node = |parent: usize| ops.parents.get(parent).cloned().flatten();
        let mut add = None;
        if let Some(residual) = node(3) {
            // A residual that is the input as well has its gradient added on the way.
            if node(0).is_some_and(|input| input.id == residual.id) {
                add = Some(grad.clone());
            } else {
                grads.register::<B>(residual.id, grad.clone());
            }
        }
        if let Some(bias) = node(2) {
            grads.register::<B>(bias.id, B::bias_grad(grad.clone()));
        }
        if let Some(node) = node(1) {
            let d_weight = self.0.clone().weight_grad(input.clone(), weight.clone(), grad.clone());
            grads.register::<B>(node.id, d_weight);
        }
        if let Some(node) = node(0) {
            grads.register::<B>(node.id, self.0.input_grad(input, weight, grad, add));
        }
    }
}

/// What the derivative of the activation needs, and the output, from what computes the sums and applies an activation.
pub(crate) fn kept_and_output<B: EpilogueGradOps>(
    activation: Activation,
    run: impl FnOnce(Activation) -> FloatTensor<B>,
) -> (Option<FloatTensor<B>>, FloatTensor<B>) {
    match activation.keeps() {
        Keeps::Nothing => (None, run(activation)),
        Keeps::Output => {
            let out = run(activation);
            (Some(out.clone()), out)
        }
        Keeps::Sum => {
            let sums = run(Activation::Identity);
            (Some(sums.clone()), B::activated(sums, activation))
        }
    }
}

/// [`Convolution::forward`], with gradients.
pub(crate) fn tracked<B: EpilogueGradOps, C: CheckpointStrategy>(
    convolution: impl Convolution<B>,
    [input, weight, bias]: [FloatTensor<Autodiff<B, C>>; 3],
    residual: Option<FloatTensor<Autodiff<B, C>>>,
    activation: Activation,
) -> FloatTensor<Autodiff<B, C>> {
    let nodes = [input.node(), weight.node(), bias.node()];
    let operands = [input, weight, bias].map(|tensor| tensor.into_primitive());
    match residual {
        None => registered::<B, C, _, 3>(convolution, nodes, operands, None, activation),
        Some(residual) => {
            let [input, weight, bias] = nodes;
            let (residual, node) = residual.into_parts();
            let nodes = [input, weight, bias, node];
            registered::<B, C, _, 4>(convolution, nodes, operands, Some(residual), activation)
        }
    }
}

fn registered<B: EpilogueGradOps, C: CheckpointStrategy, M: Convolution<B>, const N: usize>(
    convolution: M,
    nodes: [NodeGuard; N],
    [input, weight, bias]: [FloatTensor<B>; 3],
    residual: Option<FloatTensor<B>>,
    activation: Activation,
) -> FloatTensor<Autodiff<B, C>> {
    match ConvolutionBackward(convolution.clone()).prepare::<C>(nodes).compute_bound().stateful() {
        OpsKind::UnTracked(prep) => {
            prep.finish(convolution.forward(input, weight, bias, residual, activation))
        }
        OpsKind::Tracked(prep) => {
            let run = |applied| convolution.forward(input.clone(), weight.clone(), bias, residual, applied);
            let (kept, out) = kept_and_output::<B>(activation, run);
            prep.finish(State { input, weight, kept, activation }, out)
        }
    }
}
