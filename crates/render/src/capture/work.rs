//! Rendering timesteps: the pictures of all cameras, and the parameters of the head.

use std::fs;
use std::path::{Path, PathBuf};

use serde_json::Value;
use srflow_avatar::PosedHead;
use srflow_avatar::capture::{
    CANONICAL_NAME, CaptureSplit, HEAD_NAME, LANDMARKS_NAME, PARAMETERS_FOLDER, parameters_name,
};
use srflow_core::random::Key;
use srflow_files::write_image_png;
use srflow_head::HeadParameters;
use srflow_splat::{Frame, Gaussians, Options, Outputs, Rasterizer};

use super::performance::Performance;
use super::settings::{CaptureSettings, MANIFEST_NAME, indices};
use super::truth::TRUE_FOLDER;
use crate::RenderError;
use crate::generate::write_alpha;
use crate::job::{Layout, Plan, Run, Stage, leading_number, names_in, remove};
use crate::record::json_text;
use crate::recording::add_noise;

pub const IMAGES: &str = "images";
pub const MASKS: &str = "fg_masks";

/// The file of a picture or mask, relative to the folder of the capture.
pub fn image_name(folder: &str, timestep: u32, camera: u32) -> PathBuf {
    Path::new(folder).join(format!("{timestep:05}_{camera:02}.png"))
}

type Work<'w, 'a> = crate::job::Work<'w, Timesteps<'a>>;

/// A capture whose units are timesteps.
pub struct Timesteps<'a> {
    pub settings: &'a CaptureSettings,
    /// What `capture.json` holds.
    pub arguments: Value,
    pub performance: &'a Performance,
}

/// The files of a timestep of a capture with these cameras.
fn files_of(timestep: u32, cameras: &[u32]) -> impl Iterator<Item = PathBuf> {
    let of_cameras = cameras
        .iter()
        .flat_map(move |&camera| [IMAGES, MASKS].map(|folder| image_name(folder, timestep, camera)));
    std::iter::once(parameters_name(timestep)).chain(of_cameras)
}

/// The files about all timesteps.
fn files_of_all() -> impl Iterator<Item = PathBuf> {
    let lists = CaptureSplit::ALL.map(|split| format!("transforms_{split}.json"));
    let lists: Vec<PathBuf> = lists
        .iter()
        .map(String::as_str)
        .chain(["transforms.json", LANDMARKS_NAME])
        .map(PathBuf::from)
        .collect();
    let truth: Vec<PathBuf> = lists.iter().map(|name| Path::new(TRUE_FOLDER).join(name)).collect();
    lists.into_iter().chain([CANONICAL_NAME, HEAD_NAME].map(PathBuf::from)).chain(truth)
}

impl Layout for Timesteps<'_> {
    const MANIFEST: &'static str = MANIFEST_NAME;
    const UNITS: &'static str = "timesteps";

    fn groups(&self) -> Vec<u32> {
        vec![self.settings.timesteps]
    }

    fn files(&self, dir: &Path, _group: u32, timestep: u32) -> Vec<PathBuf> {
        files_of(timestep, &self.settings.camera_indices()).map(|file| dir.join(file)).collect()
    }

    fn begun_in(&self, dir: &Path) -> Vec<(u32, u32)> {
        let numbers = names_in(&dir.join(PARAMETERS_FOLDER)).filter_map(|name| leading_number(&name));
        numbers.filter(|timestep| *timestep < self.settings.timesteps).map(|timestep| (0, timestep)).collect()
    }

    fn name(&self, _group: u32, timestep: u32) -> String {
        format!("timestep {timestep}")
    }

    fn others(&self) -> Vec<PathBuf> {
        files_of_all().collect()
    }
}

impl<'a> Plan for Timesteps<'a> {
    type Layout = Self;
    type Group = ();
    type Worker = Renderer;

    const LONGEST_RUN: u32 = 8;

    fn layout(&self) -> &Self {
        self
    }

    fn manifest(&self) -> String {
        json_text(&self.arguments)
    }

    fn folders(&self, dir: &Path, _run: &Run) -> Vec<PathBuf> {
        [IMAGES, MASKS, PARAMETERS_FOLDER].map(|folder| dir.join(folder)).to_vec()
    }

    fn makes(&self, run: &Run, _folder: &Path, name: &str) -> bool {
        let timestep: Option<u32> = name.split(['_', '.']).next().and_then(|digits| digits.parse().ok());
        timestep.is_some_and(|timestep| run.units.contains(&timestep))
    }

    fn delete(&self, dir: &Path, found: &str) -> Result<(), RenderError> {
        // If the arguments cannot be read, the capture's files are unknown: they are overwritten instead.
        let other: Value = serde_json::from_str(found).unwrap_or_default();
        let number = |key: &str| other[key].as_u64().unwrap_or(0);
        let cameras = indices(usize::try_from(number("cameras")).unwrap_or(0));
        // The lists first: without them the capture does not count as complete.
        let remove = |file: PathBuf| remove(&dir.join(file));
        files_of_all().try_for_each(remove)?;
        let timesteps = u32::try_from(number("timesteps")).unwrap_or(0);
        (0..timesteps).flat_map(|timestep| files_of(timestep, &cameras)).try_for_each(remove)?;
        for folder in [IMAGES, MASKS, PARAMETERS_FOLDER, TRUE_FOLDER] {
            let _ = fs::remove_dir(dir.join(folder)); // fails, and stays, if it contains other files
        }
        Ok(())
    }

    fn group(&self, _number: u32) -> Result<(), RenderError> {
        Ok(())
    }

    fn worker(&self) -> Renderer {
        let background = self.settings.background.map(|channel| f32::from(channel) / 255.0);
        let outputs = Outputs { image: true, alpha: true, ..Outputs::NONE };
        Renderer { options: Options { background, outputs, ..Options::default() }, ..Renderer::default() }
    }

    fn make(
        &self,
        work: &Work<'_, 'a>,
        _group: &(),
        run: &Run,
        renderer: &mut Renderer,
    ) -> Result<(), RenderError> {
        work.each(run.units.clone(), |timestep| renderer.make(work, timestep))
    }
}

/// The buffers of one worker, reused for every picture.
#[derive(Default)]
pub struct Renderer {
    rasterizer: Rasterizer,
    options: Options,
    head: PosedHead,
    gaussians: Gaussians,
    frame: Frame,
    bytes: Vec<u8>,
}

impl Renderer {
    fn make(&mut self, work: &Work, timestep: u32) -> Result<(), RenderError> {
        let Timesteps { settings, performance, .. } = work.plan;
        let avatar = &performance.avatar;
        let parameters = &performance.poses[timestep as usize];
        work.clock.time(Stage::Motion, || {
            avatar.gaussians_into(&parameters.pose(avatar.model()), &mut self.head, &mut self.gaussians);
        });
        for (index, camera) in &performance.cameras {
            work.clock
                .time(Stage::Rasterize, || {
                    self.rasterizer.render(&self.gaussians, camera, None, &self.options, &mut self.frame)
                })
                .map_err(|error| RenderError::Rasterize {
                    frame: format!("timestep {timestep}, camera {index}"),
                    error,
                })?;
            if settings.noise > 0.0 {
                let key = Key::new(settings.seed).scene(*index).frame(timestep);
                add_noise(&mut self.frame.image, &self.frame.alpha, settings.noise, key);
            }
            let file = |folder: &str| work.dir.join(image_name(folder, timestep, *index));
            work.write(Stage::Frames, &file(IMAGES), |path| write_image_png(path, &self.frame.image))?;
            work.write(Stage::Planes, &file(MASKS), |path| {
                write_alpha(path, &self.frame.alpha, &mut self.bytes)
            })?;
        }
        let one = HeadParameters { poses: vec![parameters.clone()], ..performance.avatar.identity().clone() };
        // The parameters mark the timestep as complete, so they come last.
        work.write(Stage::Records, &work.dir.join(parameters_name(timestep)), |path| {
            one.write(path, avatar.model().template.len(), false)
        })
    }
}
