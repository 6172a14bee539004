//! How close rendered pictures are to those of a capture, as GaussianAvatars measures it.

use std::path::PathBuf;

use serde::Serialize;
use srflow_core::{Image, Size};
use srflow_splat::{Frame, Gaussians, Rasterizer};

use super::image_loss::{ImageLoss, ImageLossError};
use super::trainer::picture;
use super::{TrainConfig, TrainError};
use crate::capture::{Capture, CaptureSplit, CaptureView};
use crate::{Avatar, PosedHead};
use srflow_head::HeadPose;

/// Scores of one picture, or their means.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize)]
pub struct Score {
    /// Peak signal-to-noise ratio of the whole picture, dB (`metrics.py` of GaussianAvatars). Infinite for equal pictures.
    pub psnr: f64,
    /// Mean of those of the three channels (`train.py` of GaussianAvatars, and its paper). At least as large.
    pub psnr_channels: f64,
    /// Structural similarity, with the window of [`ImageLoss`].
    pub ssim: f64,
}

impl Score {
    /// The scores of a `rendered` picture, clamped to 0..1, against `target`.
    ///
    /// # Errors
    /// When a picture does not have `size`.
    pub fn of(
        rendered: &[[f32; 3]],
        target: &[[f32; 3]],
        size: Size,
        loss: &mut ImageLoss,
    ) -> Result<Self, ImageLossError> {
        let clamped: Vec<[f32; 3]> = rendered.iter().map(|pixel| pixel.map(|x| x.clamp(0.0, 1.0))).collect();
        let ssim = loss.backward(&clamped, target, size, &mut Vec::new())?.ssim;
        let mut squares = [0.0; 3];
        for (a, b) in clamped.iter().zip(target) {
            for (sum, (a, b)) in squares.iter_mut().zip(a.iter().zip(b)) {
                *sum += f64::from(a - b) * f64::from(a - b);
            }
        }
        let psnr = |mean_square: f64| -10.0 * libm::log10(mean_square);
        let of_channels = squares.map(|sum| sum / target.len().max(1) as f64);
        Ok(Self {
            psnr: psnr(of_channels.iter().sum::<f64>() / 3.0),
            psnr_channels: of_channels.map(psnr).iter().sum::<f64>() / 3.0,
            ssim,
        })
    }

    /// The mean of each score; `None` without one.
    pub fn mean(scores: &[Self]) -> Option<Self> {
        let of = |score: fn(&Self) -> f64| scores.iter().map(score).sum::<f64>() / scores.len() as f64;
        (!scores.is_empty()).then(|| Self {
            psnr: of(|score| score.psnr),
            psnr_channels: of(|score| score.psnr_channels),
            ssim: of(|score| score.ssim),
        })
    }
}

/// Scores the renderings of an avatar against the pictures of a capture, one by one.
#[derive(Debug, Default)]
pub struct Scorer {
    config: TrainConfig,
    picture: Vec<[f32; 3]>,
    rasterizer: Rasterizer,
    frame: Frame,
    head: PosedHead,
    world: Gaussians,
    loss: ImageLoss,
}

impl Scorer {
    /// Pictures are read and views rendered as in a training with this configuration.
    pub fn new(config: TrainConfig) -> Self {
        Self { config, ..Self::default() }
    }

    /// The score of `avatar` in `pose` in a view of `capture`.
    ///
    /// # Errors
    /// When the picture cannot be read or its view not be rendered.
    pub fn score(
        &mut self,
        avatar: &Avatar,
        pose: &HeadPose,
        capture: &Capture,
        view: &CaptureView,
    ) -> Result<Score, TrainError> {
        self.draw(avatar, pose, capture, view)?;
        let Self { frame, picture, loss, .. } = self;
        Ok(Score::of(&frame.color, picture, Size::new(frame.width, frame.height), loss)?)
    }

    /// Reads the picture and renders the avatar.
    ///
    /// # Errors
    /// As [`Scorer::score`].
    pub(super) fn draw(
        &mut self,
        avatar: &Avatar,
        pose: &HeadPose,
        capture: &Capture,
        view: &CaptureView,
    ) -> Result<(), TrainError> {
        let Self { config, rasterizer, frame, head, world, .. } = self;
        (self.picture, _) = picture(capture, view, config, config.background)?;
        avatar.gaussians_into(pose, head, world);
        rasterizer
            .render(world, &view.camera_for(config.faithful), None, &config.rendering(), frame)
            .map_err(|error| TrainError::Render { image: view.image.clone(), error })?;
        Ok(())
    }

    /// The picture and the rendering that were scored last, with 8 bits.
    pub fn images(&self) -> [Image; 2] {
        let Frame { width, height, .. } = self.frame;
        let byte = |value: f32| (value.clamp(0.0, 1.0) * 255.0 + 0.5) as u8;
        [self.picture(), self.rendered()]
            .map(|colors| Image::from_fn(width, height, |x, y| colors[y * width + x].map(byte)))
    }

    /// The picture that was scored last, 0..1, row-major.
    pub fn picture(&self) -> &[[f32; 3]] {
        &self.picture
    }

    /// The rendering that was scored last, row-major and not clamped.
    pub fn rendered(&self) -> &[[f32; 3]] {
        &self.frame.color
    }
}

/// The score of one picture of a capture.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ViewScore {
    pub timestep: u32,
    pub camera: u32,
    /// Relative to the folder of the capture.
    pub image: PathBuf,
    #[serde(flatten)]
    pub score: Score,
}

impl ViewScore {
    pub fn new(view: &CaptureView, score: Score) -> Self {
        Self { timestep: view.timestep, camera: view.camera_index, image: view.image.clone(), score }
    }
}

/// Mean scores of the pictures of one camera.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct CameraScore {
    pub camera: u32,
    pub pictures: usize,
    #[serde(flatten)]
    pub mean: Score,
}

/// Scores of the pictures of a split.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct SplitScore {
    pub split: CaptureSplit,
    pub pictures: usize,
    /// Over all pictures.
    #[serde(flatten)]
    pub mean: Score,
    /// Ascending by their numbers.
    pub cameras: Vec<CameraScore>,
    /// The pictures with the highest and the lowest [`Score::psnr`].
    pub best: ViewScore,
    pub worst: ViewScore,
}

impl SplitScore {
    /// Of all scored pictures of a split; `None` without one.
    pub fn of(split: CaptureSplit, views: &[ViewScore]) -> Option<Self> {
        let mean = |of: &dyn Fn(&&ViewScore) -> bool| {
            let scores: Vec<Score> = views.iter().filter(of).map(|view| view.score).collect();
            Some((scores.len(), Score::mean(&scores)?))
        };
        let mut numbers: Vec<u32> = views.iter().map(|view| view.camera).collect();
        numbers.sort_unstable();
        numbers.dedup();
        let of_camera = |camera: u32| {
            let (pictures, mean) = mean(&|view| view.camera == camera)?;
            Some(CameraScore { camera, pictures, mean })
        };
        let by_psnr = |a: &&ViewScore, b: &&ViewScore| a.score.psnr.total_cmp(&b.score.psnr);
        let (pictures, whole) = mean(&|_| true)?;
        Some(Self {
            split,
            pictures,
            mean: whole,
            cameras: numbers.into_iter().filter_map(of_camera).collect(),
            best: views.iter().max_by(by_psnr)?.clone(),
            worst: views.iter().min_by(by_psnr)?.clone(),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_split_has_means_of_its_cameras_and_its_extremes() {
        let view = |timestep, camera, psnr| ViewScore {
            timestep,
            camera,
            image: PathBuf::new(),
            score: Score { psnr, psnr_channels: psnr + 1.0, ssim: 0.9 },
        };
        let views = [view(0, 8, 30.0), view(0, 1, 20.0), view(1, 8, 34.0)];
        let split = SplitScore::of(CaptureSplit::Test, &views).unwrap();
        assert_eq!((split.pictures, split.mean.psnr, split.mean.psnr_channels), (3, 28.0, 29.0));
        let cameras: Vec<_> = split.cameras.iter().map(|of| (of.camera, of.pictures, of.mean.psnr)).collect();
        assert_eq!(cameras, [(1, 1, 20.0), (8, 2, 32.0)]);
        assert_eq!((&split.best, &split.worst), (&views[2], &views[1]));
        assert_eq!(SplitScore::of(CaptureSplit::Test, &[]), None);
        let text = serde_json::to_value(&split).unwrap();
        assert_eq!(
            (&text["split"], &text["psnr"], &text["best"]["psnr"]),
            (&"test".into(), &28.0.into(), &34.0.into())
        );
    }

    #[test]
    fn the_two_ratios_are_those_of_the_reference() {
        let target = [[0.5, 0.5, 0.5]; 12];
        // Errors 0.1, 0.01 and 0.5 (clamped from more): 20, 40 and 6.02 dB.
        let rendered = [[0.6, 0.49, 1.7]; 12];
        let found = Score::of(&rendered, &target, Size::new(4, 3), &mut ImageLoss::default()).unwrap();
        let whole = -10.0 * ((0.01 + 0.0001 + 0.25) / 3.0_f64).log10();
        assert!((found.psnr - whole).abs() < 1e-4, "{found:?}");
        assert!((found.psnr_channels - (20.0 + 40.0 + 6.0206) / 3.0).abs() < 1e-3, "{found:?}");
        assert!(found.ssim < 1.0);
        let same = Score::of(&target, &target, Size::new(4, 3), &mut ImageLoss::default()).unwrap();
        assert!(same.psnr == f64::INFINITY && (same.ssim - 1.0).abs() < 1e-6);
        assert_eq!(Score::mean(&[found, found]), Some(found));
        assert_eq!(Score::mean(&[]), None);
    }
}
