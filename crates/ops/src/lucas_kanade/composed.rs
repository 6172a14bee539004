//! The same composed of a backend's own operations.

use burn::backend::tensor::FloatTensor;
use burn::backend::{Backend, TensorMetadata};

use super::{CELL, LucasKanade, PRODUCTS};
use crate::operation::{Backprop, Composition, narrow};

impl Composition<2> for LucasKanade {
    fn composed<B: Backend>(&self, [first, second]: [FloatTensor<B>; 2]) -> Vec<FloatTensor<B>> {
        let [first, second] = [first, second].map(|frames| B::float_mean_dim(frames, 1));
        let change = B::float_sub(second.clone(), first.clone());
        let mean = B::float_mul_scalar(B::float_add(first, second), 0.5.into());
        let [x, y] = [3, 2].map(|axis| slope::<B>(mean.clone(), axis));
        let product = |a: &FloatTensor<B>, b: &FloatTensor<B>| B::float_mul(a.clone(), b.clone());
        let products = vec![
            product(&x, &x),
            product(&x, &y),
            product(&y, &y),
            product(&x, &change),
            product(&y, &change),
        ];
        let pool =
            |x, side, stride, padding| B::avg_pool2d(x, [side; 2], [stride; 2], [padding; 2], false, false);
        let products = pool(B::float_cat(products, 1), CELL, CELL, 0);
        let windows =
            self.radii.map(|radius| self.solved::<B>(pool(products.clone(), 2 * radius + 1, 1, radius)));
        vec![B::float_cat(windows.concat(), 1)]
    }

    fn composed_backward<B: Backend>(&self, _back: Backprop<FloatTensor<B>>) -> [Option<FloatTensor<B>>; 2] {
        [None, None]
    }
}

impl LucasKanade {
    fn solved<B: Backend>(&self, means: FloatTensor<B>) -> Vec<FloatTensor<B>> {
        let [xx, xy, yy, xt, yt]: [FloatTensor<B>; PRODUCTS] =
            std::array::from_fn(|product| narrow::<B>(means.clone(), 1, product, 1));
        let noisy = |squared: FloatTensor<B>| B::float_add_scalar(squared, self.noise.into());
        let limited = |x| B::float_clamp(x, (-self.reach).into(), self.reach.into());
        let product = |a: &FloatTensor<B>, b: &FloatTensor<B>| B::float_mul(a.clone(), b.clone());
        let [noisy_xx, noisy_yy] = [noisy(xx.clone()), noisy(yy.clone())];
        let determinant = B::float_sub(product(&noisy_xx, &noisy_yy), product(&xy, &xy));
        let u = B::float_sub(product(&xy, &yt), product(&noisy_yy, &xt));
        let v = B::float_sub(product(&xy, &xt), product(&noisy_xx, &yt));
        vec![
            limited(B::float_div(u, determinant.clone())),
            limited(B::float_div(v, determinant)),
            B::float_div(xx, noisy_xx),
            B::float_div(yy, noisy_yy),
        ]
    }
}

/// Half of the difference of both neighbours along an axis; beyond the border there is a copy of the last one.
fn slope<B: Backend>(x: FloatTensor<B>, axis: usize) -> FloatTensor<B> {
    let size = x.shape()[axis];
    let part = |from, count| narrow::<B>(x.clone(), axis, from, count);
    let after = B::float_cat(vec![part(1, size - 1), part(size - 1, 1)], axis);
    let before = B::float_cat(vec![part(0, 1), part(0, size - 1)], axis);
    B::float_mul_scalar(B::float_sub(after, before), 0.5.into())
}
