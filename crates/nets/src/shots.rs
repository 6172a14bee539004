//! Detects cuts between the shots of a video.

use srflow_core::{Image, Size};

/// Cells along each side of a frame.
const CELLS: usize = 4;
/// Threshold in grey levels. Pans by a tenth of the frame stay below 30, frames of unrelated scenes lie above 40.
const MAX_DISTANCE: f64 = 30.0;

/// Whether there is a cut between two consecutive frames of one size: whether the histograms of each of 4x4 cells and each
/// channel are more than 30 grey levels apart on average (1-Wasserstein distance). Small motion hardly changes them, as it
/// leaves most pixels in their cell.
pub(crate) fn is_cut(before: &Image, after: &Image) -> bool {
    let (before, after) = (histograms(before), histograms(after));
    let distances = before.iter().zip(&after).flat_map(|(a, b)| a.iter().zip(b)).map(|(a, b)| distance(a, b));
    let (sum, count) = distances.flatten().fold((0.0, 0), |(sum, count), far| (sum + far, count + 1));
    sum > MAX_DISTANCE * f64::from(count)
}

/// Number of pixels per grey level.
type Histogram = [u32; 256];

/// Histograms of each cell and channel.
fn histograms(frame: &Image) -> Vec<[Histogram; 3]> {
    let Size { width, height } = frame.size();
    let mut cells = vec![[[0; 256]; 3]; CELLS * CELLS];
    for (y, row) in frame.pixels().chunks_exact(width.max(1)).enumerate() {
        let first = y * CELLS / height * CELLS;
        for (x, pixel) in row.iter().enumerate() {
            let cell = &mut cells[first + x * CELLS / width];
            for (histogram, &level) in cell.iter_mut().zip(pixel) {
                histogram[usize::from(level)] += 1;
            }
        }
    }
    cells
}

/// 1-Wasserstein distance of two histograms: the area between the cumulative ones. `None` for a cell without pixels.
fn distance(a: &Histogram, b: &Histogram) -> Option<f64> {
    let pixels: u32 = a.iter().sum();
    let (mut ahead, mut area) = (0_i64, 0);
    for (a, b) in a.iter().zip(b) {
        ahead += i64::from(*a) - i64::from(*b);
        area += ahead.unsigned_abs();
    }
    (pixels > 0).then(|| area as f64 / f64::from(pixels))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn textured(seed: usize, brighter: u8) -> impl Fn(usize, usize) -> [u8; 3] {
        move |x, y| {
            let wave = |a: f32, b: f32| {
                let phase = seed as f32 * 1.7 + a;
                ((a * x as f32 * 0.03 + b * y as f32 * 0.05 + phase).sin() * 90.0 + 128.0) as u8
            };
            [wave(0.7, 0.4), wave(-0.5, 1.1), wave(1.3, -0.3)].map(|level| level.saturating_add(brighter))
        }
    }

    #[test]
    fn only_another_scene_is_a_cut() {
        let (width, height) = (320, 200);
        let frame = |seed, shift: (usize, usize), brighter| {
            let color = textured(seed, brighter);
            Image::from_fn(width, height, |x, y| color(x + shift.0, y + shift.1))
        };
        let first = frame(0, (0, 0), 0);
        for (shift, brighter) in [((0, 0), 0), ((1, 0), 0), ((16, 8), 0), ((0, 0), 20)] {
            let second = frame(0, shift, brighter);
            assert!(!is_cut(&first, &second), "{shift:?}, {brighter} brighter");
        }
        let mirrored = Image::from_fn(width, height, |x, y| first.get(width - 1 - x, y));
        let negative = Image::from_fn(width, height, |x, y| first.get(x, y).map(|level| 255 - level));
        for second in [frame(1, (0, 0), 0), mirrored, negative, Image::new(width, height)] {
            assert!(is_cut(&first, &second));
        }
    }

    #[test]
    fn frames_of_any_size_can_be_compared() {
        for (width, height) in [(0, 0), (1, 1), (3, 2), (5, 1)] {
            let black = Image::new(width, height);
            let white = Image::filled(width, height, [255; 3]);
            assert!(!is_cut(&black, &black), "{width}x{height}");
            assert_eq!(is_cut(&black, &white), width > 0, "{width}x{height}");
        }
    }
}
