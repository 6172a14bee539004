//! The activation of a sum on tensors, with gradients.

use burn::backend::autodiff::checkpoint::{base::Checkpointer, strategy::CheckpointStrategy};
use burn::backend::autodiff::grads::Gradients;
use burn::backend::autodiff::ops::{Backward, Ops, OpsKind};
use burn::backend::tensor::FloatTensor;
use burn::backend::{Autodiff, Backend, Dispatch, Flex, TensorMetadata, backend_extension};
use burn::tensor::Tensor;

use super::{activate_tensor, activated};
use crate::Activation;
use crate::flex::{Contiguous, tensor};
use crate::tracked::{EpilogueGradOps, kept_and_output};

/// The activation of a sum. The default is made of Burn's operations.
#[backend_extension(Flex, Cube: cfg(feature = "cube"), Autodiff)]
pub trait ActivatedSumOps: Backend {
    /// See [`activated_sum`].
    fn activated_sum(
        a: FloatTensor<Self>,
        b: FloatTensor<Self>,
        activation: Activation,
    ) -> FloatTensor<Self> {
        activate_tensor::<Self>(Self::float_add(a, b), activation)
    }
}

#[cfg(feature = "cube")]
impl ActivatedSumOps for burn_cubecl::CubeBackend {}

impl ActivatedSumOps for Flex {
    fn activated_sum(
        a: FloatTensor<Self>,
        b: FloatTensor<Self>,
        activation: Activation,
    ) -> FloatTensor<Self> {
        let shape = a.shape();
        let (a, b) = (Contiguous::new(&a), Contiguous::new(&b));
        tensor(activated(activation, a.slice(), Some(b.slice())), shape)
    }
}

#[derive(Debug)]
struct ActivatedSumBackward(Activation);

impl<B: EpilogueGradOps> Backward<B, 2> for ActivatedSumBackward {
    /// What the derivative of the activation needs.
    type State = Option<FloatTensor<B>>;

    fn backward(self, ops: Ops<Self::State, 2>, grads: &mut Gradients, _: &mut Checkpointer) {
        let mut grad = grads.consume::<B>(&ops.node);
        if let Some(kept) = ops.state {
            grad = B::sums_grad(grad, kept, self.0);
        }
        for node in ops.parents.into_iter().flatten() {
            grads.register::<B>(node.id, grad.clone());
        }
    }
}

impl<B: ActivatedSumOps + EpilogueGradOps, C: CheckpointStrategy> ActivatedSumOps for Autodiff<B, C> {
    fn activated_sum(
        a: FloatTensor<Self>,
        b: FloatTensor<Self>,
        activation: Activation,
    ) -> FloatTensor<Self> {
        let ((a, a_node), (b, b_node)) = (a.into_parts(), b.into_parts());
        let run = |applied| B::activated_sum(a, b, applied);
        match ActivatedSumBackward(activation).prepare::<C>([a_node, b_node]).compute_bound().stateful() {
            OpsKind::UnTracked(prep) => prep.finish(run(activation)),
            OpsKind::Tracked(prep) => {
                let (kept, out) = kept_and_output::<B>(activation, run);
                prep.finish(kept, out)
            }
        }
    }
}

/// `activation(a + b)`. Panics when the sizes differ.
pub fn activated_sum(a: Tensor<4>, b: Tensor<4>, activation: Activation) -> Tensor<4> {
    assert_eq!(a.dims(), b.dims(), "summands of one size");
    Tensor::from_dispatch(Dispatch::activated_sum(a.into_dispatch(), b.into_dispatch(), activation))
}

#[cfg(test)]
mod tests {
    use burn::tensor::{Device, TensorData};

    use super::*;

    #[test]
    fn sums_and_gradients_are_those_of_the_definition() {
        let device = Device::flex().autodiff();
        let values = |seed: usize| -> Vec<f32> {
            (0..40_000).map(|i| ((i * 7919 + seed * 104_729) % 8192) as f32 / 1024.0 - 4.0).collect()
        };
        let of =
            |values: &[f32]| Tensor::from_data(TensorData::new(values.to_vec(), [2, 5, 40, 100]), &device);
        let numbers = |x: Tensor<4>| -> Vec<f32> { x.into_data().try_to_vec().expect("f32") };
        let [a, b, weight] = [1, 2, 3].map(values);
        for activation in
            [Activation::Identity, Activation::Relu, Activation::Gelu, Activation::Tanh, Activation::Sigmoid]
        {
            let (x, y) = (of(&a).require_grad(), of(&b).require_grad());
            let out = activated_sum(x.clone(), y.clone(), activation);
            let grads = (out.clone() * of(&weight)).sum().backward();
            let d_x = numbers(Tensor::from_inner(x.grad(&grads).expect("a gradient")));
            let d_y = numbers(Tensor::from_inner(y.grad(&grads).expect("a gradient")));
            assert_eq!(d_x, d_y);
            for (i, (out, d_x)) in numbers(out).into_iter().zip(d_x).enumerate() {
                let sum = f64::from(a[i] + b[i]);
                let expected = activation.reference(sum);
                assert!((f64::from(out) - expected).abs() < 1e-5, "{activation:?}({sum}): {out}");
                let expected = activation.reference_derivative(sum) * f64::from(weight[i]);
                assert!((f64::from(d_x) - expected).abs() < 2e-5, "derivative of {activation:?} at {sum}");
            }
        }
    }
}
