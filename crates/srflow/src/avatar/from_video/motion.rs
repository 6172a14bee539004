//! How far an avatar's flow is from the flow that is measured in the video.

use srflow_avatar::capture::{Capture, CaptureSplit, Landmarks};
use srflow_avatar::{Avatar, PosedHead};
use srflow_core::{Tolerance, forward_backward_check, median};
use srflow_head::HeadPose;
use srflow_splat::{DeviceRasterizer, Frame, Gaussians, Next, Options, Outputs};

use super::scores::face_pixels;
use crate::Watch;
use crate::methods::{MethodParameters, MethodSpec, estimator};

/// Pairs that are looked at.
const MOST: usize = 16;

/// Over the pixels of the face at which the measured flow agrees with itself forwards and backwards.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize)]
pub struct MotionScores {
    /// Pairs of a held-out frame and the next frame that was chosen.
    pub pairs: usize,
    /// Median distance between both flows, pixels: an estimate of the label error, though the measured flow is not exact either.
    pub distance: f64,
    /// Median length of the measured flow, pixels.
    pub length: f64,
}

/// Compares both flows in held-out frames; `None` if there is no such pair, or the flow agrees with itself nowhere.
///
/// # Errors
/// When a file of the run cannot be read.
pub fn motion_scores(
    (avatar, poses): (&Avatar, &[HeadPose]),
    capture: &Capture,
    landmarks: &Landmarks,
    watch: &Watch,
) -> anyhow::Result<Option<MotionScores>> {
    let estimator = estimator(&MethodSpec::default(), &MethodParameters::default(), watch)?;
    let timesteps = capture.timesteps();
    let pairs: Vec<_> = capture
        .of(CaptureSplit::Test)
        .filter_map(|view| Some((view, capture.view_at(view.timestep.checked_add(1)?, view.camera_index)?)))
        .collect();
    let outputs = Outputs { flow: true, alpha: true, ..Outputs::NONE };
    let options = Options { outputs, ..Options::default() };
    let (mut rasterizer, mut frame) = (DeviceRasterizer::default(), Frame::default());
    let (mut head, mut now, mut next) = (PosedHead::default(), Gaussians::default(), Gaussians::default());
    let (mut distances, mut lengths, mut used) = (Vec::new(), Vec::new(), 0);
    let progress = watch.count("pairs", pairs.len().min(MOST) as u64);
    for (from, to) in pairs.iter().step_by(pairs.len().div_ceil(MOST).max(1)) {
        let Some(face) = landmarks.get(from.timestep, from.camera_index) else { continue };
        let [first, second] = [capture.image(from)?, capture.image(to)?];
        let forward = estimator.estimate(&first, &second)?;
        let backward = estimator.estimate(&second, &first)?;
        let trusted = forward_backward_check(&forward, &backward, Tolerance::UNFLOW)?;
        avatar.gaussians_into(&poses[to.timestep_place(&timesteps)], &mut head, &mut next);
        avatar.gaussians_into(&poses[from.timestep_place(&timesteps)], &mut head, &mut now);
        let moved = Next { gaussians: &next, camera: &to.camera };
        rasterizer.render(&now, &from.camera, Some(moved), &options, &mut frame)?;
        for pixel in face_pixels(face, from.camera.size()) {
            if trusted.pixels()[pixel] && frame.alpha.pixels()[pixel] > 0.5 {
                let [[u, v], [of_avatar_u, of_avatar_v]] =
                    [&forward, &frame.flow].map(|flow| flow.pixels()[pixel].map(f64::from));
                distances.push((u - of_avatar_u).hypot(v - of_avatar_v));
                lengths.push(u.hypot(v));
            }
        }
        used += 1;
        progress.inc();
    }
    if distances.is_empty() {
        return Ok(None);
    }
    Ok(Some(MotionScores { pairs: used, distance: median(distances), length: median(lengths) }))
}
