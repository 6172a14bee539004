//! How close an avatar comes to the face in frames that it was not trained on.

use std::path::Path;

use srflow_avatar::Avatar;
use srflow_avatar::capture::{Capture, CaptureSplit, Face, Landmarks};
use srflow_avatar::train::{Scorer, read_run};
use srflow_core::{ConvexHull, Image, Size};
use srflow_head::HeadPose;

/// Of held-out frames.
pub struct FaceScores {
    /// PSNR in the hull of the face's landmarks, dB, mean over the frames: hair that moves by itself and shoulders do not count.
    pub psnr: f64,
    /// The frames and the avatar in them, beside each other; as many as were asked for.
    pub shown: Vec<Image>,
}

/// Renders an avatar in the held-out frames of its capture; `None` if there are none with landmarks.
///
/// # Errors
/// When a file of the run cannot be read.
pub fn face_scores(
    run: &Path,
    (avatar, poses): (&Avatar, &[HeadPose]),
    capture: &Capture,
    landmarks: &Landmarks,
    most: usize,
) -> anyhow::Result<Option<FaceScores>> {
    let mut scorer = Scorer::new(read_run(run)?.1);
    let timesteps = capture.timesteps();
    let views: Vec<_> = capture.of(CaptureSplit::Test).collect();
    let every = views.len().div_ceil(most.max(1)).max(1);
    let (mut scores, mut shown) = (Vec::new(), Vec::new());
    for (number, view) in views.iter().enumerate() {
        let Some(face) = landmarks.get(view.timestep, view.camera_index) else { continue };
        scorer.score(avatar, &poses[view.timestep_place(&timesteps)], capture, view)?;
        let pixels = face_pixels(face, view.camera.size());
        let square = |pixel: &usize| -> f64 {
            let levels = scorer.rendered()[*pixel].iter().zip(scorer.picture()[*pixel]);
            levels.map(|(found, truth)| f64::from(found.clamp(0.0, 1.0) - truth).powi(2)).sum::<f64>() / 3.0
        };
        let mean = pixels.iter().map(square).sum::<f64>() / pixels.len() as f64;
        if mean > 0.0 {
            scores.push(-10.0 * mean.log10());
        }
        if number % every == 0 {
            shown.push(beside(scorer.images()));
        }
    }
    let psnr = scores.iter().sum::<f64>() / scores.len() as f64;
    Ok((!scores.is_empty()).then_some(FaceScores { psnr, shown }))
}

/// Places in a picture of this size, row by row, inside of the hull of a face's landmarks.
pub fn face_pixels(face: &Face, Size { width, height }: Size) -> Vec<usize> {
    let hull = ConvexHull::of(face.iter().flatten().copied().collect());
    let inside = |pixel: &usize| hull.contains([(pixel % width) as f64, (pixel / width) as f64]);
    (0..width * height).filter(inside).collect()
}

fn beside([left, right]: [Image; 2]) -> Image {
    let width = left.width();
    Image::from_fn(width + right.width(), left.height(), |x, y| {
        if x < width { left.get(x, y) } else { right.get(x - width, y) }
    })
}
