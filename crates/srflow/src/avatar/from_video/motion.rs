//! How far an avatar's flow is from the flow that is measured in the video.

use std::path::Path;

use srflow_avatar::capture::{Capture, CaptureSplit, Landmarks};
use srflow_avatar::{HeadSource, PosedHead};
use srflow_core::{Tolerance, forward_backward_check, median};
use srflow_splat::{DeviceRasterizer, Frame, Gaussians, Next, Options, Outputs};

use super::hull::Hull;
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
    run: &Path,
    capture: &Capture,
    landmarks: &Landmarks,
    watch: &Watch,
) -> anyhow::Result<Option<MotionScores>> {
    let source: HeadSource = format!("avatar:{}", run.display()).parse().map_err(anyhow::Error::msg)?;
    let avatar = source.avatar(0)?;
    let poses = capture.poses_of(&avatar)?;
    let estimator = estimator(&MethodSpec::default(), &MethodParameters::default(), watch)?;
    let timesteps = capture.timesteps();
    let pairs: Vec<_> = capture
        .of(CaptureSplit::Test)
        .filter_map(|view| Some((view, capture.view_at(view.timestep + 1, view.camera_index)?)))
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
        let points: Vec<[f64; 2]> = face.iter().flatten().copied().collect();
        let hull = Hull::of(&points);
        for (pixel, trusted) in trusted.pixels().iter().enumerate() {
            let (x, y) = (pixel % from.camera.width, pixel / from.camera.width);
            if *trusted && frame.alpha.get(x, y) > 0.5 && hull.depth([x as f64, y as f64]) > 0.0 {
                let [[u, v], [of_avatar_u, of_avatar_v]] =
                    [forward.get(x, y), frame.flow.get(x, y)].map(|flow| flow.map(f64::from));
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
