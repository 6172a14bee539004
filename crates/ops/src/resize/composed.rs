//! The resizing composed of a backend's own operations.

use burn::backend::tensor::{Device, FloatTensor, IntTensor};
use burn::backend::{Backend, TensorMetadata};
use burn::tensor::{IndexingUpdateOp, Shape, TensorData};

use super::Places;
use super::tensor::Resize;
use crate::MapShape;
use crate::operation::{Backprop, Composition};

/// Dimensions of rows and columns.
const AXES: [usize; 2] = [2, 3];

/// [`Places`] along an axis on a device.
struct Along<B: Backend> {
    pixels: [IntTensor<B>; 2],
    fractions: FloatTensor<B>,
}

impl Resize {
    fn along<B: Backend>(&self, axis: usize, device: &Device<B>) -> Along<B> {
        let from = [self.shape.height, self.shape.width][axis];
        let size = self.size[axis];
        let places = Places::new(from, size, self.grids);
        let pixels = [0, 1].map(|side| {
            let pixels: Vec<i32> = places.pixels.iter().map(|pixels| pixels[side] as i32).collect();
            B::int_from_data(TensorData::new(pixels, [size]), device)
        });
        let mut shape = [1; 4];
        shape[AXES[axis]] = size;
        Along { pixels, fractions: B::float_from_data(TensorData::new(places.fractions, shape), device) }
    }
}

impl Composition<1> for Resize {
    fn composed<B: Backend>(&self, [input]: [FloatTensor<B>; 1]) -> Vec<FloatTensor<B>> {
        let device = input.device();
        let resized = [0, 1].into_iter().fold(input, |x, axis| {
            let Along { pixels, fractions } = self.along::<B>(axis, &device);
            let [first, second] = pixels.map(|pixels| B::float_select(x.clone(), AXES[axis], pixels));
            let change = B::float_mul(B::float_sub(second, first.clone()), fractions);
            B::float_add(first, change)
        });
        vec![resized]
    }

    fn composed_backward<B: Backend>(&self, back: Backprop<FloatTensor<B>>) -> [Option<FloatTensor<B>>; 1] {
        let ([], grad) = back.into_parts();
        let device = grad.device();
        let MapShape { batch, channels, height, width } = self.shape;
        let before = [[batch, channels, self.size[0], width], [batch, channels, height, width]];
        let grad = [1, 0].into_iter().zip(before).fold(grad, |grad, (axis, before)| {
            let Along { pixels: [first, second], fractions } = self.along::<B>(axis, &device);
            let of_second = B::float_mul(grad.clone(), fractions);
            let of_first = B::float_sub(grad, of_second.clone());
            let zeros = B::float_zeros(Shape::from(before), &device, of_first.dtype().into());
            let add = |sum, pixels, grad| {
                B::float_select_assign(sum, AXES[axis], pixels, grad, IndexingUpdateOp::Add)
            };
            add(add(zeros, first, of_first), second, of_second)
        });
        [Some(grad)]
    }
}
