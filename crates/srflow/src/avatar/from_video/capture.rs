//! A capture from a video: frames, landmarks and the camera.

use std::path::Path;

use glam::{DMat3, DVec3};
use serde::{Deserialize, Serialize};
use srflow_avatar::capture::{CaptureSplit, CaptureView, LANDMARKS_NAME};
use srflow_core::{SettingError, Size};
use srflow_face::FaceFinder;
use srflow_files::create_folder;
use srflow_splat::Camera;

use super::frames::{CAMERA, Frames, choose, image_name};
use super::masks::mask_name;
use crate::Watch;
use crate::clap::Args;
use crate::face::FaceModels;
use crate::video::facts;

/// How a capture is made of a video.
#[derive(Args, Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct VideoArgs {
    /// Use at most this many frames, spread over the video [default: 240]
    #[arg(long, value_name = "N")]
    pub frames: Option<usize>,
    /// Focal length in pixels [default: recorded in the video, else 1.1 longer sides]
    #[arg(long, value_name = "PIXELS")]
    pub focal: Option<f64>,
    /// Face to follow if there are several; 1 is the leftmost
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..))]
    pub face_index: Option<u16>,
    #[command(flatten)]
    #[serde(flatten)]
    pub models: FaceModels,
}

/// Where a focal length is from.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum FocalSource {
    Given,
    /// The camera wrote it into the video.
    Recorded,
    /// The usual one of phones and notebooks: 1.1 longer sides of the frame.
    Assumed,
}

/// The focal length of most cameras that people film themselves with, in longer sides of the frame, is this times or divided by 1.5. The
/// perspective of a face does not tell it: a detector's landmarks are off by more than that changes.
const USUAL_FOCAL: f64 = 1.1;

/// One of so many frames is held out, over the whole video: the avatar learns all that the person does in it.
const HELD_OUT_EVERY: u32 = 8;

/// The longer side of a frame of 35 mm film, millimetres.
const FILM: f64 = 36.0;

/// A capture whose pictures and landmarks are written.
pub struct CapturedVideo {
    pub views: Vec<CaptureView>,
    /// Frames of the video.
    pub frames: u64,
    /// Pixels.
    pub focal: f64,
    pub focal_source: FocalSource,
}

impl VideoArgs {
    /// # Errors
    /// Names the setting that is out of range.
    pub fn check(&self) -> Result<(), SettingError> {
        if self.frames == Some(0) {
            let (field, expected) = ("frames", "at least 1".to_owned());
            return Err(SettingError { field, found: "0".to_owned(), expected });
        }
        if let Some(focal) = self.focal.filter(|focal| !(*focal >= 1.0 && focal.is_finite())) {
            let (field, expected) = ("focal", "a number of pixels above 1".to_owned());
            return Err(SettingError { field, found: focal.to_string(), expected });
        }
        Ok(())
    }

    /// The first of these settings that is given.
    pub fn given(&self) -> Option<&'static str> {
        let Self { frames, focal, face_index, models } = self;
        [
            ("frames", frames.is_some()),
            ("focal", focal.is_some()),
            ("face_index", face_index.is_some()),
            ("face_models", models.face_models.is_some()),
        ]
        .into_iter()
        .find_map(|(name, given)| given.then_some(name))
    }

    pub(super) fn most_frames(&self) -> usize {
        self.frames.unwrap_or(240)
    }

    /// Writes frames and landmarks into a folder. `None` when it was stopped.
    ///
    /// # Errors
    /// When the video cannot be read, or too few frames have a face.
    pub fn capture(
        &self,
        video: &Path,
        out: &Path,
        models: &Path,
        watch: &Watch,
    ) -> anyhow::Result<Option<CapturedVideo>> {
        create_folder(out)?;
        let facts = facts(video);
        let Some(frames) = choose(self, video, out, facts.frames, FaceFinder::read(models)?, watch)? else {
            return Ok(None);
        };
        frames.landmarks.write(&out.join(LANDMARKS_NAME))?;
        let (focal, focal_source) = self.focal_length(frames.size, facts.focal_length_35mm);
        let views = views(&frames, focal);
        Ok(Some(CapturedVideo { views, frames: frames.of, focal, focal_source }))
    }

    /// In pixels, for frames of this size; `recorded` in the format of 35 mm film, millimetres.
    fn focal_length(&self, Size { width, height }: Size, recorded: Option<f64>) -> (f64, FocalSource) {
        let side = width.max(height) as f64;
        match (self.focal, recorded) {
            (Some(given), _) => (given, FocalSource::Given),
            (None, Some(millimetres)) => (side * millimetres / FILM, FocalSource::Recorded),
            (None, None) => (side * USUAL_FOCAL, FocalSource::Assumed),
        }
    }
}

/// The pictures of a camera in front of the head, with square pixels and its axis through the middle.
fn views(frames: &Frames, focal: f64) -> Vec<CaptureView> {
    let facing = DMat3::from_diagonal(DVec3::new(1.0, -1.0, -1.0));
    let camera = Camera::centred(frames.size, [focal; 2]).placed(facing, DVec3::Z);
    let timesteps: Vec<u32> = (0..frames.numbers.len() as u32).collect();
    let view = |timestep: &u32| CaptureView {
        split: if timestep % HELD_OUT_EVERY == HELD_OUT_EVERY / 2 {
            CaptureSplit::Test
        } else {
            CaptureSplit::Train
        },
        timestep: *timestep,
        camera_index: CAMERA,
        camera,
        image: image_name(*timestep),
        mask: Some(mask_name(*timestep)),
        parameters: None,
    };
    timesteps.iter().map(view).collect()
}

pub fn focal_text(pixels: f64, source: FocalSource) -> String {
    let source = match source {
        FocalSource::Given => "as given",
        FocalSource::Recorded => "as the camera recorded it",
        FocalSource::Assumed => "assumed; give `focal` if you know it",
    };
    format!("{pixels:.0} px, {source}")
}
