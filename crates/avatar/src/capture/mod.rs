//! Captures of a head by several calibrated cameras, in the files that VHAP exports and GaussianAvatars is trained on
//! (`vhap/export_as_nerf_dataset.py`, `scene/dataset_readers.py`):
//!
//! ```text
//! transforms.json                  cameras and files of every picture; _train, _val and _test hold one split each
//! images/00012_08.png              timestep 12, camera 8; the head over the background colour
//! fg_masks/00012_08.png            alpha, 8 bits
//! flame_param/00012.npz            parameters of the head at timestep 12
//! canonical_flame_param.npz        the head at rest with the mouth open
//! landmarks.csv                    the 68 landmarks of dlib in every picture; of this project
//! head.json                        which head the parameters belong to; of this project
//! ```
//!
//! Images are read one by one when they are asked for, so a capture may be larger than the memory.

mod export;
mod head;
mod import;
mod landmarks;
mod read;
mod split;
#[cfg(test)]
mod tests;
mod write;

use std::path::{Path, PathBuf};

use srflow_core::{Image, Plane, Size};
use srflow_files::{FileError, FileProblem, read_alpha, read_image};
use srflow_splat::Camera;

pub use export::{PARAMETERS_FOLDER, parameters_name, write_canonical, write_tracked};
pub use head::{HEAD_NAME, HeadRecord};
pub use import::{ImportRequest, Imported, PicturePattern, import};
pub use landmarks::{Face, LANDMARK_COUNT, LANDMARKS_NAME, Landmarks};
pub use split::{CaptureSplit, FRONT_CAMERA, split_of};
pub use write::write_transforms;

use crate::{Avatar, AvatarError};
use srflow_head::{HeadParameters, HeadPose};

/// The file whose presence makes GaussianAvatars read a folder as a capture of a moving head.
pub const CANONICAL_NAME: &str = "canonical_flame_param.npz";

/// One picture of a capture.
#[derive(Debug, Clone, PartialEq)]
pub struct CaptureView {
    pub split: CaptureSplit,
    /// Number of the timestep, from 0.
    pub timestep: u32,
    /// Number of the camera, from 0; 8 is the front camera of NeRSemble.
    pub camera_index: u32,
    /// Intrinsics and pose, in our conventions.
    pub camera: Camera,
    /// The picture, relative to the folder of the capture.
    pub image: PathBuf,
    /// Alpha of the head, relative to the folder of the capture.
    pub mask: Option<PathBuf>,
    /// Parameters of the head at this timestep, relative to the folder of the capture.
    pub parameters: Option<PathBuf>,
}

impl CaptureView {
    /// The place of the view's timestep among those of its capture.
    pub fn timestep_place(&self, timesteps: &[u32]) -> usize {
        timesteps.partition_point(|&timestep| timestep < self.timestep)
    }

    /// The camera to render the view with: its own, or, `faithful` to GaussianAvatars (`scene/cameras.py`), one with a symmetric
    /// frustum and square pixels.
    pub fn camera_for(&self, faithful: bool) -> Camera {
        let camera = self.camera;
        if !faithful {
            return camera;
        }
        let centred = Camera::centred(camera.size(), [camera.fx; 2]);
        Camera { camera_from_world: camera.camera_from_world, ..centred }
    }
}

/// A head captured by several cameras over time.
#[derive(Debug, Clone, PartialEq)]
pub struct Capture {
    dir: PathBuf,
    views: Vec<CaptureView>,
}

impl Capture {
    /// The folder of its files.
    pub fn dir(&self) -> &Path {
        &self.dir
    }

    /// All pictures, sorted by timestep and camera.
    pub fn views(&self) -> &[CaptureView] {
        &self.views
    }

    /// The pictures of one split, sorted by timestep and camera.
    pub fn of(&self, split: CaptureSplit) -> impl Iterator<Item = &CaptureView> {
        self.views.iter().filter(move |view| view.split == split)
    }

    /// The picture of a camera at a timestep.
    pub fn view_at(&self, timestep: u32, camera: u32) -> Option<&CaptureView> {
        let place =
            self.views.binary_search_by_key(&(timestep, camera), |view| (view.timestep, view.camera_index));
        place.ok().map(|place| &self.views[place])
    }

    /// Divides the pictures by [`split_of`].
    fn divide(&mut self) {
        let split_of = split_of(&self.timesteps(), &self.camera_indices());
        self.views.iter_mut().for_each(|view| view.split = split_of(view.timestep, view.camera_index));
    }

    /// Numbers of the timesteps, ascending.
    pub fn timesteps(&self) -> Vec<u32> {
        let mut timesteps: Vec<u32> = self.views.iter().map(|view| view.timestep).collect();
        timesteps.dedup();
        timesteps
    }

    /// Numbers of the cameras, ascending.
    pub fn camera_indices(&self) -> Vec<u32> {
        let mut cameras: Vec<u32> = self.views.iter().map(|view| view.camera_index).collect();
        cameras.sort_unstable();
        cameras.dedup();
        cameras
    }

    /// Checks that all pictures exist, and all masks if they are needed, without reading them.
    ///
    /// # Errors
    /// Counts those that do not, and names the first.
    pub fn check_pictures(&self, with_masks: bool) -> Result<(), FileError> {
        let masks = self.views.iter().filter_map(|view| view.mask.as_ref()).filter(|_| with_masks);
        let files = self.views.iter().map(|view| &view.image).chain(masks);
        let mut missing = files.filter(|file| !self.dir.join(file).is_file());
        let Some(first) = missing.next() else { return Ok(()) };
        let found = format!("{} missing, such as {}", 1 + missing.count(), first.display());
        let problem = problem("pictures", "the files that the lists of the capture name", found);
        Err(FileError { path: self.dir.clone(), problem })
    }

    /// Reads the picture of a view.
    ///
    /// # Errors
    /// When it cannot be read, or does not have the size of the camera.
    pub fn image(&self, view: &CaptureView) -> Result<Image, FileError> {
        let path = self.dir.join(&view.image);
        let image = read_image(&path)?;
        check_size(&path, image.size(), &view.camera)?;
        Ok(image)
    }

    /// Reads the picture of a camera at a timestep.
    ///
    /// # Errors
    /// When there is none, or as [`Capture::image`].
    pub fn image_at(&self, timestep: u32, camera: u32) -> Result<Image, FileError> {
        let view = self.view_at(timestep, camera).ok_or_else(|| {
            let expected = format!("a picture of camera {camera} at timestep {timestep}");
            problem("pictures", expected, "none").in_file(&self.dir)
        })?;
        self.image(view)
    }

    /// Reads the alpha of a view, 0 to 1; `None` if the capture has no masks.
    ///
    /// # Errors
    /// As [`Capture::image`].
    pub fn mask(&self, view: &CaptureView) -> Result<Option<Plane>, FileError> {
        let Some(mask) = &view.mask else { return Ok(None) };
        let path = self.dir.join(mask);
        let alpha = read_alpha(&path)?;
        check_size(&path, alpha.size(), &view.camera)?;
        Ok(Some(alpha))
    }

    /// Reads the head's parameters at all timesteps, in the order of [`Capture::timesteps`]. The identity is that of the first.
    ///
    /// # Errors
    /// When a timestep has no file of parameters, or one cannot be read or holds another number of timesteps than one.
    pub fn parameters(&self) -> Result<HeadParameters, FileError> {
        let mut all: Option<HeadParameters> = None;
        let mut last = None;
        for view in &self.views {
            if last == Some(view.timestep) {
                continue;
            }
            last = Some(view.timestep);
            let Some(parameters) = &view.parameters else {
                let found = format!("none at timestep {}", view.timestep);
                let problem =
                    problem("flame_param_path", "the parameters of the head at every timestep", found);
                return Err(FileError { path: self.dir.clone(), problem });
            };
            let path = self.dir.join(parameters);
            let one = HeadParameters::read(&path)?;
            if one.poses.len() != 1 {
                let problem = problem("expr", "one timestep", one.poses.len());
                return Err(FileError { path, problem });
            }
            match &mut all {
                None => all = Some(one),
                Some(all) => all.poses.extend(one.poses),
            }
        }
        Ok(all.unwrap_or_default())
    }

    /// The poses of an avatar that was trained on the capture: its own motion, in the order of [`Capture::timesteps`].
    ///
    /// # Errors
    /// When the capture shows another head, its parameters cannot be read, or the avatar does not have one pose for each timestep.
    pub fn poses_of(&self, avatar: &Avatar) -> Result<Vec<HeadPose>, AvatarError> {
        let other = |problem: String| AvatarError::OtherCapture { dir: self.dir.clone(), problem };
        let model = avatar.model();
        if let Some(record) = HeadRecord::read(&self.dir)? {
            record.check(&self.dir, model)?;
            if !record.may_be(model) {
                return Err(other(format!("it shows the head {} of seed {}", record.head, record.subject)));
            }
        }
        let parameters = self.parameters()?;
        let identity = avatar.identity();
        let weights =
            |shape: &[f32]| shape.iter().rposition(|&weight| weight != 0.0).map_or(0, |last| last + 1);
        let [shown, own] = [&parameters.shape, &identity.shape].map(|shape| &shape[..weights(shape)]);
        if shown != own || parameters.static_offset != identity.static_offset {
            return Err(other("the identity of its head (shape, static_offset) is another".to_owned()));
        }
        let (found, expected) = (avatar.own_motion().len(), parameters.poses.len());
        if found != expected {
            return Err(other(format!("it has {expected} timesteps, and the motion of the avatar {found}")));
        }
        Ok(avatar.own_motion().iter().map(|pose| pose.pose(model)).collect())
    }
}

fn check_size(path: &Path, found: Size, camera: &Camera) -> Result<(), FileError> {
    let expected = camera.size();
    if found == expected {
        return Ok(());
    }
    let expected = format!("{expected} (WIDTHxHEIGHT), as its camera in transforms.json");
    Err(FileError { path: path.to_owned(), problem: problem("size", expected, found) })
}

fn problem(field: &'static str, expected: impl ToString, found: impl ToString) -> FileProblem {
    FileProblem::Field { field, expected: expected.to_string(), found: found.to_string() }
}
