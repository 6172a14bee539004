//! Linear interpolation that does not alias when downscaling.

use rayon::prelude::*;

use crate::{FlowField, Image, Plane, Size};

/// One output pixel reads the input from `first` on, with these weights, which sum to one.
struct Tap {
    first: usize,
    weights: Vec<f32>,
}

/// Linear interpolation; when downscaling, with a filter as wide as an output pixel, to avoid aliasing. Pixel centres are
/// integers and borders are aligned: `x` of the result is at `(x + 0.5) * input / output - 0.5`.
fn taps(input: usize, output: usize) -> Vec<Tap> {
    let scale = input as f64 / output as f64;
    let reach = scale.max(1.0);
    let tap = |x: usize| {
        let centre = (x as f64 + 0.5) * scale - 0.5;
        let first = (centre - reach).floor().max(0.0) as usize;
        let last = ((centre + reach).ceil() as usize).min(input - 1);
        let weight = |place: usize| (1.0 - (place as f64 - centre).abs() / reach).max(0.0);
        let sum: f64 = (first..=last).map(weight).sum();
        Tap { first, weights: (first..=last).map(|place| (weight(place) / sum) as f32).collect() }
    };
    (0..output).map(tap).collect()
}

/// Rows resized to `size`, with `N` numbers per pixel.
fn resize<T: Copy + Sync, const N: usize>(
    pixels: &[T],
    from: Size,
    size: Size,
    numbers: impl Fn(T) -> [f32; N] + Sync,
) -> Vec<[f32; N]> {
    let (across, down) = (taps(from.width, size.width), taps(from.height, size.height));
    let mut out = vec![[0.0; N]; size.pixels()];
    out.par_chunks_mut(size.width).zip(&down).for_each_init(
        || vec![[0.0_f32; N]; from.width],
        |column_sums, (row, down)| {
            column_sums.fill([0.0; N]);
            for (y, weight) in down.weights.iter().enumerate() {
                let input = &pixels[(down.first + y) * from.width..][..from.width];
                for (sum, pixel) in column_sums.iter_mut().zip(input) {
                    let value = numbers(*pixel);
                    (0..N).for_each(|i| sum[i] += weight * value[i]);
                }
            }
            for (pixel, across) in row.iter_mut().zip(&across) {
                for (value, weight) in column_sums[across.first..].iter().zip(&across.weights) {
                    (0..N).for_each(|i| pixel[i] += weight * value[i]);
                }
            }
        },
    );
    out
}

/// Resizes an image. An image of the same size or without pixels is returned unchanged.
pub fn resize_image_antialiased(image: &Image, size: Size) -> Image {
    if image.size() == size || image.pixels().is_empty() {
        return image.clone();
    }
    let numbers = resize(image.pixels(), image.size(), size, |pixel| pixel.map(f32::from));
    let mut resized = Image::new(size.width, size.height);
    for (pixel, value) in resized.pixels_mut().iter_mut().zip(numbers) {
        *pixel = value.map(|channel| (channel + 0.5) as u8);
    }
    resized
}

/// Resizes a flow, and scales it to pixels of the new size. A flow of the same size or without pixels is returned unchanged.
pub fn resize_flow_antialiased(flow: &FlowField, size: Size) -> FlowField {
    if flow.size() == size || flow.pixels().is_empty() {
        return flow.clone();
    }
    let grow = [size.width as f32 / flow.width() as f32, size.height as f32 / flow.height() as f32];
    let numbers = resize(flow.pixels(), flow.size(), size, |[u, v]| [u * grow[0], v * grow[1]]);
    let mut resized = FlowField::new(size.width, size.height);
    resized.pixels_mut().copy_from_slice(&numbers);
    resized
}

/// Resizes a plane and multiplies it by `gain`. A plane without pixels is returned unchanged.
pub fn resize_plane_antialiased(plane: &Plane, size: Size, gain: f32) -> Plane {
    if plane.pixels().is_empty() {
        return plane.clone();
    }
    let numbers = resize(plane.pixels(), plane.size(), size, |value| [value * gain]);
    Plane::from_buffer(size.width, size.height, numbers.into_flattened())
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A ramp stays a ramp, except at the borders; where pixels do not divide evenly, normalizing the weights shifts it by a small
    /// fraction of a pixel.
    #[test]
    fn resizing_keeps_positions() {
        let flow = FlowField::from_fn(64, 48, |x, y| [x as f32, y as f32]);
        for size in [Size::new(32, 24), Size::new(128, 96), Size::new(21, 31)] {
            let resized = resize_flow_antialiased(&flow, size);
            let Size { width, height } = size;
            let scale = (64.0 / width as f32, 48.0 / height as f32);
            for (x, y) in [(width / 2, height / 2), (width / 3, height - height / 4)] {
                let place = [(x as f32 + 0.5) * scale.0 - 0.5, (y as f32 + 0.5) * scale.1 - 0.5];
                let [u, v] = resized.get(x, y);
                let found = [u * scale.0, v * scale.1];
                let near = |i: usize| (found[i] - place[i]).abs() < 0.05;
                assert!(near(0) && near(1), "{size:?}: {found:?} for {place:?}");
            }
        }
    }

    /// Every other column is black: half the size is grey, neither black nor white.
    #[test]
    fn a_smaller_image_does_not_alias() {
        let image = Image::from_fn(64, 8, |x, _| [if x % 2 == 0 { 0 } else { 255 }; 3]);
        let half = resize_image_antialiased(&image, Size::new(32, 4));
        assert!(half.pixels().iter().all(|pixel| pixel[0].abs_diff(128) < 40), "{:?}", half.row(2));
        assert_eq!(
            resize_image_antialiased(&Image::filled(7, 5, [9, 99, 200]), Size::new(3, 11)),
            Image::filled(3, 11, [9, 99, 200])
        );
    }
}
