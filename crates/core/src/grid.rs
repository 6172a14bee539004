use crate::Size;

/// The length of a pixel buffer does not match its size.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{size} needs {expected} pixels, the buffer has {found}")]
pub struct SizeError {
    pub size: Size,
    /// Its width times its height.
    pub expected: usize,
    pub found: usize,
}

/// Two grids that must have the same size do not.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{first_name} is {first} and {second_name} {second} (WIDTHxHEIGHT): they must have the same size")]
pub struct SizeMismatch {
    /// Name of the first, e.g. `the prediction`.
    pub first_name: &'static str,
    pub first: Size,
    pub second_name: &'static str,
    pub second: Size,
}

pub(crate) fn check_same_size(
    first_name: &'static str,
    first: Size,
    second_name: &'static str,
    second: Size,
) -> Result<(), SizeMismatch> {
    if first == second { Ok(()) } else { Err(SizeMismatch { first_name, first, second_name, second }) }
}

macro_rules! grid {
    ($(#[$doc:meta])* $name:ident, $pixel:ty, $blank:expr) => {
        $(#[$doc])*
        #[derive(Debug, Clone, PartialEq)]
        pub struct $name {
            width: usize,
            height: usize,
            pixels: Vec<$pixel>,
        }

        impl $name {
            /// All pixels at their blank value (zero).
            pub fn new(width: usize, height: usize) -> Self {
                Self::filled(width, height, $blank)
            }

            /// All pixels at `value`.
            pub fn filled(width: usize, height: usize, value: $pixel) -> Self {
                Self { width, height, pixels: vec![value; width * height] }
            }

            /// Wraps a row-major buffer.
            ///
            /// # Errors
            /// When the buffer does not have `width * height` pixels.
            pub fn from_pixels(width: usize, height: usize, pixels: Vec<$pixel>) -> Result<Self, SizeError> {
                let expected = width.saturating_mul(height);
                if pixels.len() != expected {
                    let size = Size { width, height };
                    return Err(SizeError { size, expected, found: pixels.len() });
                }
                Ok(Self { width, height, pixels })
            }

            /// Wraps a row-major buffer. Panics unless it has `width * height` pixels.
            pub fn from_buffer(width: usize, height: usize, pixels: Vec<$pixel>) -> Self {
                assert_eq!(pixels.len(), width * height, "pixels of {width}x{height}");
                Self { width, height, pixels }
            }

            /// Computes each pixel from its column `x` and row `y`.
            pub fn from_fn(width: usize, height: usize, mut pixel: impl FnMut(usize, usize) -> $pixel) -> Self {
                let mut pixels = Vec::with_capacity(width * height);
                for y in 0..height {
                    for x in 0..width {
                        pixels.push(pixel(x, y));
                    }
                }
                Self { width, height, pixels }
            }

            /// Width in pixels.
            pub fn width(&self) -> usize {
                self.width
            }

            /// Height in pixels.
            pub fn height(&self) -> usize {
                self.height
            }

            /// Width and height.
            pub fn size(&self) -> Size {
                Size::new(self.width, self.height)
            }

            /// The pixel at column `x` and row `y`. Panics when out of range, like slices.
            pub fn get(&self, x: usize, y: usize) -> $pixel {
                assert!(x < self.width, "column {x} of {}", self.width);
                self.pixels[y * self.width + x]
            }

            /// Sets the pixel at column `x` and row `y`. Panics when out of range, like slices.
            pub fn set(&mut self, x: usize, y: usize, value: $pixel) {
                assert!(x < self.width, "column {x} of {}", self.width);
                self.pixels[y * self.width + x] = value;
            }

            /// Row `y`. Panics when out of range, like slices.
            pub fn row(&self, y: usize) -> &[$pixel] {
                &self.pixels[y * self.width..(y + 1) * self.width]
            }

            /// All pixels, row-major.
            pub fn pixels(&self) -> &[$pixel] {
                &self.pixels
            }

            /// All pixels, row-major.
            pub fn pixels_mut(&mut self) -> &mut [$pixel] {
                &mut self.pixels
            }

            /// The row-major buffer.
            pub fn into_pixels(self) -> Vec<$pixel> {
                self.pixels
            }

            /// Those of one height beside each other, from left to right. Panics when their heights differ.
            pub fn beside(all: &[Self]) -> Self {
                let height = all.first().map_or(0, Self::height);
                assert!(all.iter().all(|one| one.height == height), "heights differ");
                let width = all.iter().map(Self::width).sum();
                let pixels = (0..height).flat_map(|y| all.iter().flat_map(move |one| one.row(y))).copied().collect();
                Self { width, height, pixels }
            }

            /// The rectangle of `width` by `height` whose top left pixel is `(left, top)`.
            /// Panics when it is not inside.
            pub fn crop(&self, left: usize, top: usize, width: usize, height: usize) -> Self {
                assert!(left + width <= self.width && top + height <= self.height, "crop outside the image");
                let mut pixels = Vec::with_capacity(width * height);
                for y in top..top + height {
                    pixels.extend_from_slice(&self.row(y)[left..left + width]);
                }
                Self { width, height, pixels }
            }
        }
    };
}

grid! {
    /// An sRGB image, 8 bits per channel, `H x W x 3`.
    Image, [u8; 3], [0; 3]
}
grid! {
    /// One `f32` per pixel, `H x W`: luminance, alpha, depth.
    Plane, f32, 0.0
}
grid! {
    /// One boolean per pixel, `H x W`. A mask of the head is `true` on the head.
    Mask, bool, false
}
grid! {
    /// One number per pixel, `H x W`, that says what the pixel shows; the file or function it comes from says which number is what.
    Labels, u8, 0
}
grid! {
    /// Optical flow, `H x W x 2` in pixels: `[u, v]`, `u` to the right, `v` down, from frame 1 to frame 2, stored at frame 1's
    /// pixel. A pixel with unknown flow (no ground truth) is NaN in both components; all other values are finite.
    FlowField, [f32; 2], [0.0; 2]
}

impl FlowField {
    /// Whether the flow at column `x` and row `y` is known.
    pub fn is_known(&self, x: usize, y: usize) -> bool {
        let [u, v] = self.get(x, y);
        u.is_finite() && v.is_finite()
    }

    /// `true` where the flow is known.
    pub fn known(&self) -> Mask {
        let pixels = self.pixels.iter().map(|[u, v]| u.is_finite() && v.is_finite()).collect();
        Mask { width: self.width, height: self.height, pixels }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn grids_beside_each_other_keep_their_rows() {
        let grid = |width, first: f32| Plane::from_fn(width, 2, |x, y| first + (y * width + x) as f32);
        let both = Plane::beside(&[grid(1, 0.0), grid(3, 10.0)]);
        assert_eq!(both.size(), Size::new(4, 2));
        assert_eq!(both.pixels(), [0.0, 10.0, 11.0, 12.0, 1.0, 13.0, 14.0, 15.0]);
        assert_eq!(Plane::beside(&[]).size(), Size::new(0, 0));
    }
}
