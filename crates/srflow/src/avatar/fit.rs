//! Fitting a head model to landmarks.

use std::collections::BTreeSet;
use std::fmt;
use std::ops::RangeInclusive;
use std::path::{Path, PathBuf};
use std::str::FromStr;

use anyhow::Context as _;
use serde::{Deserialize, Serialize};
use srflow_avatar::HeadSource;
use srflow_avatar::capture::{Capture, CaptureView, LANDMARKS_NAME, Landmarks, write_tracked};
use srflow_avatar::fit::{
    FitOptions, FitReport, FitStage, LandmarkView, PictureFit, Reach, ReadPicture, fit,
};
use srflow_core::{SettingError, excerpts};
use srflow_files::{create_folder, write_file};
use srflow_head::HeadPose;
use srflow_render::capture::TrueCapture;
use srflow_render::mesh_error::{MeshError, mesh_error};

use super::mesh::default_seed;
use super::paths::from_to;
use super::scores::mesh_table;
use crate::clap::Args;
use crate::error::wrong_settings;
use crate::output::{ensure_folder, ensure_free, write_line, write_tables};
use crate::{Job, Report, Watch};

/// Fit a head model to the landmarks of a capture
///
/// Identity, and expressions, joint rotations and translation at every timestep, from the 68 landmarks of dlib in pictures of
/// any number of calibrated cameras. Missing pictures, missing landmarks and wrong detections are tolerated and reported. Writes a
/// capture as VHAP exports it, whose pictures stay where they are. docs/reference/avatar-files.md describes the files.
#[derive(Args, Debug, Clone, PartialEq, Serialize, Deserialize)]
#[command(after_help = "Examples:
  srflow avatar fit capture --model builtin-average --out fitted
  srflow avatar fit capture --model ict:FaceXModel --landmarks-of 8=openface.csv --cameras 8 --out front")]
pub struct FitJob {
    /// Folder of the capture: transforms.json or transforms_train.json with its cameras, and landmarks.csv
    #[arg(value_name = "DATA")]
    pub data: PathBuf,
    /// Head model
    #[arg(long, value_name = "HEAD", help = crate::render::head_help())]
    pub model: HeadSource,
    /// Folder to write
    #[arg(short, long, value_name = "DIR")]
    pub out: PathBuf,
    /// Landmarks: a table like landmarks.csv, or a folder of iBUG's .pts files named like the pictures
    /// [default: DATA/landmarks.csv]
    #[arg(long, value_name = "PATH", conflicts_with = "landmarks_of")]
    #[serde(default)]
    pub landmarks: Option<PathBuf>,
    /// Landmarks of one camera, as OpenFace writes them, or MediaPipe's as columns x_0, y_0, ...; may be
    /// repeated
    #[arg(long, value_name = "CAMERA=FILE")]
    #[serde(default)]
    pub landmarks_of: Vec<TableOf>,
    /// Use only these cameras
    #[arg(long, value_name = "N,N,...", value_delimiter = ',')]
    #[serde(default)]
    pub cameras: Vec<u32>,
    /// Standard deviation of the landmarks, in pixels [default: estimated]
    #[arg(long, value_name = "PIXELS")]
    #[serde(default)]
    pub noise: Option<f64>,
    /// Distance between the pupils in millimetres, about 63 in adults; gives the scale that a single camera
    /// cannot see
    #[arg(long, value_name = "MM")]
    #[serde(default)]
    pub eye_distance: Option<f64>,
    /// Then align the pictures with each other by the colours of the skin, turn the eyes to the irises, and close the lids
    #[arg(long)]
    #[serde(default)]
    pub photometric: bool,
    /// Fit at most this many shapes of the identity basis
    #[arg(long, value_name = "N", default_value_t = default_identities())]
    #[serde(default = "default_identities")]
    pub identities: usize,
    /// Fit at most this many shapes of the expression basis
    #[arg(long, value_name = "N", default_value_t = default_expressions())]
    #[serde(default = "default_expressions")]
    pub expressions: usize,
    /// Seed of a built-in head
    #[arg(long, value_name = "N", default_value_t = default_seed())]
    #[serde(default = "default_seed")]
    pub seed: u64,
    /// Compare the mesh with the true one in this capture of `srflow avatar capture`; may be DATA itself
    #[arg(long, value_name = "DIR")]
    #[serde(default)]
    pub truth: Option<PathBuf>,
    /// Overwrite an earlier fit in the folder
    #[arg(long)]
    #[serde(default)]
    pub force: bool,
}

fn default_identities() -> usize {
    FitOptions::default().identities
}

fn default_expressions() -> usize {
    FitOptions::default().expressions
}

/// Distances between pupils of people.
const EYE_DISTANCES_MM: RangeInclusive<f64> = 30.0..=100.0;

/// Identity weights of a head that the model finds likely are not larger.
const LIKELY_WEIGHT: f64 = 4.0;
const LIKELY_MEAN: f64 = 1.5;

/// Landmarks of one camera, written `CAMERA=FILE`.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct TableOf {
    pub camera: u32,
    pub file: PathBuf,
}

impl fmt::Display for TableOf {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        write!(f, "{}={}", self.camera, self.file.display())
    }
}

srflow_core::serialize_as_text!(TableOf);

impl FromStr for TableOf {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let parts = text.split_once('=').filter(|(_, file)| !file.is_empty());
        let table =
            parts.and_then(|(camera, file)| Some(Self { camera: camera.parse().ok()?, file: file.into() }));
        table.ok_or_else(|| {
            format!("`{text}`: expected the number of a camera and a file, such as 8=front.csv")
        })
    }
}

/// The fit that [`FitJob`] wrote, as in `fit.json`.
#[derive(Debug, Clone, Serialize)]
pub struct Fitted {
    pub data: PathBuf,
    pub model: String,
    pub out: PathBuf,
    pub timesteps: usize,
    pub pictures: usize,
    /// Landmarks of pictures that the capture does not have.
    pub unused_faces: usize,
    /// Where the origin of the written files was in those of the capture, metres.
    pub origin: [f64; 3],
    #[serde(flatten)]
    pub report: FitReport,
    #[serde(skip)]
    has_truth: bool,
    #[serde(skip)]
    eye_distance: Option<f64>,
    /// `None` without a true head, or where that has another mesh.
    pub mesh_error: Option<MeshError>,
}

/// The report of a fit, in its folder.
pub(super) const FIT_NAME: &str = "fit.json";

impl Job for FitJob {
    const NAME: &'static str = "avatar fit";

    type Report = Fitted;

    fn work(&self, watch: &Watch) -> anyhow::Result<Fitted> {
        ensure_folder(&self.out)?;
        if let Some(noise) = self.noise.filter(|noise| !(*noise > 0.0 && noise.is_finite())) {
            let (field, expected) = ("noise", "a number of pixels above 0".to_owned());
            return Err(SettingError { field, found: noise.to_string(), expected }.into());
        }
        if let Some(distance) = self.eye_distance.filter(|distance| !EYE_DISTANCES_MM.contains(distance)) {
            let expected = "a distance between the pupils from 30 to 100 mm".to_owned();
            return Err(SettingError { field: "eye_distance", found: distance.to_string(), expected }.into());
        }
        if self.landmarks.is_some() && !self.landmarks_of.is_empty() {
            wrong_settings!("`landmarks` and `landmarks_of` cannot be used together");
        }
        ensure_free([self.out.join("transforms.json")], self.force)?;
        let capture = Capture::read(&self.data)?;
        if same_folder(&self.out, &self.data) {
            wrong_settings!(
                "`out`: expected another folder than that of the capture, whose parameters would be overwritten"
            );
        }
        let landmarks = self.read_landmarks(&capture)?;
        let truth = self.truth.as_deref().map(TrueCapture::read).transpose().context("`truth`")?;
        let model = self.model.model(self.seed).with_context(|| format!("reading {}", self.model))?;

        let used = self.used_views(&capture)?;
        let faces: Vec<LandmarkView> = used
            .iter()
            .map(|view| LandmarkView {
                timestep: view.timestep,
                camera_index: view.camera_index,
                camera: view.camera,
                landmarks: landmarks.get(view.timestep, view.camera_index).copied().unwrap_or([None; 68]),
            })
            .collect();
        let known =
            capture.views().iter().filter(|view| landmarks.get(view.timestep, view.camera_index).is_some());
        let unused_faces = landmarks.len() - known.count();
        let options = FitOptions {
            identities: self.identities,
            expressions: self.expressions,
            eye_distance: self.eye_distance.map(|millimetres| millimetres / 1000.0),
            noise: self.noise,
            ..FitOptions::default()
        };
        let count = watch.count("steps", None);
        let read = |view: &LandmarkView| capture.image_at(view.timestep, view.camera_index);
        let pictures: Option<ReadPicture> = if self.photometric { Some(&read) } else { None };
        let fitted = fit(&model, &faces, pictures, &options, |stage, done, steps| {
            count.set_total(steps as u64);
            count.set(done as u64);
            count.message(match stage {
                FitStage::First => "first timestep",
                FitStage::Track => "tracking",
                FitStage::Refine => "all timesteps together",
                FitStage::Align => "aligning the pictures",
            });
        })?;

        if fitted.report.pictures.as_ref().is_some_and(|pictures| pictures.hidden.is_none()) {
            log::warn!(
                "the colours of the face change so much along the timesteps that it is unknown where something hides it"
            );
        }
        let hidden = fitted.report.pictures.iter().flat_map(|pictures| pictures.hidden.iter().flatten());
        let hidden: BTreeSet<(u32, u32)> = hidden.map(|view| (view.timestep, view.camera_index)).collect();
        create_folder(&self.out)?;
        let up = from_to(&self.out, capture.dir())?;
        let views: Vec<CaptureView> = used
            .into_iter()
            .filter(|view| !hidden.contains(&(view.timestep, view.camera_index)))
            .map(|view| CaptureView {
                image: up.join(&view.image),
                mask: view.mask.as_ref().map(|mask| up.join(mask)),
                ..view.clone()
            })
            .collect();
        let record = self.model.record(self.seed, &model)?;
        let parameters = fitted.parameters(&model);
        let origin = write_tracked(&self.out, &model, &record, &views, &fitted.timesteps, parameters)?;
        let mesh_error = match &truth {
            None => None,
            Some(truth) => {
                let written = Capture::read(&self.out)?;
                let parameters = written.parameters()?;
                let poses: Vec<HeadPose> = parameters.poses.iter().map(|pose| pose.pose(&model)).collect();
                mesh_error(truth, &written, &model, &model.shaped(&parameters.shape), &poses)
            }
        };
        let report = Fitted {
            data: self.data.clone(),
            model: self.model.to_string(),
            out: self.out.clone(),
            timesteps: fitted.timesteps.len(),
            pictures: faces.len(),
            unused_faces,
            origin: origin.to_array(),
            report: fitted.report,
            has_truth: truth.is_some(),
            eye_distance: self.eye_distance,
            mesh_error,
        };
        write_file(&self.out.join(FIT_NAME), serde_json::to_string_pretty(&report)? + "\n")?;
        Ok(report)
    }
}

impl FitJob {
    /// A fit of `model` to the capture in `data`, written to `out`, with the defaults of the other settings.
    pub fn new(data: PathBuf, model: HeadSource, out: PathBuf) -> Self {
        Self {
            data,
            model,
            out,
            landmarks: None,
            landmarks_of: Vec::new(),
            cameras: Vec::new(),
            noise: None,
            eye_distance: None,
            photometric: false,
            identities: default_identities(),
            expressions: default_expressions(),
            seed: default_seed(),
            truth: None,
            force: false,
        }
    }

    /// The views of the chosen cameras.
    fn used_views<'a>(&self, capture: &'a Capture) -> anyhow::Result<Vec<&'a CaptureView>> {
        if let Some(unknown) = self.cameras.iter().find(|camera| !capture.camera_indices().contains(camera)) {
            wrong_settings!(
                "`cameras` {unknown}: the capture has the cameras {:?}",
                capture.camera_indices()
            );
        }
        let is_used =
            |view: &&CaptureView| self.cameras.is_empty() || self.cameras.contains(&view.camera_index);
        Ok(capture.views().iter().filter(is_used).collect())
    }

    fn read_landmarks(&self, capture: &Capture) -> anyhow::Result<Landmarks> {
        if self.landmarks_of.is_empty() {
            let path = self.landmarks.clone().unwrap_or_else(|| self.data.join(LANDMARKS_NAME));
            let read = if path.is_dir() { Landmarks::read_points(&path) } else { Landmarks::read(&path) };
            let advice =
                "the landmarks of the capture; `landmarks` and `landmarks_of` read those of detectors";
            return read.context(advice);
        }
        let mut landmarks = Landmarks::default();
        for TableOf { camera, file } in &self.landmarks_of {
            let Some(view) = capture.views().iter().find(|view| view.camera_index == *camera) else {
                wrong_settings!(
                    "`landmarks_of` {camera}=: the capture has the cameras {:?}",
                    capture.camera_indices()
                );
            };
            landmarks.add_table(file, *camera, view.camera.size())?;
        }
        Ok(landmarks)
    }
}

fn same_folder(a: &Path, b: &Path) -> bool {
    matches!((a.canonicalize(), b.canonicalize()), (Ok(a), Ok(b)) if a == b)
}

impl Report for Fitted {}

impl fmt::Display for Fitted {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        let Self { timesteps, pictures, unused_faces, report, out, .. } = self;
        let cameras = report.cameras.len();
        let share = 100.0 * report.outliers as f64 / report.landmarks.max(1) as f64;
        write_line(
            f,
            format_args!(
                "Fitted timesteps: {timesteps}, pictures: {pictures}, cameras: {cameras}; written to {}",
                out.display()
            ),
        )?;
        writeln!(
            f,
            "{} landmarks ({}), {} missing, {} outliers ({share:.1} %), noise {:.2} px",
            report.landmarks, report.detector, report.missing, report.outliers, report.noise
        )?;
        for camera in &report.cameras {
            writeln!(
                f,
                "  camera {:>2}: {} landmarks, {} outliers, median distance {:.2} px",
                camera.camera_index, camera.landmarks, camera.outliers, camera.median
            )?;
        }
        if *unused_faces > 0 {
            writeln!(
                f,
                "The landmarks of {unused_faces} pictures were not used: the capture has no such timestep and camera."
            )?;
        }
        if !report.empty_timesteps.is_empty() {
            let names: Vec<String> = report.empty_timesteps.iter().map(u32::to_string).collect();
            writeln!(f, "Without landmarks, following from their neighbours: timesteps {}", listed(&names))?;
        }
        if !report.suspect_views.is_empty() {
            let names =
                report.suspect_views.iter().map(|view| picture_name(view.timestep, view.camera_index));
            writeln!(f, "Most landmarks are outliers in pictures {}", listed(&names.collect::<Vec<_>>()))?;
        }
        if let Some(PictureFit { points, noise_before, noise, gazes, hidden }) = &report.pictures {
            let [before, after] = [noise_before, noise].map(|noise| 100.0 * noise);
            writeln!(
                f,
                "Aligned {points} points of face and neck: colours of the face differ by {after:.1} %, {before:.1} % by the landmarks alone; irises found at {gazes} of {timesteps} timesteps"
            )?;
            if let Some(hidden) = hidden.as_ref().filter(|hidden| !hidden.is_empty()) {
                let names = hidden.iter().map(|view| picture_name(view.timestep, view.camera_index));
                let names = listed(&names.collect::<Vec<_>>());
                writeln!(f, "Left out, since something hides the face: pictures {names}")?;
            }
        }
        write_reach(f, &report.reach, self.eye_distance)?;
        if let Some(error) = &self.mesh_error {
            writeln!(f)?;
            write_tables(f, &[mesh_table(error)])?;
        } else if self.has_truth {
            write_line(
                f,
                format_args!(
                    "The true head has another mesh than {}: no points correspond, and no distance is known.",
                    self.model
                ),
            )?;
        }
        Ok(())
    }
}

fn write_reach(f: &mut fmt::Formatter, reach: &Reach, eye_distance: Option<f64>) -> fmt::Result {
    let Reach { timestep, cameras, depth, across, eye_corners: [corners, deviation], .. } = reach;
    let millimetres = |metres: f64| 1000.0 * metres;
    writeln!(
        f,
        "At timestep {timestep}, if the model can be this head: place known to {:.1} mm in depth and {:.1} mm across; outer corners \
         of the eyes {:.1} mm apart, known to {:.1} mm",
        millimetres(*depth),
        millimetres(*across),
        millimetres(*corners),
        millimetres(*deviation)
    )?;
    if reach.largest_identity > LIKELY_WEIGHT || reach.typical_identity > LIKELY_MEAN {
        writeln!(
            f,
            "The model finds this head unlikely: identity weights of up to {:.1} standard deviations, {:.1} on average. Do not trust \
             its shape, nor these numbers. Check the focal length; fit fewer shapes (`identities`) or give `eye_distance`.",
            reach.largest_identity, reach.typical_identity
        )?;
    }
    if *cameras == 1 && eye_distance.is_none() {
        writeln!(
            f,
            "One camera sees no scale: size and distance of the head follow from what heads the model finds likely. If you know the \
             distance between the pupils, give `eye_distance`."
        )?;
    }
    for (what, unknown, of) in [
        ("identity weights", &reach.unknown_identities, Some(reach.identities)),
        ("expression weights", &reach.unknown_expressions, Some(reach.expressions)),
        ("joints", &reach.unknown_joints, None),
    ] {
        if !unknown.is_empty() {
            let of = of.map(|of| format!(" ({} of {of})", unknown.len())).unwrap_or_default();
            write_line(f, format_args!("Not determined by the landmarks: {what}{of}: {}", listed(unknown)))?;
        }
    }
    Ok(())
}

fn picture_name(timestep: u32, camera: u32) -> String {
    format!("{timestep:05}_{camera:02}")
}

fn listed(names: &[String]) -> String {
    excerpts(names.iter().map(String::as_str), 12)
}
