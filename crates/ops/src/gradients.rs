//! Gradients of several inputs that one computation gives.

use burn::backend::Backend;
use burn::backend::autodiff::grads::Gradients;
use burn::backend::autodiff::ops::Ops;
use burn::backend::tensor::FloatTensor;

/// Takes the gradient of the operation's output and registers those of its inputs, which `of_inputs` makes of what the forward
/// pass kept and of that gradient. It is Burn's `unary` for any number of inputs.
pub(crate) fn register<B: Backend, S, const N: usize>(
    ops: Ops<S, N>,
    grads: &mut Gradients,
    of_inputs: impl FnOnce(S, FloatTensor<B>) -> [FloatTensor<B>; N],
) {
    let grad = grads.consume::<B>(&ops.node);
    for (parent, gradient) in ops.parents.into_iter().zip(of_inputs(ops.state, grad)) {
        if let Some(node) = parent {
            grads.register::<B>(node.id, gradient);
        }
    }
}
