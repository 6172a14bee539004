use burn::tensor::ops::ConvOptions;

/// Sizes of a 2D convolution. Layouts: input `[batch, in_channels, height, width]`, weight
/// `[out_channels, in_channels / groups, kernel_height, kernel_width]`, output
/// `[batch, out_channels, out_height, out_width]`.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Conv2dShape {
    /// Images.
    pub batch: usize,
    /// Input channels, of all groups.
    pub in_channels: usize,
    /// Output channels, of all groups.
    pub out_channels: usize,
    /// Parts of the channels that do not see each other: one of a dense convolution, as many as channels of a depthwise one.
    pub groups: usize,
    /// Input height and width.
    pub input: [usize; 2],
    /// Kernel height and width.
    pub kernel: [usize; 2],
    /// Stride down and across.
    pub stride: [usize; 2],
    /// Zeros added above and below, left and right.
    pub padding: [usize; 2],
}

impl Conv2dShape {
    /// Output height and width; 0 where the kernel does not fit.
    pub fn output(&self) -> [usize; 2] {
        [0, 1].map(|i| {
            let padded = self.input[i] + 2 * self.padding[i];
            if padded < self.kernel[i] { 0 } else { (padded - self.kernel[i]) / self.stride[i] + 1 }
        })
    }

    /// Elements of the input.
    pub fn input_len(&self) -> usize {
        self.batch * self.in_channels * self.input[0] * self.input[1]
    }

    /// Elements of the weight.
    pub fn weight_len(&self) -> usize {
        self.weight().iter().product()
    }

    /// Elements of the output.
    pub fn output_len(&self) -> usize {
        let [height, width] = self.output();
        self.batch * self.out_channels * height * width
    }

    pub(crate) fn taps(&self) -> usize {
        self.kernel[0] * self.kernel[1]
    }

    /// The weight's shape.
    pub(crate) fn weight(&self) -> [usize; 4] {
        [self.out_channels, self.in_channels / self.groups, self.kernel[0], self.kernel[1]]
    }

    /// The input's shape.
    pub(crate) fn input_shape(&self) -> [usize; 4] {
        let [height, width] = self.input;
        [self.batch, self.in_channels, height, width]
    }

    /// The output's shape.
    pub(crate) fn output_shape(&self) -> [usize; 4] {
        let [height, width] = self.output();
        [self.batch, self.out_channels, height, width]
    }

    /// Panics where the kernels of dense convolutions do not apply.
    pub(crate) fn check_dense(&self) {
        assert_eq!(self.groups, 1, "dense: one group: {self:?}");
    }

    /// Panics where the kernels of depthwise convolutions do not apply.
    pub(crate) fn check_depthwise(&self) {
        let channels = [self.in_channels, self.out_channels];
        assert_eq!(channels, [self.groups; 2], "depthwise: a group for each channel: {self:?}");
        assert_eq!(self.stride, [1, 1], "depthwise: steps of one pixel: {self:?}");
    }

    /// The same in Burn's terms.
    pub(crate) fn options(&self) -> ConvOptions<2> {
        ConvOptions::new(self.stride, self.padding, [1, 1], self.groups)
    }
}
