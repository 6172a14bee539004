//! Resizing of feature maps and flows.

use burn::tensor::{Device, Int, Tensor, TensorData};

/// Alignment of the pixel grids of two sizes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Grids {
    /// The centres of the corner pixels (`align_corners=True` of PyTorch).
    CornersOnCorners,
    /// The edges of the image (`align_corners=False`).
    EdgesOnEdges,
    /// Like `EdgesOnEdges`, but antialiased when the size is reduced (`antialias=True`).
    EdgesOnEdgesSmoothed,
    /// The centres of the first pixels, with distances scaled by the ratio of the sizes (`resize_images` of TensorFlow 1).
    FirstOnFirst,
}

/// Resizes `x`, `[batch, channels, height, width]`, to height and width `size` by bilinear interpolation, as PyTorch's
/// `interpolate`.
pub(crate) fn resize(x: Tensor<4>, size: [usize; 2], grids: Grids) -> Tensor<4> {
    let rows = along(x, 2, size[0], grids);
    along(rows, 3, size[1], grids)
}

/// Resizes `flow` to height and width `size`, and scales its vectors to pixels of that size.
pub(crate) fn resize_flow(flow: Tensor<4>, size: [usize; 2], grids: Grids) -> Tensor<4> {
    let [_, _, height, width] = flow.dims();
    if [height, width] == size {
        return flow;
    }
    let scale = [size[1] as f32 / width as f32, size[0] as f32 / height as f32];
    let scale = Tensor::<1>::from_floats(scale, &flow.device()).reshape([1, 2, 1, 1]);
    resize(flow, size, grids) * scale
}

fn along(x: Tensor<4>, axis: usize, size: usize, grids: Grids) -> Tensor<4> {
    let from = x.dims()[axis];
    if from == size {
        return x;
    }
    if grids == Grids::EdgesOnEdgesSmoothed && size < from {
        return smaller(x, axis, size);
    }
    let places: Vec<f64> = (0..size).map(|i| place(i, from, size, grids)).collect();
    let (lower, upper): (Vec<i64>, Vec<i64>) = places
        .iter()
        .map(|place| (place.floor() as i64, (place.floor() as i64 + 1).min(from as i64 - 1)))
        .unzip();
    let fractions: Vec<f32> = places.iter().map(|place| (place - place.floor()) as f32).collect();
    let device = x.device();
    let mut shape = [1; 4];
    shape[axis] = size;
    let fractions = Tensor::<1>::from_data(TensorData::new(fractions, [size]), &device).reshape(shape);
    let lower = x.clone().select(axis, indices(lower, &device));
    let upper = x.select(axis, indices(upper, &device));
    lower.clone() + (upper - lower) * fractions
}

/// Reduces an axis with a triangle filter that reaches to the centres of the neighbouring output pixels.
fn smaller(x: Tensor<4>, axis: usize, size: usize) -> Tensor<4> {
    let from = x.dims()[axis];
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

/// Position of pixel `i` of `size` in a grid of `from` pixels.
fn place(i: usize, from: usize, size: usize, grids: Grids) -> f64 {
    match grids {
        Grids::CornersOnCorners => (i * (from - 1)) as f64 / (size - 1).max(1) as f64,
        Grids::FirstOnFirst => (i * from) as f64 / size as f64,
        Grids::EdgesOnEdges | Grids::EdgesOnEdgesSmoothed => {
            let place = (i as f64 + 0.5) * from as f64 / size as f64 - 0.5;
            place.clamp(0.0, (from - 1) as f64)
        }
    }
}

#[cfg(test)]
mod tests {
    use srflow_golden::numbers;

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
        let resized = |size| numbers(resize(ramp.clone(), [1, size], Grids::EdgesOnEdgesSmoothed));
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
