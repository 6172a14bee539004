//! Pairs to train on.

use std::path::Path;

use srflow_core::{FlowField, Image};
use srflow_files::{write_flow, write_image_png};

/// Frame of waves that have moved by `shift` to the right.
pub fn frame(size: usize, number: usize, shift: f32) -> Image {
    Image::from_fn(size, size, |x, y| {
        let (x, y) = (x as f32 - shift + 13.0 * number as f32, y as f32);
        let wave = (x * 0.31).sin() + (y * 0.27).sin() + ((x + y) * 0.13).cos();
        [(128.0 + 30.0 * wave) as u8, (128.0 - 20.0 * wave) as u8, (99.0 + 25.0 * wave) as u8]
    })
}

/// Writes `count` pairs of 72x72, as a plain folder; pair `i` moves `i + 1` pixels to the right.
pub fn make_pairs(dir: &Path, count: usize) {
    for i in 0..count {
        let motion = 1.0 + i as f32;
        let file = |ending: &str| dir.join(format!("p{i}_{ending}"));
        write_image_png(&file("img1.png"), &frame(72, i, 0.0)).unwrap();
        write_image_png(&file("img2.png"), &frame(72, i, motion)).unwrap();
        write_flow(&file("flow.flo"), &FlowField::filled(72, 72, [motion, 0.0])).unwrap();
    }
}
