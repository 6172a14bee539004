//! The part of a frame that a network sees.

use srflow_core::{Image, Size};

/// A rectangle of a frame, rotated; in pixels. As in MediaPipe, pixel 0 is at coordinate 0, and sizes are those of the area between the
/// outer coordinates.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Region {
    pub(crate) centre: [f64; 2],
    /// Width and height before the rotation.
    pub(crate) sides: [f64; 2],
    /// Radians, from right to down.
    pub(crate) rotation: f64,
}

/// What the network sees beyond the border of the frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Beyond {
    Black,
    /// The nearest pixel.
    Nearest,
}

impl Region {
    /// The smallest square that holds the whole frame.
    pub(crate) fn of_frame(frame: &Image) -> Self {
        let whole = Self::stretched(frame);
        let [width, height] = whole.sides;
        Self { sides: [width.max(height); 2], ..whole }
    }

    /// The frame, whatever its aspect ratio is.
    pub(crate) fn stretched(frame: &Image) -> Self {
        let sides = [frame.width() as f64, frame.height() as f64];
        Self { centre: sides.map(|side| side / 2.0), sides, rotation: 0.0 }
    }

    /// The place in the frame of a point of the region, whose sides go from 0 to 1.
    pub(crate) fn place(&self, [x, y]: [f64; 2]) -> [f64; 2] {
        let (sin, cos) = (libm::sin(self.rotation), libm::cos(self.rotation));
        let (x, y) = ((x - 0.5) * self.sides[0], (y - 0.5) * self.sides[1]);
        [self.centre[0] + x * cos - y * sin, self.centre[1] + x * sin + y * cos]
    }

    /// The region as planes of red, green and blue, `size` (height, width) pixels, 0..255 scaled to `range`.
    ///
    /// Sampled as `warpPerspective` of OpenCV 3 does with `INTER_LINEAR`: at positions rounded to 1/32 pixel, rounded to whole levels.
    pub(crate) fn planes(
        &self,
        frame: &Image,
        size: [usize; 2],
        range: [f32; 2],
        beyond: Beyond,
    ) -> Vec<f32> {
        const PARTS: i64 = 32;
        let [height, width] = size;
        let mut out = vec![0.0; 3 * height * width];
        let [low, high] = range;
        let scale = (high - low) / 255.0;
        let parts = |at: f64| (at * PARTS as f64).clamp(-1e12, 1e12).round_ties_even() as i64;
        for (y, x) in (0..height).flat_map(|y| (0..width).map(move |x| (y, x))) {
            let at = self.place([x as f64 / width as f64, y as f64 / height as f64]);
            let [(x0, fx), (y0, fy)] =
                at.map(parts).map(|part| (part.div_euclid(PARTS), part.rem_euclid(PARTS)));
            let taps = [(0, 0), (1, 0), (0, 1), (1, 1)].map(|(right, down)| {
                let weight =
                    (if right == 1 { fx } else { PARTS - fx }) * (if down == 1 { fy } else { PARTS - fy });
                (pixel(frame, x0 + right, y0 + down, beyond), weight)
            });
            for channel in 0..3 {
                let sum: i64 = taps.iter().map(|(pixel, weight)| i64::from(pixel[channel]) * weight).sum();
                let level = (sum + PARTS * PARTS / 2) / (PARTS * PARTS);
                out[(channel * height + y) * width + x] = level as f32 * scale + low;
            }
        }
        out
    }
}

fn pixel(frame: &Image, x: i64, y: i64, beyond: Beyond) -> [u8; 3] {
    let inside = |at: i64, size: usize| (0..size as i64).contains(&at);
    let Size { width, height } = frame.size();
    match beyond {
        Beyond::Black if !inside(x, width) || !inside(y, height) => [0; 3],
        _ => frame.get(x.clamp(0, width as i64 - 1) as usize, y.clamp(0, height as i64 - 1) as usize),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn frame() -> Image {
        Image::from_fn(40, 30, |x, y| [x as u8 * 5, y as u8 * 5, 7])
    }

    #[test]
    fn a_region_of_whole_pixels_is_the_frame() {
        let region = Region { centre: [20.0, 15.0], sides: [16.0; 2], rotation: 0.0 };
        let planes = region.planes(&frame(), [16, 16], [0.0, 255.0], Beyond::Black);
        for (y, x) in (0..16).flat_map(|y| (0..16).map(move |x| (y, x))) {
            assert_eq!(planes[y * 16 + x], 5.0 * (x + 12) as f32);
            assert_eq!(planes[256 + y * 16 + x], 5.0 * (y + 7) as f32);
        }
    }

    #[test]
    fn a_stretched_frame_keeps_no_aspect_ratio() {
        let planes = Region::stretched(&frame()).planes(&frame(), [15, 10], [0.0, 255.0], Beyond::Black);
        for (y, x) in (0..15).flat_map(|y| (0..10).map(move |x| (y, x))) {
            assert_eq!(planes[y * 10 + x], 5.0 * (4 * x) as f32);
            assert_eq!(planes[150 + y * 10 + x], 5.0 * (2 * y) as f32);
        }
    }

    #[test]
    fn a_quarter_turn_exchanges_the_axes() {
        let region = Region { centre: [20.0, 15.0], sides: [16.0; 2], rotation: std::f64::consts::FRAC_PI_2 };
        let planes = region.planes(&frame(), [16, 16], [-1.0, 1.0], Beyond::Black);
        let level = |plane: usize, x: usize, y: usize| (planes[plane * 256 + y * 16 + x] + 1.0) * 127.5;
        // Right in the region is down in the frame, and down is left.
        assert!((level(1, 10, 3) - 5.0 * 17.0).abs() < 1e-3 && (level(0, 10, 3) - 5.0 * 25.0).abs() < 1e-3);
    }

    #[test]
    fn beyond_the_border_there_is_black_or_the_nearest_pixel() {
        let region = Region { centre: [0.0, 0.0], sides: [8.0; 2], rotation: 0.0 };
        let blue = |beyond| region.planes(&frame(), [8, 8], [0.0, 255.0], beyond)[128];
        assert_eq!([blue(Beyond::Black), blue(Beyond::Nearest)], [0.0, 7.0]);
    }
}
