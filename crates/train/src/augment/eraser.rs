//! Erasing rectangles of frame 2, as if occluded.

use srflow_core::random::Stream;
use srflow_core::{Image, Size};

use super::config::AugmentConfig;

/// With the configured probability, fills one or two rectangles with the frame's mean colour. A rectangle may start at any
/// pixel and is clipped at the border.
pub(super) fn erase(frame: &mut Image, config: &AugmentConfig, stream: &mut Stream) {
    if stream.unit() >= config.eraser_probability {
        return;
    }
    let color = mean_color(frame);
    let Size { width, height } = frame.size();
    for _ in 0..1 + stream.below(2) {
        let [left, top] = [width, height].map(|size| stream.below(size as u32) as usize);
        let [shortest, longest] = config.eraser_sides;
        let mut side = || (shortest + stream.below(longest - shortest + 1)) as usize;
        let (right, bottom) = ((left + side()).min(width), (top + side()).min(height));
        for row in frame.pixels_mut().chunks_exact_mut(width).skip(top).take(bottom - top) {
            row[left..right].fill(color);
        }
    }
}

/// Truncated, as in the reference.
fn mean_color(frame: &Image) -> [u8; 3] {
    let mut sums = [0_u64; 3];
    for pixel in frame.pixels() {
        for (sum, value) in sums.iter_mut().zip(pixel) {
            *sum += u64::from(*value);
        }
    }
    sums.map(|sum| (sum / frame.pixels().len().max(1) as u64) as u8)
}
