use burn::module::{Initializer, Module, Param};
use burn::tensor::{Device, Tensor};
use srflow_ops::Activation;
use srflow_ops::conv2d::tensor::{Conv2dOptions, Epilogue, conv2d};

/// PyTorch's `Conv2d` with a square kernel.
#[derive(Module, Debug)]
pub(crate) struct Conv2d {
    weight: Param<Tensor<4>>,
    bias: Option<Param<Tensor<1>>>,
    stride: usize,
    padding: usize,
}

impl Conv2d {
    /// With zeros for parameters, stride 1, and padding that keeps the size; `channels` are those of input and output.
    pub(crate) fn new(channels: [usize; 2], kernel: usize, device: &Device) -> Self {
        let [inputs, outputs] = channels;
        Self {
            weight: Initializer::Zeros.init([outputs, inputs, kernel, kernel], device),
            bias: Some(Initializer::Zeros.init([outputs], device)),
            stride: 1,
            padding: kernel / 2,
        }
    }

    pub(crate) fn stride(self, stride: usize) -> Self {
        Self { stride, ..self }
    }

    pub(crate) fn padding(self, padding: usize) -> Self {
        Self { padding, ..self }
    }

    pub(crate) fn without_bias(self) -> Self {
        Self { bias: None, ..self }
    }

    pub(crate) fn weight(&self) -> Tensor<4> {
        self.weight.val()
    }

    pub(crate) fn bias(&self) -> Option<Tensor<1>> {
        self.bias.as_ref().map(Param::val)
    }

    /// `activation(conv(x) + bias)`.
    pub(crate) fn forward(&self, x: Tensor<4>, activation: Activation) -> Tensor<4> {
        self.apply(x, Epilogue::with(activation).bias(self.bias()))
    }

    /// `conv(x)`, the bias left out.
    pub(crate) fn forward_without_bias(&self, x: Tensor<4>) -> Tensor<4> {
        self.apply(x, Epilogue::default())
    }

    fn apply(&self, x: Tensor<4>, epilogue: Epilogue) -> Tensor<4> {
        let options = Conv2dOptions::new([self.stride; 2], [self.padding; 2]);
        conv2d(x, self.weight(), epilogue, options)
    }
}
