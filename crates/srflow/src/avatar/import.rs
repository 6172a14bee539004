//! Captures from pictures in folders.

use std::collections::BTreeMap;
use std::fmt;
use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};
use srflow_avatar::capture::{
    CaptureSplit, CaptureView, ImportRequest, Imported, PicturePattern, import, write_transforms,
};
use srflow_core::{SettingError, excerpts};
use srflow_files::create_folder;

use super::paths::from_to;
use crate::clap::Args;
use crate::output::{ensure_folder, ensure_free, write_line};
use crate::{Job, Report, Watch};

/// Make a capture from pictures in folders and a file of their cameras
///
/// Writes the lists of a capture as VHAP exports it; the pictures stay where they are. Camera 8, or else the last one, and the last 30 % of
/// the timesteps are held out. `srflow avatar fit` adds a head. docs/reference/avatar-files.md describes the files.
#[derive(Args, Debug, Clone, PartialEq, Serialize, Deserialize)]
#[command(after_help = "Examples:
  srflow avatar import video --pattern 'cam_{camera}/frame_{timestep}' --cameras camera_params.json --out capture
  srflow avatar import frames --pattern '{timestep}_{camera}.png' --cameras colmap/sparse/0 --metres-per-unit 0.21 --out capture

Cameras: camera_params.json of NeRSemble, a COLMAP model, cameras.json of 3D Gaussian Splatting, or transforms.json, whose cameras are
named as in the pictures.")]
pub struct ImportJob {
    /// Folder of the pictures
    #[arg(value_name = "PICTURES")]
    pub pictures: PathBuf,
    /// Names of the pictures below PICTURES, with {camera} and {timestep}; without an extension, PNG and JPEG
    #[arg(long, value_name = "PATTERN")]
    pub pattern: PicturePattern,
    /// Names of the masks below PICTURES, white on the head
    #[arg(long, value_name = "PATTERN")]
    #[serde(default)]
    pub masks: Option<PicturePattern>,
    /// File of the cameras, or folder of a COLMAP model
    #[arg(long, value_name = "FILE")]
    pub cameras: PathBuf,
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
}

fn default_unit() -> f64 {
    1.0
}

impl Job for ImportJob {
    const NAME: &'static str = "avatar import";

    type Report = ImportReport;

    fn work(&self, _watch: &Watch) -> anyhow::Result<ImportReport> {
        ensure_folder(&self.out)?;
        let unit = self.metres_per_unit;
        if !(unit > 0.0 && unit.is_finite()) {
            let (field, expected) = ("metres_per_unit", "a number above 0".to_owned());
            return Err(SettingError { field, found: unit.to_string(), expected }.into());
        }
        ensure_free([self.out.join("transforms.json")], self.force)?;
        let imported = import(&ImportRequest {
            pictures: &self.pictures,
            pattern: &self.pattern,
            masks: self.masks.as_ref(),
            cameras: &self.cameras,
            unit,
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
            numbered: cameras,
            file_of_cameras: job.cameras.clone(),
            distorted,
        }
    }
}

impl Report for ImportReport {}

impl fmt::Display for ImportReport {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        let Self { pictures, timesteps, train, val, test, numbered, .. } = self;
        let listed = |names: &[String]| excerpts(names.iter().map(String::as_str), 16);
        writeln!(
            f,
            "{pictures} pictures of {} cameras at {timesteps} timesteps: {train} for training, {val} of a held-out camera, {test} of held-out timesteps",
            numbered.len(),
        )?;
        let numbered: Vec<String> =
            numbered.iter().map(|(number, name)| format!("{number}: {name}")).collect();
        write_line(f, format_args!("Cameras: {}", listed(&numbered)))?;
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
