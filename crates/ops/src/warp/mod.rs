//! Backward warping: the second image sampled at the positions that the flow points to, bilinearly, zero outside (PyTorch's
//! `grid_sample` with `align_corners=True` and zero padding). [`mod@reference`] is the definition.

mod backward;
#[cfg(feature = "cube")]
mod cube;
mod forward;
pub mod reference;
pub mod tensor;

pub use backward::warp_backward;
pub use forward::warp;

/// The sampling position of one pixel: the four pixels around it, without those outside.
struct Corners {
    /// Index of each corner (top left, top right, bottom left, bottom right) that is inside.
    pixels: [Option<usize>; 4],
    /// Distance from the left and from the upper corners.
    fraction: [f32; 2],
}

impl Corners {
    /// Around pixel `(x, y)` displaced by `(u, v)`.
    fn new([height, width]: [usize; 2], [x, y]: [usize; 2], [u, v]: [f32; 2]) -> Self {
        let (x, y) = (x as f32 + u, y as f32 + v);
        let (left, top) = (x.floor(), y.floor());
        // Compared as floats before any cast: a flow may have any value, including NaN.
        let inside = |at: f32, size: usize| at >= 0.0 && at < size as f32;
        let pixel = |dx: f32, dy: f32| {
            let (x, y) = (left + dx, top + dy);
            (inside(x, width) && inside(y, height)).then(|| y as usize * width + x as usize)
        };
        let pixels = [pixel(0.0, 0.0), pixel(1.0, 0.0), pixel(0.0, 1.0), pixel(1.0, 1.0)];
        Self { pixels, fraction: [x - left, y - top] }
    }

    fn weights(&self) -> [f32; 4] {
        let [x, y] = self.fraction;
        [(1.0 - x) * (1.0 - y), x * (1.0 - y), (1.0 - x) * y, x * y]
    }

    /// The values of a plane at the corners, zero outside.
    fn values(&self, plane: &[f32]) -> [f32; 4] {
        self.pixels.map(|pixel| pixel.map_or(0.0, |pixel| plane[pixel]))
    }
}

#[cfg(test)]
pub(crate) mod tests;
