//! Input frames of networks.

use std::ops::Range;

use burn::tensor::Tensor;
use burn::tensor::ops::PadMode;

/// Two batches of frames, RGB in 0..1, `[batch, 3, height, width]`.
#[derive(Debug, Clone)]
pub struct Frames {
    /// The frames that the flow starts from.
    pub first: Tensor<4>,
    /// The frames that the flow points to.
    pub second: Tensor<4>,
}

/// Padding around a frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Border {
    size: [usize; 2],
    before: [usize; 2],
    padded: [usize; 2],
}

impl Border {
    /// The smallest padding that makes height and width multiples of `multiple`; of an odd number, the larger half is below and
    /// to the right.
    pub(crate) fn new(size: [usize; 2], multiple: usize) -> Self {
        let padded = size.map(|size| size.next_multiple_of(multiple));
        Self { size, before: [0, 1].map(|i| (padded[i] - size[i]) / 2), padded }
    }

    /// Pads by repeating the outermost rows and columns.
    pub(crate) fn add(&self, x: Tensor<4>) -> Tensor<4> {
        if self.padded == self.size {
            return x;
        }
        let [top, left] = self.before;
        let [bottom, right] = [0, 1].map(|i| self.padded[i] - self.size[i] - self.before[i]);
        x.pad((left, right, top, bottom), PadMode::Edge)
    }

    /// Crops the padding of [`Border::add`].
    pub(crate) fn remove(&self, x: Tensor<4>) -> Tensor<4> {
        if self.padded == self.size {
            return x;
        }
        x.narrow(2, self.before[0], self.size[0]).narrow(3, self.before[1], self.size[1])
    }

    /// Height and width with the padding.
    pub(crate) fn padded(&self) -> [usize; 2] {
        self.padded
    }

    /// Rows and columns of the coarse pixels, squares of `stride` pixels, that are not padding alone.
    pub(crate) fn coarse_inside(&self, stride: usize) -> [Range<usize>; 2] {
        [0, 1].map(|i| self.before[i] / stride..(self.before[i] + self.size[i]).div_ceil(stride))
    }
}

impl Frames {
    /// Height and width. Panics when the frames are empty or differ in size.
    pub(crate) fn size(&self) -> [usize; 2] {
        let dims @ [batch, channels, height, width] = self.first.dims();
        assert_eq!(dims, self.second.dims(), "the size of the second frames");
        assert!(
            channels == 3 && batch * height * width > 0,
            "frames: [batch, 3, height, width], not {dims:?}"
        );
        [height, width]
    }

    /// Both frames scaled to -1..1 and padded to multiples of `multiple`. Panics when the frames are empty or differ in size.
    pub(crate) fn prepared(self, multiple: usize) -> (Tensor<4>, Tensor<4>, Border) {
        let border = Border::new(self.size(), multiple);
        (prepared(self.first, border), prepared(self.second, border), border)
    }
}

/// Frames scaled to -1..1 and padded.
pub(crate) fn prepared(frames: Tensor<4>, border: Border) -> Tensor<4> {
    border.add(frames * 2.0 - 1.0)
}

#[cfg(test)]
mod tests {
    use burn::tensor::Device;

    use super::*;

    #[test]
    fn padding_repeats_the_edge_and_can_be_removed() {
        let device = Device::flex();
        let frame = Tensor::<1>::from_floats([1., 2., 3., 4., 5., 6.], &device).reshape([1, 1, 2, 3]);
        let border = Border::new([2, 3], 4);
        let padded = border.add(frame.clone());
        let numbers: Vec<f32> = padded.clone().into_data().try_to_vec().expect("f32");
        assert_eq!(numbers, [1., 2., 3., 3., 1., 2., 3., 3., 4., 5., 6., 6., 4., 5., 6., 6.]);
        assert_eq!(border.remove(padded).into_data(), frame.into_data());
    }
}
