//! The background: a colour, or a still image, made by code or cropped and resized to the frame.

mod procedural;

use std::fmt;
use std::path::{Path, PathBuf};
use std::str::FromStr;

use srflow_core::random::Key;
use srflow_core::{Image, Size, parse_color};
use srflow_files::read_image;
use srflow_head::Look;
use srflow_splat::Frame;

use crate::RenderError;
use crate::error::require;
use crate::setting_files::images_in;

/// The background of the subjects.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Background {
    /// One sRGB colour.
    Colour([u8; 3]),
    /// Made by code, another for each scene: rooms, textures, gradients, lights.
    Procedural,
    /// A random image of this folder for each scene.
    Images(PathBuf),
}

impl FromStr for Background {
    type Err = String;

    /// Parses a colour ([`parse_color`]), `procedural`, or the path of a folder.
    fn from_str(text: &str) -> Result<Self, String> {
        if text == PROCEDURAL {
            return Ok(Self::Procedural);
        }
        match parse_color(text) {
            Ok(colour) => Ok(Self::Colour(colour)),
            Err(expected) if text.starts_with('#') => Err(format!("`{text}`: {expected}")),
            Err(_) => Ok(Self::Images(text.into())),
        }
    }
}

impl fmt::Display for Background {
    /// As [`Background::from_str`] reads it.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Colour([r, g, b]) => write!(f, "#{r:02x}{g:02x}{b:02x}"),
            Self::Procedural => f.pad(PROCEDURAL),
            Self::Images(dir) => dir.display().fmt(f),
        }
    }
}

srflow_core::serialize_as_text!(Background);

/// [`Background::Procedural`] in arguments and in `dataset.json`.
pub(super) const PROCEDURAL: &str = "procedural";

/// The image behind the scene of `key`, whose chosen file is called `name`; `None` for a colour.
pub(super) fn behind(
    background: &Background,
    name: Option<&str>,
    Size { width, height }: Size,
    key: Key,
    look: Look,
) -> Result<Option<Image>, RenderError> {
    Ok(match (background, name) {
        (Background::Images(dir), Some(name)) => Some(load(&dir.join(name), width, height)?),
        (Background::Procedural, _) => Some(procedural::procedural(width, height, key, look)),
        (Background::Images(_), None) | (Background::Colour(_), _) => None,
    })
}

/// The images of the setting `background`.
pub(super) fn images(dir: &Path) -> Result<Vec<(String, u64)>, RenderError> {
    images_in(dir, "background", "white, black, #rrggbb, procedural or a folder of images")
}

/// The image of each scene, if backgrounds are images.
pub(super) fn choose(
    background: &Background,
    scenes: usize,
    seed: u64,
) -> Result<Vec<Option<String>>, RenderError> {
    let Background::Images(dir) = background else { return Ok(vec![None; scenes]) };
    let images = images(dir)?;
    Ok((0..).take(scenes).map(|scene| chosen(&images, scene, seed)).collect())
}

/// The name of the image of a scene; `None` without images.
pub(super) fn chosen(images: &[(String, u64)], scene: u32, seed: u64) -> Option<String> {
    if images.is_empty() {
        return None;
    }
    let count = u32::try_from(images.len()).unwrap_or(u32::MAX);
    let chosen = Key::new(seed).scene(scene).stream("background").below(count);
    images.get(chosen as usize).map(|(name, _)| name.clone())
}

/// Reads an image, and crops its centre and resizes it to `width` by `height`.
fn load(path: &Path, width: usize, height: usize) -> Result<Image, RenderError> {
    let image = read_image(path)?;
    let expected = "an image with at least one pixel";
    require("background", path.display(), expected, !image.pixels().is_empty())?;
    Ok(fill(&image, width, height))
}

/// Area averaging when the image shrinks, bilinear interpolation when it grows.
fn fill(image: &Image, width: usize, height: usize) -> Image {
    let scale = (image.width() as f64 / width as f64).min(image.height() as f64 / height as f64);
    let columns = taps(width, image.width(), scale);
    let rows = taps(height, image.height(), scale);
    Image::from_fn(width, height, |x, y| {
        let mut sum = [0.0; 3];
        for &(row, row_weight) in &rows[y] {
            for &(column, column_weight) in &columns[x] {
                let pixel = image.get(column, row);
                for channel in 0..3 {
                    sum[channel] += row_weight * column_weight * f64::from(pixel[channel]);
                }
            }
        }
        sum.map(|value| (value + 0.5) as u8)
    })
}

/// For each of `targets` pixels, the source pixels under a tent filter as wide as the pixel (at least one source pixel), with
/// weights that sum to 1.
fn taps(targets: usize, sources: usize, scale: f64) -> Vec<Vec<(usize, f64)>> {
    let reach = scale.max(1.0);
    let first = (sources as f64 - scale * targets as f64) / 2.0;
    let of = |target: usize| {
        let centre = first + (target as f64 + 0.5) * scale - 0.5;
        let last = sources - 1;
        let from = (centre - reach).ceil().clamp(0.0, last as f64) as usize;
        let to = (centre + reach).floor().clamp(0.0, last as f64) as usize;
        let weight = |source: usize| (1.0 - (source as f64 - centre).abs() / reach).max(0.0);
        let sum: f64 = (from..=to).map(weight).sum();
        if sum > 0.0 {
            (from..=to).map(|source| (source, weight(source) / sum)).collect()
        } else {
            vec![(from, 1.0)]
        }
    };
    (0..targets).map(of).collect()
}

/// Blends the background, unless it is a colour, into a frame that was then rendered over black.
pub(super) fn composite(frame: &mut Frame, behind: Option<&Image>) {
    let Some(behind) = behind else { return };
    let pixels = frame.image.pixels_mut().iter_mut().zip(frame.alpha.pixels()).zip(behind.pixels());
    for ((pixel, &alpha), behind) in pixels {
        let seen_through = 1.0 - alpha;
        for (value, &behind) in pixel.iter_mut().zip(behind) {
            *value = (f32::from(*value) + seen_through * f32::from(behind) + 0.5) as u8;
        }
    }
}

#[cfg(test)]
mod tests {
    use srflow_core::Plane;

    use super::*;

    #[test]
    fn colours_and_folders_are_distinguished() {
        assert_eq!("white".parse(), Ok(Background::Colour([255; 3])));
        assert_eq!("#0a80fF".parse(), Ok(Background::Colour([10, 128, 255])));
        assert_eq!("procedural".parse(), Ok(Background::Procedural));
        assert_eq!("images/indoor".parse(), Ok(Background::Images("images/indoor".into())));
        for text in ["#12345", "#1234567", "#12345g", "#+12345"] {
            assert!(text.parse::<Background>().unwrap_err().contains(text));
        }
    }

    #[test]
    fn an_image_keeps_its_middle_and_its_mean() {
        let gradient = Image::from_fn(400, 100, |x, _| [(x / 2) as u8, 100, 7]);
        let small = fill(&gradient, 20, 10); // the middle 200x100, ten to one
        assert_eq!(small.get(5, 5)[1..], [100, 7]);
        for x in 1..19 {
            let expected = (100.0 + 10.0 * x as f64 + 4.5) / 2.0;
            assert!((f64::from(small.get(x, 4)[0]) - expected).abs() <= 1.0, "{x}: {:?}", small.get(x, 4));
        }
        let large = fill(&gradient, 800, 400); // the middle 200x100, one to four
        assert_eq!(large.size(), Size::new(800, 400));
        assert!((i32::from(large.get(400, 200)[0]) - 100).abs() <= 1);
    }

    #[test]
    fn the_background_is_weighted_by_one_minus_alpha() {
        let mut frame = Frame::new();
        frame.image = Image::from_fn(3, 1, |x, _| [[0; 3], [60, 0, 0], [200, 10, 0]][x]);
        frame.alpha = Plane::from_fn(3, 1, |x, _| [0.0, 0.5, 1.0][x]);
        composite(&mut frame, Some(&Image::filled(3, 1, [100, 50, 255])));
        assert_eq!(frame.image.pixels(), [[100, 50, 255], [110, 25, 128], [200, 10, 0]]);
    }

    #[test]
    fn each_scene_draws_its_image_by_its_number() {
        let dir = tempfile::tempdir().unwrap();
        for name in ["b.png", "a.JPG", "notes.txt", "c.bmp"] {
            std::fs::write(dir.path().join(name), "x").unwrap();
        }
        let background = Background::Images(dir.path().to_owned());
        let many = choose(&background, 40, 3).unwrap();
        assert_eq!(choose(&background, 5, 3).unwrap(), many[..5]);
        for name in ["a.JPG", "b.png", "c.bmp"] {
            assert!(many.iter().flatten().any(|chosen| chosen == name));
        }
        std::fs::remove_file(dir.path().join("b.png")).unwrap();
        std::fs::remove_file(dir.path().join("a.JPG")).unwrap();
        std::fs::remove_file(dir.path().join("c.bmp")).unwrap();
        assert!(choose(&background, 1, 3).unwrap_err().to_string().contains("a folder with images"));
    }
}
