//! Captures from pictures in folders, and from a video.

use std::collections::BTreeMap;
use std::fmt;
use std::path::{Path, PathBuf};

use anyhow::Context as _;
use serde::{Deserialize, Serialize};
use srflow_avatar::capture::{
    CaptureSplit, CaptureView, ImportRequest, Imported, PicturePattern, import, write_transforms,
};
use srflow_core::{SettingError, excerpts};
use srflow_face::PersonMask;
use srflow_files::create_folder;

use super::from_video::{CapturedVideo, FocalSource, MASKS, VideoArgs, focal_text, write_masks};
use super::paths::from_to;
use crate::clap::Args;
use crate::error::wrong_settings;
use crate::output::{ensure_folder, ensure_free, write_line};
use crate::video::is_video;
use crate::{Job, Report, Watch};

/// Make a capture from a video of one person, or from pictures and a file of their cameras
///
/// Of a video, writes sharp frames that are spread over it, the landmarks of the face and masks of the person, which needs ffmpeg and
/// MediaPipe's networks. Pictures stay where they are: give `--pattern` and `--cameras`. Camera 8, or else the last one, and the last
/// 30 % of the timesteps are held out. `srflow avatar fit` adds a head. docs/reference/avatar-files.md describes the files.
#[derive(Args, Debug, Clone, PartialEq, Serialize, Deserialize)]
#[command(after_help = "Examples:
  srflow avatar import clip.mp4 --out capture
  srflow avatar import video --pattern 'cam_{camera}/frame_{timestep}' --cameras camera_params.json --out capture
  srflow avatar import frames --pattern '{timestep}_{camera}.png' --cameras colmap/sparse/0 --metres-per-unit 0.21 --out capture

Cameras: camera_params.json of NeRSemble, a COLMAP model, cameras.json of 3D Gaussian Splatting, or transforms.json, whose cameras are
named as in the pictures.")]
pub struct ImportJob {
    /// Folder of the pictures, or a video
    #[arg(value_name = "PICTURES|VIDEO")]
    pub pictures: PathBuf,
    /// Names of the pictures below PICTURES, with {camera} and {timestep}; without an extension, PNG and JPEG
    #[arg(long, value_name = "PATTERN")]
    #[serde(default)]
    pub pattern: Option<PicturePattern>,
    /// Names of the masks below PICTURES, white on the head
    #[arg(long, value_name = "PATTERN")]
    #[serde(default)]
    pub masks: Option<PicturePattern>,
    /// File of the cameras, or folder of a COLMAP model
    #[arg(long, value_name = "FILE")]
    #[serde(default)]
    pub cameras: Option<PathBuf>,
    /// Metres per unit of the cameras
    #[arg(long, value_name = "METRES", default_value_t = default_unit())]
    #[serde(default = "default_unit")]
    pub metres_per_unit: f64,
    /// Folder to write
    #[arg(short, long, value_name = "DIR")]
    pub out: PathBuf,
    /// Overwrite the lists in the folder
    #[arg(long)]
    #[serde(default)]
    pub force: bool,
    #[command(flatten)]
    #[serde(flatten)]
    pub video: VideoArgs,
}

fn default_unit() -> f64 {
    1.0
}

impl Job for ImportJob {
    const NAME: &'static str = "avatar import";

    type Report = ImportReport;

    fn work(&self, watch: &Watch) -> anyhow::Result<ImportReport> {
        ensure_folder(&self.out)?;
        let unit = self.metres_per_unit;
        if !(unit > 0.0 && unit.is_finite()) {
            let (field, expected) = ("metres_per_unit", "a number above 0".to_owned());
            return Err(SettingError { field, found: unit.to_string(), expected }.into());
        }
        ensure_free([self.out.join("transforms.json")], self.force)?;
        if is_video(&self.pictures) { self.import_video(watch) } else { self.import_pictures() }
    }
}

impl ImportJob {
    fn import_pictures(&self) -> anyhow::Result<ImportReport> {
        if let Some(name) = self.video.given() {
            wrong_settings!("`{name}` is a setting of videos; {} is no video", self.pictures.display());
        }
        let (Some(pattern), Some(cameras)) = (&self.pattern, &self.cameras) else {
            wrong_settings!(
                "{}: pictures need `pattern` and `cameras`; a video needs neither",
                self.pictures.display()
            )
        };
        let imported = import(&ImportRequest {
            pictures: &self.pictures,
            pattern,
            masks: self.masks.as_ref(),
            cameras,
            unit: self.metres_per_unit,
        })?;
        create_folder(&self.out)?;
        let below = from_to(&self.out, &self.pictures)?;
        let moved = |path: &Path| below.join(path);
        let views: Vec<CaptureView> = imported
            .views
            .iter()
            .map(|view| CaptureView {
                image: moved(&view.image),
                mask: view.mask.as_deref().map(moved),
                ..view.clone()
            })
            .collect();
        write_transforms(&self.out, &views)?;
        Ok(ImportReport::new(self, imported))
    }

    fn import_video(&self, watch: &Watch) -> anyhow::Result<ImportReport> {
        let given = [
            ("pattern", self.pattern.is_some()),
            ("masks", self.masks.is_some()),
            ("cameras", self.cameras.is_some()),
        ];
        if let Some((name, _)) = given.into_iter().find(|(_, given)| *given) {
            wrong_settings!(
                "`{name}` is a setting of pictures in folders; {} is a video",
                self.pictures.display()
            );
        }
        self.video.check()?;
        let models = self.video.models.path()?;
        let Some(captured) = self.video.capture(&self.pictures, &self.out, &models, watch)? else {
            return Ok(ImportReport::stopped(self));
        };
        let CapturedVideo { mut views, focal, focal_source, .. } = captured;
        let person = PersonMask::read(&models).map_err(|error| log::warn!("{error}: there are no masks"));
        match &person {
            Ok(person) => {
                // Those of earlier frames.
                let masks = self.out.join(MASKS);
                if masks.exists() {
                    std::fs::remove_dir_all(&masks).with_context(|| masks.display().to_string())?;
                }
                if !write_masks(&self.out, &views, watch, |_, image| Ok(person.mask(image)?))? {
                    return Ok(ImportReport::stopped(self));
                }
            }
            Err(()) => views.iter_mut().for_each(|view| view.mask = None),
        }
        write_transforms(&self.out, &views)?;
        let imported = Imported { cameras: vec![(0, "the video".to_owned())], views, ..Imported::default() };
        Ok(ImportReport { focal: Some((focal, focal_source)), ..ImportReport::new(self, imported) })
    }
}

/// The capture that [`ImportJob`] wrote.
#[derive(Debug, Clone, Serialize)]
pub struct ImportReport {
    /// Names by number.
    pub cameras: BTreeMap<String, String>,
    pub out: PathBuf,
    pub pictures: usize,
    /// Pictures of held-out timesteps.
    pub test: usize,
    pub timesteps: usize,
    /// Pictures for training.
    pub train: usize,
    /// Names in the pictures that the file of cameras lacks; their pictures are left out.
    pub unknown_cameras: Vec<String>,
    /// Names of the file of cameras without pictures.
    pub unused_cameras: Vec<String>,
    /// Pictures of a held-out camera.
    pub val: usize,
    /// Pictures without a mask, where masks were given.
    pub without_mask: usize,
    /// Of a video: focal length in pixels, and where it is from.
    pub focal: Option<(f64, FocalSource)>,
    /// Whether it was stopped before the lists were written.
    pub stopped: bool,
    /// Numbers and names, in the order of the numbers.
    #[serde(skip)]
    numbered: Vec<(u32, String)>,
    #[serde(skip)]
    file_of_cameras: PathBuf,
    /// A camera whose lens distorts, and how.
    #[serde(skip)]
    distorted: Option<(String, String)>,
}

impl ImportReport {
    fn new(job: &ImportJob, imported: Imported) -> Self {
        let Imported { views, cameras, unknown_cameras, unused_cameras, without_mask, distorted } = imported;
        let mut timesteps: Vec<u32> = views.iter().map(|view| view.timestep).collect();
        timesteps.dedup();
        let count = |split: CaptureSplit| views.iter().filter(|view| view.split == split).count();
        let [train, val, test] = CaptureSplit::ALL.map(count);
        Self {
            cameras: cameras.iter().map(|(number, name)| (number.to_string(), name.clone())).collect(),
            out: job.out.clone(),
            pictures: views.len(),
            test,
            timesteps: timesteps.len(),
            train,
            unknown_cameras,
            unused_cameras,
            val,
            without_mask,
            focal: None,
            stopped: false,
            numbered: cameras,
            file_of_cameras: job.cameras.clone().unwrap_or_default(),
            distorted,
        }
    }

    fn stopped(job: &ImportJob) -> Self {
        Self { stopped: true, ..Self::new(job, Imported::default()) }
    }
}

impl Report for ImportReport {
    fn stopped(&self) -> bool {
        self.stopped
    }
}

impl fmt::Display for ImportReport {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        let Self { pictures, timesteps, train, val, test, numbered, .. } = self;
        if self.stopped {
            return writeln!(f, "Stopped on request; there is no capture yet");
        }
        let listed = |names: &[String]| excerpts(names.iter().map(String::as_str), 16);
        let cameras = match numbered.len() {
            1 => "one camera".to_owned(),
            count => format!("{count} cameras"),
        };
        writeln!(
            f,
            "{pictures} pictures of {cameras} at {timesteps} timesteps: {train} for training, {val} of a held-out camera, {test} of held-out timesteps",
        )?;
        if numbered.len() > 1 {
            let numbered: Vec<String> =
                numbered.iter().map(|(number, name)| format!("{number}: {name}")).collect();
            write_line(f, format_args!("Cameras: {}", listed(&numbered)))?;
        }
        if let Some((focal, source)) = self.focal {
            writeln!(f, "Focal length: {}", focal_text(focal, source))?;
        }
        if !self.unknown_cameras.is_empty() {
            let (file, names) = (self.file_of_cameras.display(), listed(&self.unknown_cameras));
            write_line(f, format_args!("Left out, since {file} lacks them: cameras {names}"))?;
        }
        if !self.unused_cameras.is_empty() {
            write_line(f, format_args!("Without pictures: cameras {}", listed(&self.unused_cameras)))?;
        }
        if self.without_mask > 0 {
            writeln!(f, "Without a mask: {} pictures", self.without_mask)?;
        }
        if let Some((camera, how)) = &self.distorted {
            write_line(
                f,
                format_args!(
                    "The lens of camera {camera} distorts ({how}): the pictures must be undistorted, as by `colmap image_undistorter`"
                ),
            )?;
        }
        write_line(
            f,
            format_args!(
                "Written to {}; landmarks.csv there, or --landmarks, is what srflow avatar fit needs",
                self.out.display()
            ),
        )
    }
}
