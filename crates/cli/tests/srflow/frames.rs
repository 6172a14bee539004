//! Frames and pairs to run the binary on.

use std::fs;
use std::path::Path;

use srflow_core::{FlowField, Image, Size};
use srflow_files::{write_flow, write_image_png};

/// Smooth waves that moved `shift` pixels to the right.
pub fn waves(Size { width, height }: Size, shift: f32) -> Image {
    Image::from_fn(width, height, |x, y| {
        let (x, y) = (x as f32 - shift, y as f32);
        let wave = (x * 0.31).sin() + (y * 0.27).sin() + ((x + y) * 0.13).cos() + (x * 0.11 - y * 0.17).sin();
        [(128.0 + 30.0 * wave) as u8, (128.0 + 25.0 * wave) as u8, (99.0 + 20.0 * wave) as u8]
    })
}

/// Frames `0.png`, `1.png`, ... of waves, each moved by two pixels against the one before.
pub fn write_frames(folder: &Path, numbers: impl IntoIterator<Item = usize>, size: Size) {
    fs::create_dir_all(folder).unwrap();
    for number in numbers {
        write_image_png(&folder.join(format!("{number}.png")), &waves(size, 2.0 * number as f32)).unwrap();
    }
}

/// Pairs `p0`, `p1`, ... of a plain folder: different waves, which all move `shift` pixels to the right.
pub fn write_pairs(folder: &Path, count: usize, size: Size, shift: f32) {
    fs::create_dir_all(folder).unwrap();
    for pair in 0..count {
        let file = |ending: &str| folder.join(format!("p{pair}_{ending}"));
        let from = 31.0 * pair as f32;
        write_image_png(&file("img1.png"), &waves(size, from)).unwrap();
        write_image_png(&file("img2.png"), &waves(size, from + shift)).unwrap();
        write_flow(&file("flow.flo"), &FlowField::filled(size.width, size.height, [shift, 0.0])).unwrap();
    }
}
