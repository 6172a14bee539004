//! Capturing a head whose truth is known: many cameras and timesteps, written as VHAP exports a tracked recording
//! ([`srflow_avatar::capture`]).
//!
//! ```text
//! capture.json                       the arguments of the capture
//! images/00012_08.png                timestep 12, camera 8
//! fg_masks/00012_08.png              its true alpha
//! flame_param/00012.npz              the true parameters of the head; written last of its timestep
//! canonical_flame_param.npz, head.json, landmarks.csv, transforms.json, transforms_{train,val,test}.json
//! true/                              landmarks.csv and transforms*.json without noise
//! ```
//!
//! [`crate::job`] makes it timestep by timestep; the files of all timesteps follow once it is complete. Every file's bytes depend
//! on the settings alone: not on shards, interruptions, or the number of threads.

mod performance;
mod settings;
mod truth;
mod work;

use std::path::Path;

use serde::Serialize;
use srflow_avatar::capture::{
    CaptureView, LANDMARK_COUNT, LANDMARKS_NAME, Landmarks, parameters_name, split_of, write_canonical,
    write_transforms,
};
use srflow_core::random::Key;
use srflow_files::{FileError, create_folder};
use srflow_splat::Camera;

use crate::RenderError;
use crate::job::{self, Made, Request, StageTime};
pub use settings::CaptureSettings;
pub use truth::{TRUE_FOLDER, TrueCapture};

use performance::Performance;
use work::{Timesteps, image_name};

/// The result of [`capture`].
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct CaptureReport {
    /// Timesteps of this shard.
    pub timesteps: u64,
    /// Timesteps rendered by this run.
    pub made: u64,
    pub cameras: usize,
    pub bytes: u64,
    pub seconds: f64,
    pub stages: Vec<StageTime>,
    /// Whether it was stopped on request before all timesteps were rendered.
    pub stopped: bool,
    /// Whether the capture, including all other shards, is complete.
    pub complete: bool,
}

/// Makes a capture, or one shard of it, with the threads of the current rayon pool. Existing files with the same settings are
/// kept.
///
/// # Errors
/// Before any work when a setting is out of range or the folder has another capture; later when a file cannot be written.
/// Complete files stay, and the next call with the same settings continues.
pub fn capture(settings: &CaptureSettings, request: Request) -> Result<CaptureReport, RenderError> {
    settings.validate()?;
    let performance = Performance::new(settings)?;
    let plan = Timesteps { settings, arguments: settings.arguments()?, performance: &performance };
    let (run, finished) = job::make(&plan, request, |dir| finish(dir, settings, &performance))?;
    let Made { units, made, bytes, seconds, stages, stopped } = run;
    let complete = finished.is_some();
    let cameras = settings.cameras;
    Ok(CaptureReport { timesteps: units, made, cameras, bytes, seconds, stages, stopped, complete })
}

/// Writes the files of a complete capture that are about all its timesteps.
fn finish(dir: &Path, settings: &CaptureSettings, performance: &Performance) -> Result<(), RenderError> {
    let model = performance.avatar.model();
    performance.head.write(dir)?;
    write_canonical(dir, model, performance.avatar.identity())?;

    let truth = dir.join(TRUE_FOLDER);
    create_folder(&truth)?;
    let (true_landmarks, landmarks) = performance.landmarks(settings);
    true_landmarks.write(&truth.join(LANDMARKS_NAME))?;
    landmarks.write(&dir.join(LANDMARKS_NAME))?;
    write_views(&truth, Path::new(".."), settings, &performance.cameras)?;
    // These mark the capture as complete, so they come last.
    let calibrated = settings.calibrated(&performance.cameras);
    Ok(write_views(dir, Path::new(""), settings, &calibrated)?)
}

/// Writes the lists of pictures into `dir`, from which `up` leads to the folder of the capture.
fn write_views(
    dir: &Path,
    up: &Path,
    settings: &CaptureSettings,
    cameras: &[(u32, Camera)],
) -> Result<(), FileError> {
    let timesteps: Vec<u32> = (0..settings.timesteps).collect();
    let indices: Vec<u32> = cameras.iter().map(|(index, _)| *index).collect();
    let split = split_of(&timesteps, &indices);
    let view = |timestep: u32, &(camera_index, camera): &(u32, Camera)| CaptureView {
        split: split(timestep, camera_index),
        timestep,
        camera_index,
        camera,
        image: up.join(image_name(work::IMAGES, timestep, camera_index)),
        mask: Some(up.join(image_name(work::MASKS, timestep, camera_index))),
        parameters: Some(up.join(parameters_name(timestep))),
    };
    let views: Vec<CaptureView> = timesteps
        .iter()
        .flat_map(|&timestep| cameras.iter().map(move |camera| (timestep, camera)))
        .map(|(t, c)| view(t, c))
        .collect();
    write_transforms(dir, &views)
}

impl Performance {
    /// The landmarks of every picture: the true ones, and those with the noise of the settings. Landmarks outside of the picture
    /// are missing; hidden ones are not.
    fn landmarks(&self, settings: &CaptureSettings) -> (Landmarks, Landmarks) {
        let (mut truth, mut noisy) = (Landmarks::default(), Landmarks::default());
        let model = self.avatar.model();
        let mut vertices = Vec::new();
        for (timestep, pose) in (0..).zip(&self.poses) {
            model.vertices(self.avatar.shaped(), &pose.pose(model), &mut vertices);
            for &(index, camera) in &self.cameras {
                let mut stream =
                    Key::new(settings.seed).scene(index).frame(timestep).stream("landmark noise");
                let (mut face, mut disturbed) = ([None; LANDMARK_COUNT], [None; LANDMARK_COUNT]);
                let places = model.landmarks_on(&vertices).zip(face.iter_mut().zip(&mut disturbed));
                for (place, (face, disturbed)) in places {
                    let noise = [0; 2].map(|_| f64::from(settings.landmark_noise * stream.normal()));
                    let inside = |x: f64, side: usize| (-0.5..side as f64 - 0.5).contains(&x);
                    let seen = camera.project(place.as_dvec3()).map(|(pixel, _)| pixel);
                    let seen = seen.filter(|p| inside(p.x, camera.width) && inside(p.y, camera.height));
                    *face = seen.map(|pixel| pixel.to_array());
                    *disturbed = face.map(|[x, y]| [x + noise[0], y + noise[1]]);
                }
                truth.insert(timestep, index, face);
                noisy.insert(timestep, index, disturbed);
            }
        }
        (truth, noisy)
    }
}
