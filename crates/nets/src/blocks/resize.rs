//! Resizing of feature maps and flows.

use burn::tensor::{Device, Int, Tensor, TensorData};
pub(crate) use srflow_ops::resize::Grids;
pub(crate) use srflow_ops::resize::tensor::resize;

/// Resizes `flow` to height and width `size`, and scales its vectors to pixels of that size.
pub(crate) fn resize_flow(flow: Tensor<4>, size: [usize; 2], grids: Grids) -> Tensor<4> {
    scaled_flow(flow, size, |flow| resize(flow, size, grids))
}

/// As [`resize_flow`], by [`resize_smoothed`].
pub(crate) fn resize_flow_smoothed(flow: Tensor<4>, size: [usize; 2]) -> Tensor<4> {
    scaled_flow(flow, size, |flow| resize_smoothed(flow, size))
}

fn scaled_flow(flow: Tensor<4>, size: [usize; 2], resize: impl Fn(Tensor<4>) -> Tensor<4>) -> Tensor<4> {
    let [_, _, height, width] = flow.dims();
    if [height, width] == size {
        return flow;
    }
    let scale = [size[1] as f32 / width as f32, size[0] as f32 / height as f32];
    let scale = Tensor::<1>::from_floats(scale, &flow.device()).reshape([1, 2, 1, 1]);
    resize(flow) * scale
}

/// As [`resize`] with [`Grids::EdgesOnEdges`], but antialiased along an axis whose size is reduced (`antialias=True` of PyTorch).
pub(crate) fn resize_smoothed(x: Tensor<4>, size: [usize; 2]) -> Tensor<4> {
    let [_, _, height, width] = x.dims();
    let enlarged = resize(x, [height.max(size[0]), width.max(size[1])], Grids::EdgesOnEdges);
    [2, 3].into_iter().zip(size).fold(enlarged, |x, (axis, size)| smaller(x, axis, size))
}

/// Reduces an axis with a triangle filter that reaches to the centres of the neighbouring output pixels.
fn smaller(x: Tensor<4>, axis: usize, size: usize) -> Tensor<4> {
    let from = x.dims()[axis];
    if from == size {
        return x;
    }
    let width = from as f64 / size as f64;
    let centre = |i: usize| (i as f64 + 0.5) * width - 0.5;
    let weight = |i: usize, j: usize| (1.0 - (j as f64 - centre(i)).abs() / width).max(0.0);
    let first = |i: usize| (centre(i) - width).ceil().max(0.0) as usize;
    let sums: Vec<f64> =
        (0..size).map(|i| (first(i)..from.min(first(i) + taps(width))).map(|j| weight(i, j)).sum()).collect();
    let device = x.device();
    let mut shape = [1; 4];
    shape[axis] = size;
    (0..taps(width))
        .map(|tap| {
            let places = (0..size).map(|i| first(i) + tap);
            let weights = places
                .clone()
                .enumerate()
                .map(|(i, j)| if j < from { (weight(i, j) / sums[i]) as f32 } else { 0.0 });
            let weights = TensorData::new(weights.collect::<Vec<f32>>(), [size]);
            let places = places.map(|j| j.min(from - 1) as i64).collect();
            let pixels = x.clone().select(axis, indices(places, &device));
            pixels * Tensor::<1>::from_data(weights, &device).reshape(shape)
        })
        .reduce(|sum, tap| sum + tap)
        .unwrap_or(x)
}

/// Most input pixels within a distance of `width` from a point.
fn taps(width: f64) -> usize {
    (2.0 * width).floor() as usize + 1
}

fn indices(of: Vec<i64>, device: &Device) -> Tensor<1, Int> {
    let count = of.len();
    Tensor::from_data(TensorData::new(of, [count]), device)
}

#[cfg(test)]
mod tests {
    use srflow_ops::golden::numbers;

    use super::*;

    fn row(values: [f32; 3]) -> Tensor<4> {
        Tensor::<1>::from_floats(values, &Device::flex()).reshape([1, 1, 1, 3])
    }

    /// Expected values: `torch.nn.functional.interpolate`.
    #[test]
    fn resizing_matches_pytorch_with_either_alignment() {
        let resized = |size, grids| numbers(resize(row([0.0, 6.0, 0.0]), [2, size], grids));
        let corners = [0.0, 3.0, 6.0, 3.0, 0.0];
        assert_eq!(resized(5, Grids::CornersOnCorners), [corners, corners].concat());
        let edges = [0.0, 1.5, 4.5, 4.5, 1.5, 0.0];
        assert_eq!(resized(6, Grids::EdgesOnEdges), [edges, edges].concat());
        assert_eq!(resized(1, Grids::CornersOnCorners), [0.0, 0.0]);
    }

    #[test]
    fn reduced_maps_are_antialiased() {
        let ramp = Tensor::<1>::from_floats([0., 1., 2., 3., 10.], &Device::flex()).reshape([1, 1, 1, 5]);
        let resized = |size| numbers(resize_smoothed(ramp.clone(), [1, size]));
        let expected = [0.428571, 2.0, 6.999999];
        for (found, expected) in resized(3).into_iter().zip(expected) {
            assert!((found - expected).abs() < 1e-6, "{found}, not {expected}");
        }
        assert_eq!(resized(5), [0., 1., 2., 3., 10.]);
        // Enlarged maps are interpolated.
        assert_eq!(resized(10)[..4], [0., 0.25, 0.75, 1.25]);
    }

    /// Expected values: `tf.image.resize_images` of TensorFlow 1.
    #[test]
    fn resizing_matches_tensorflow() {
        let resized = numbers(resize(row([0.0, 6.0, 0.0]), [1, 6], Grids::FirstOnFirst));
        assert_eq!(resized, [0.0, 3.0, 6.0, 3.0, 0.0, 0.0]);
    }

    #[test]
    fn resized_flow_is_in_pixels_of_the_new_size() {
        let flow = Tensor::<4>::ones([1, 2, 4, 8], &Device::flex());
        let resized = resize_flow(flow, [6, 4], Grids::CornersOnCorners);
        assert_eq!(numbers(resized), [vec![0.5; 24], vec![1.5; 24]].concat());
    }
}
