//! Luminance of an sRGB image as OpenCV's `COLOR_RGB2GRAY` has it.

use srflow_field::{Image, Plane};

/// Rec. 601 luma in fixed point with 15 bits, rounded to a whole number in `0..=255`.
/// Defined by `modules/imgproc/src/color.simd_helpers.hpp` and `color_rgb.simd.hpp` of OpenCV.
pub fn luminance(image: &Image) -> Plane {
    let luma = |&[r, g, b]: &[u8; 3]| {
        let sum = 9798 * u32::from(r) + 19_235 * u32::from(g) + 3735 * u32::from(b);
        ((sum + (1 << 14)) >> 15) as f32
    };
    let mut plane = Plane::new(image.width(), image.height());
    for (out, pixel) in plane.pixels_mut().iter_mut().zip(image.pixels()) {
        *out = luma(pixel);
    }
    plane
}

#[cfg(test)]
mod tests {
    use super::*;

    /// From `cv2.cvtColor(pixel, cv2.COLOR_RGB2GRAY)`.
    #[test]
    fn luminance_rounds_as_opencv() {
        let image = Image::from_pixels(
            8,
            1,
            vec![
                [0, 0, 0],
                [255, 255, 255],
                [255, 0, 0],
                [0, 255, 0],
                [0, 0, 255],
                [10, 20, 30],
                [200, 3, 77],
                [1, 1, 2],
            ],
        )
        .unwrap();
        assert_eq!(luminance(&image).pixels(), [0.0, 255.0, 76.0, 150.0, 29.0, 18.0, 70.0, 1.0]);
    }
}
