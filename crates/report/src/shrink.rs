//! Smaller copies for the report, by area averaging.

use srflow_core::resize::area_means;
use srflow_core::{FlowField, Image, Mask, Plane, Size};

/// An image at most `max_width` wide, its proportions kept.
pub fn shrink_image(image: &Image, max_width: usize) -> Image {
    let size @ Size { width, height } = shrunk(image.size(), max_width);
    if size == image.size() {
        return image.clone();
    }
    let mean = area_means(image.size(), size, |x, y| Some(image.get(x, y).map(f32::from)));
    Image::from_fn(width, height, |x, y| mean[y * width + x].unwrap_or([0.0; 3]).map(|c| (c + 0.5) as u8))
}

/// A flow at most `max_width` wide: each pixel the mean of the known pixels of its area, unknown without any. Values stay
/// in pixels of the full size.
pub fn shrink_flow(flow: &FlowField, max_width: usize) -> FlowField {
    let size @ Size { width, height } = shrunk(flow.size(), max_width);
    let known = |[u, v]: [f32; 2]| (u.is_finite() && v.is_finite()).then_some([u, v]);
    let mean = area_means(flow.size(), size, |x, y| known(flow.get(x, y)));
    FlowField::from_fn(width, height, |x, y| mean[y * width + x].unwrap_or([f32::NAN; 2]))
}

/// A plane at most `max_width` wide: each pixel the mean of the finite pixels of its area, NaN without any.
pub fn shrink_plane(plane: &Plane, max_width: usize) -> Plane {
    let size @ Size { width, height } = shrunk(plane.size(), max_width);
    let finite = |value: f32| value.is_finite().then_some([value]);
    let mean = area_means(plane.size(), size, |x, y| finite(plane.get(x, y)));
    Plane::from_fn(width, height, |x, y| mean[y * width + x].map_or(f32::NAN, |[value]| value))
}

/// The share of set pixels in each area, `0..=1`, at most `max_width` wide.
pub fn shrink_mask(mask: &Mask, max_width: usize) -> Plane {
    let size @ Size { width, height } = shrunk(mask.size(), max_width);
    let mean = area_means(mask.size(), size, |x, y| Some([f32::from(mask.get(x, y))]));
    Plane::from_fn(width, height, |x, y| mean[y * width + x].map_or(0.0, |[share]| share))
}

/// The size after shrinking to `max_width`, at least one pixel each way; never larger than the input.
fn shrunk(size: Size, max_width: usize) -> Size {
    let Size { width, height } = size;
    if width <= max_width {
        return size;
    }
    let max_width = max_width.max(1);
    Size::new(max_width, ((height * max_width + width / 2) / width).max(1))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn shrinking_averages_areas_and_keeps_proportions() {
        let image = Image::from_fn(4, 6, |x, _| if x < 2 { [0, 10, 20] } else { [100, 110, 120] });
        let small = shrink_image(&image, 2);
        assert_eq!(small.size(), Size::new(2, 3));
        assert_eq!((small.get(0, 0), small.get(1, 2)), ([0, 10, 20], [100, 110, 120]));
        // 5 pixels into 2: the middle one is shared.
        let ramp = Plane::from_fn(5, 1, |x, _| x as f32);
        let halves = shrink_plane(&ramp, 2);
        assert!((halves.get(0, 0) - (0.0 + 1.0 + 0.5 * 2.0) / 2.5).abs() < 1e-6);
        assert_eq!(shrink_image(&image, 100), image);
    }

    #[test]
    fn sparse_flow_survives_shrinking() {
        let sparse =
            FlowField::from_fn(8, 8, |x, y| if (x, y) == (1, 1) { [3.0, -2.0] } else { [f32::NAN; 2] });
        let small = shrink_flow(&sparse, 2);
        assert_eq!(small.get(0, 0), [3.0, -2.0]);
        assert!(!small.is_known(1, 0) && !small.is_known(1, 1));
    }
}
