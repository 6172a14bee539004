//! Brightness, contrast, saturation and hue, bit-identical to torchvision's `ColorJitter` on 8-bit pictures (which delegates
//! to Pillow).

use srflow_core::random::Stream;
use srflow_core::{Image, pillow_grey};

use super::config::AugmentConfig;
use super::hue::{HueTables, is_grey};

/// One of the four adjustments.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Change {
    /// Blends with black; 1 is the identity.
    Brightness(f32),
    /// Blends with the mean grey of all pictures; 1 is the identity.
    Contrast(f32),
    /// Blends with the picture in grey; 1 is the identity.
    Saturation(f32),
    /// Rotates the hue, in turns.
    Hue(f32),
}

/// Colour adjustments in the order they are applied.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct ColorJitter(pub(super) Vec<Change>);

impl ColorJitter {
    /// The four adjustments in random order with random strengths; those with a limit of zero are left out.
    pub(super) fn draw(config: &AugmentConfig, stream: &mut Stream) -> Self {
        let mut factor = |change: f32| stream.uniform((1.0 - change).max(0.0), 1.0 + change);
        let mut changes = vec![
            (config.brightness, Change::Brightness(factor(config.brightness))),
            (config.contrast, Change::Contrast(factor(config.contrast))),
            (config.saturation, Change::Saturation(factor(config.saturation))),
            (config.hue, Change::Hue(stream.uniform(-config.hue, config.hue))),
        ];
        stream.shuffle(&mut changes);
        Self(changes.into_iter().filter(|(amount, _)| *amount > 0.0).map(|(_, change)| change).collect())
    }

    /// Adjusts several pictures as if they were one.
    pub(super) fn apply(&self, pictures: &mut [&mut Image], hue: &HueTables) {
        for change in &self.0 {
            match *change {
                Change::Brightness(factor) => {
                    for picture in pictures.iter_mut() {
                        mix(picture.pixels_mut().as_flattened_mut(), 0, factor);
                    }
                }
                Change::Contrast(factor) => {
                    let grey = mean_grey(pictures);
                    for picture in pictures.iter_mut() {
                        mix(picture.pixels_mut().as_flattened_mut(), grey, factor);
                    }
                }
                Change::Saturation(factor) => {
                    for pixel in pictures.iter_mut().flat_map(|picture| picture.pixels_mut()) {
                        // Grey stays grey; much of a rendered frame is.
                        if !is_grey(*pixel) {
                            let grey = pillow_grey(*pixel);
                            *pixel = pixel.map(|value| mixed(grey, value, factor));
                        }
                    }
                }
                Change::Hue(turns) => {
                    // The circle has 256 steps, of which 255 are a turn; fractions of a step are dropped.
                    let steps = (turns * 255.0) as i32 as u8;
                    for picture in pictures.iter_mut() {
                        hue.turn(picture.pixels_mut(), steps);
                    }
                }
            }
        }
    }
}

/// Pillow's blend of two values: the fraction `factor` of the way from `from` to `to`, or beyond.
fn mixed(from: u8, to: u8, factor: f32) -> u8 {
    // The cast truncates, and saturates at 0 and 255.
    (f32::from(from) + factor * f32::from(i16::from(to) - i16::from(from))) as u8
}

fn mix(values: &mut [u8], from: u8, factor: f32) {
    let table: [u8; 256] = std::array::from_fn(|value| mixed(from, value as u8, factor));
    for value in values {
        *value = table[usize::from(*value)];
    }
}

/// The mean of the grey of all pixels, rounded.
fn mean_grey(pictures: &[&mut Image]) -> u8 {
    let pixels: usize = pictures.iter().map(|picture| picture.pixels().len()).sum();
    let row = |row: &[[u8; 3]]| row.iter().map(|pixel| u32::from(pillow_grey(*pixel))).sum::<u32>();
    let sum: u64 = pictures
        .iter()
        .flat_map(|picture| picture.pixels().chunks(1 << 16))
        .map(|chunk| u64::from(row(chunk)))
        .sum();
    (sum as f64 / pixels.max(1) as f64 + 0.5) as u8
}
