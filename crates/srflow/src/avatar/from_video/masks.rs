//! Masks of a head in a video, so that what is behind it is not learned as part of it.

use std::path::{Path, PathBuf};

use srflow_avatar::capture::CaptureView;
use srflow_core::{Image, Plane, Size};
use srflow_face::PersonMask;
use srflow_files::{create_folder, read_image};
use srflow_render::generate::write_alpha;

use super::frames::{CAMERA, image_name};
use crate::Watch;

/// Folder of the masks.
pub const MASKS: &str = "fg_masks";

/// How far hair is from the head model, in widths of its silhouette.
const HAIR: f64 = 0.35;

/// As much of the surroundings is taken for hair where no network finds the person.
const GUESSED_HAIR: f64 = 0.1;

/// The path of a timestep's mask below the folder of the capture.
pub fn mask_name(timestep: u32) -> PathBuf {
    Path::new(MASKS).join(format!("{timestep:05}_{CAMERA:02}.png"))
}

/// Writes the masks that are missing, by the place of the view and its picture; `false` when it was stopped.
///
/// # Errors
/// When a picture cannot be read, there is no mask for it, or the mask cannot be written.
pub fn write_masks(
    dir: &Path,
    views: &[CaptureView],
    watch: &Watch,
    mask: impl Fn(usize, &Image) -> anyhow::Result<Plane>,
) -> anyhow::Result<bool> {
    create_folder(&dir.join(MASKS))?;
    let progress = watch.count("masks", views.len() as u64);
    for (place, view) in views.iter().enumerate() {
        if watch.stops() {
            return Ok(false);
        }
        let file = dir.join(mask_name(view.timestep));
        if !file.exists() {
            let image = read_image(&dir.join(image_name(view.timestep)))?;
            write_alpha(&file, &mask(place, &image)?, &mut Vec::new())?;
        }
        progress.inc();
    }
    Ok(true)
}

/// Where there is a person, as far as it is near to the fitted surface and not below it. Without a network for persons, the
/// surroundings of the surface.
///
/// # Errors
/// When the network fails.
pub fn head_mask(image: &Image, shading: &Plane, person: Option<&PersonMask>) -> anyhow::Result<Plane> {
    let near = surroundings(shading, if person.is_some() { HAIR } else { GUESSED_HAIR });
    let Some(person) = person else { return Ok(near) };
    let person = person.mask(image)?;
    Ok(Plane::from_fn(image.width(), image.height(), |x, y| person.get(x, y) * near.get(x, y)))
}

/// 1 on the surface and around it, up to so many of its widths, but not below its lowest row; else 0.
fn surroundings(shading: &Plane, widths: f64) -> Plane {
    let Size { width, height } = shading.size();
    let covered = |x: usize, y: usize| shading.get(x, y) > 0.0;
    let columns: Vec<usize> = (0..width).filter(|x| (0..height).any(|y| covered(*x, y))).collect();
    let rows: Vec<usize> = (0..height).filter(|y| (0..width).any(|x| covered(x, *y))).collect();
    let (Some(left), Some(right), Some(lowest)) = (columns.first(), columns.last(), rows.last()) else {
        return Plane::new(width, height);
    };
    let reach = (widths * (right - left + 1) as f64).round() as usize;
    // Sums over all pixels above and to the left, by which the sum of any box is known.
    let mut sums = vec![0_u32; (width + 1) * (height + 1)];
    for y in 0..height {
        for x in 0..width {
            sums[(y + 1) * (width + 1) + x + 1] =
                u32::from(covered(x, y)) + sums[y * (width + 1) + x + 1] + sums[(y + 1) * (width + 1) + x]
                    - sums[y * (width + 1) + x];
        }
    }
    Plane::from_fn(width, height, |x, y| {
        let (left, right) = (x.saturating_sub(reach), (x + reach + 1).min(width));
        let (top, bottom) = (y.saturating_sub(reach), (y + reach + 1).min(height));
        let at = |x: usize, y: usize| sums[y * (width + 1) + x];
        let any = at(right, bottom) + at(left, top) > at(left, bottom) + at(right, top);
        f32::from(u8::from(any && y <= *lowest))
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_mask_reaches_around_the_surface_but_not_below_it() {
        let shading =
            Plane::from_fn(
                60,
                60,
                |x, y| if (20..40).contains(&x) && (20..40).contains(&y) { 1.0 } else { 0.0 },
            );
        let near = surroundings(&shading, 0.2);
        // A fifth of 20 pixels.
        assert_eq!([near.get(30, 30), near.get(16, 16), near.get(30, 16)], [1.0; 3]);
        assert_eq!([near.get(15, 30), near.get(30, 15), near.get(30, 40), near.get(44, 30)], [0.0; 4]);
        assert!(surroundings(&Plane::new(8, 8), 0.2).pixels().iter().all(|value| *value == 0.0));
    }
}
