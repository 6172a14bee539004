//! Conversion to grey as in OpenCV and Pillow: both compute Rec. 601 luma in fixed point, and sometimes differ by one level.
//! (OpenCV's `imread(..., IMREAD_GRAYSCALE)` uses the decoder's own grey instead, which may differ by a level from its
//! `cvtColor`.)

use crate::{Image, Plane};

/// Shares of red, green and blue in the luma of Rec. 601.
pub const LUMA: [f32; 3] = [0.299, 0.587, 0.114];

/// `cv2.cvtColor(..., COLOR_RGB2GRAY)`: 15 bits, rounded.
/// Defined by `modules/imgproc/src/color.simd_helpers.hpp` and `color_rgb.simd.hpp` of OpenCV.
pub fn opencv_grey([r, g, b]: [u8; 3]) -> u8 {
    ((9798 * u32::from(r) + 19_235 * u32::from(g) + 3735 * u32::from(b) + (1 << 14)) >> 15) as u8
}

/// Pillow's conversion from `RGB` to `L`: 16 bits, rounded.
pub fn pillow_grey([r, g, b]: [u8; 3]) -> u8 {
    ((u32::from(r) * 19_595 + u32::from(g) * 38_470 + u32::from(b) * 7_471 + 0x8000) >> 16) as u8
}

/// [`opencv_grey`] of every pixel, integers in `0..=255`.
pub fn luminance(image: &Image) -> Plane {
    let mut plane = Plane::new(image.width(), image.height());
    for (out, pixel) in plane.pixels_mut().iter_mut().zip(image.pixels()) {
        *out = f32::from(opencv_grey(*pixel));
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
