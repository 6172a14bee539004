//! Transposed convolution, PyTorch's `conv_transpose2d`: the gradient of the input of a dense convolution, with bias and
//! activation. Its own gradients are that convolution and the gradient of its weight, so [`crate::conv2d`] has the kernels.
//! [`mod@reference`] is the definition.

pub mod reference;
pub mod tensor;

#[cfg(test)]
pub(crate) mod tests;
