//! An avatar from a video of one person.

mod frames;
mod masks;
mod page;

use std::fmt;
use std::path::{Path, PathBuf};

use glam::{DMat3, DVec3};
use serde::{Deserialize, Serialize};
use serde_json::Value;
use srflow_avatar::HeadSource;
use srflow_avatar::capture::{Capture, CaptureView, LANDMARKS_NAME, split_of, write_transforms};
use srflow_avatar::train::RUN_NAME;
use srflow_core::{Plane, SettingError};
use srflow_face::{FaceFinder, PersonMask};
use srflow_files::{FileKind, create_folder, parse_error_in_words, read_text, write_file};
use srflow_head::{HeadModel, HeadParameters, PoseParameters, ShapedHead};
use srflow_splat::Camera;

use super::fit::{FIT_NAME, FitJob};
use super::mesh_picture::shading;
use super::train::{Overrides, TrainJob, TrainReport, TrainedAvatar};
use crate::clap::Args;
use crate::error::wrong_settings;
use crate::face::face_models;
use crate::output::{ensure_folder, write_line, write_page};
use crate::video::facts;
use crate::{Job, Report, Watch, WhenStopped};
use frames::{CAMERA, Frames, choose, image_name};
use masks::{MASKS, mask_name, write_mask};

/// Make an avatar from a video of one person
///
/// Chooses frames, finds the face in them, fits the head model, cuts out the head, trains the avatar, and
/// writes report.html. Running the same command again continues a stopped run. Needs ffmpeg and MediaPipe's networks.
#[derive(Args, Debug, Clone, PartialEq, Serialize, Deserialize)]
#[command(after_help = "\
Examples:
  srflow avatar from-video clip.mp4 --out me
  srflow avatar from-video clip.mp4 --out me --model ict:FaceXModel --eye-distance 63
  srflow render --head avatar:me/avatar --out dataset --scenes 1 --splits 1,0,0 --frames 48 --size 550x802

Film ten seconds or more, close and sharp, without cuts: turn the head to all sides, speak, smile, frown, raise the brows, close the eyes.")]
pub struct FromVideoJob {
    /// Video of one person
    #[arg(value_name = "VIDEO")]
    pub video: PathBuf,
    /// Folder to write
    #[arg(short, long, value_name = "DIR")]
    pub out: PathBuf,
    /// Head model
    #[arg(long, value_name = "HEAD", default_value_t = default_model(), help = crate::render::head_help())]
    #[serde(default = "default_model")]
    pub model: HeadSource,
    /// Use at most this many frames, spread over the video
    #[arg(long, value_name = "N", default_value_t = default_frames())]
    #[serde(default = "default_frames")]
    pub frames: usize,
    /// Focal length in pixels [default: recorded in the video, else 1.1 longer sides]
    #[arg(long, value_name = "PIXELS")]
    #[serde(default)]
    pub focal: Option<f64>,
    /// Distance between the pupils in millimetres, about 63 in adults; gives the scale that a single camera
    /// cannot see
    #[arg(long, value_name = "MM")]
    #[serde(default)]
    pub eye_distance: Option<f64>,
    /// Face to follow if there are several; 1 is the leftmost
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..))]
    #[serde(default)]
    pub face_index: Option<u16>,
    /// MediaPipe's package, as a folder or .whl file, or a folder with its networks
    /// [default: $SRFLOW_FACE_MODELS, or the package that python3 has installed]
    #[arg(long, value_name = "PATH")]
    #[serde(default)]
    pub face_models: Option<PathBuf>,
    /// Preset or TOML file of the training
    #[arg(long, value_name = "PRESET|FILE", default_value_os_t = default_config())]
    #[serde(default = "default_config")]
    pub config: PathBuf,
    /// Number of iterations of the training
    #[arg(long, value_name = "N")]
    #[serde(default)]
    pub iterations: Option<u64>,
    /// Delete what an earlier run has left in the folder and start over
    #[arg(long)]
    #[serde(default)]
    pub force: bool,
}

fn default_model() -> HeadSource {
    "builtin-average".parse().unwrap_or_else(|_| HeadSource::builtin())
}

fn default_frames() -> usize {
    240
}

fn default_config() -> PathBuf {
    "cpu".into()
}

/// Settings and what was found in the video, written once the capture is whole.
const VIDEO_NAME: &str = "video.json";
/// The fitted head, a capture.
const HEAD: &str = "head";
/// The training.
const AVATAR: &str = "avatar";
const REPORT_NAME: &str = "report.html";

/// The contents of `video.json`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
struct VideoRecord {
    /// Settings that determine the avatar.
    settings: Value,
    /// Frames of the video.
    frames: u64,
    /// Those that were chosen.
    chosen: usize,
    /// Pixels.
    focal: f64,
    focal_source: FocalSource,
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

/// The longer side of a frame of 35 mm film, millimetres.
const FILM: f64 = 36.0;

impl Job for FromVideoJob {
    const NAME: &'static str = "avatar from-video";
    const WHEN_STOPPED: WhenStopped = WhenStopped::Saved;

    type Report = AvatarOfVideo;

    fn work(&self, watch: &Watch) -> anyhow::Result<AvatarOfVideo> {
        ensure_folder(&self.out)?;
        if self.frames == 0 {
            let (field, expected) = ("frames", "at least 1".to_owned());
            return Err(SettingError { field, found: "0".to_owned(), expected }.into());
        }
        if let Some(focal) = self.focal.filter(|focal| !(*focal >= 1.0 && focal.is_finite())) {
            let (field, expected) = ("focal", "a number of pixels above 1".to_owned());
            return Err(SettingError { field, found: focal.to_string(), expected }.into());
        }
        let models = face_models(self.face_models.as_deref())?;
        let mut made = AvatarOfVideo::stopped(&self.out);
        let record = match self.begun()? {
            Some(record) => record,
            None => match self.capture(&models, watch)? {
                Some(record) => record,
                None => return Ok(made),
            },
        };
        made.frames = record.chosen;
        made.focal = Some((record.focal, record.focal_source));
        if watch.stops() {
            return Ok(made);
        }
        self.fit(watch)?;
        let head = FittedHead::read(&self.out.join(HEAD), &self.model)?;
        if !self.masks(&head, &models, watch)? {
            return Ok(made);
        }
        let trained = self.train(watch)?;
        if !trained.stopped {
            let page = page::page(&self.video, &self.out, &record, &head, &trained)?;
            write_file(&self.out.join(REPORT_NAME), page.html())?;
            made.avatar.clone_from(&trained.avatar);
            made.report = Some(self.out.join(REPORT_NAME));
            made.stopped = false;
        }
        made.training = Some(trained);
        Ok(made)
    }
}

impl FromVideoJob {
    /// Settings that determine the avatar, and the video's size in bytes.
    fn determining(&self) -> anyhow::Result<Value> {
        let bytes = srflow_files::open_file(&self.video, FileKind::Video)?.1;
        Ok(serde_json::json!({
            "video": self.video.file_name().unwrap_or_default().to_string_lossy(),
            "bytes": bytes,
            "model": self.model.to_string(),
            "frames": self.frames,
            "focal": self.focal,
            "eye_distance": self.eye_distance,
            "face_index": self.face_index,
            "config": self.config,
            "iterations": self.iterations,
        }))
    }

    /// What an earlier run of the same settings found in the video.
    ///
    /// # Errors
    /// When the folder has a run with other settings, and `force` does not allow to delete it.
    fn begun(&self) -> anyhow::Result<Option<VideoRecord>> {
        let path = self.out.join(VIDEO_NAME);
        if !path.exists() {
            return Ok(None);
        }
        if self.force {
            for folder in [MASKS, HEAD, AVATAR] {
                let folder = self.out.join(folder);
                if folder.exists() {
                    std::fs::remove_dir_all(&folder)
                        .map_err(|error| anyhow::anyhow!("{}: {error}", folder.display()))?;
                }
            }
            std::fs::remove_file(&path).map_err(|error| anyhow::anyhow!("{}: {error}", path.display()))?;
            return Ok(None);
        }
        let text = read_text(&path, FileKind::Json)?;
        let record: VideoRecord = serde_json::from_str(&text)
            .map_err(|error| anyhow::anyhow!("{}: {}", path.display(), parse_error_in_words(&error)))?;
        let now = self.determining()?;
        if record.settings != now {
            let differs = |key: &&String| record.settings.get(key.as_str()) != now.get(key.as_str());
            let keys = now.as_object().into_iter().flat_map(|now| now.keys());
            let different: Vec<&str> = keys.filter(differs).map(String::as_str).collect();
            wrong_settings!(
                "{}: an earlier run in this folder had another `{}`; give another `out`, or `force` to start over",
                path.display(),
                different.join("`, `")
            );
        }
        Ok(Some(record))
    }

    /// Writes the capture: frames, landmarks and the camera. `None` when it was stopped.
    fn capture(&self, models: &Path, watch: &Watch) -> anyhow::Result<Option<VideoRecord>> {
        let settings = self.determining()?;
        create_folder(&self.out)?;
        let facts = facts(&self.video);
        let Some(frames) = choose(self, facts.frames, FaceFinder::read(models)?, watch)? else {
            return Ok(None);
        };
        frames.landmarks.write(&self.out.join(LANDMARKS_NAME))?;
        let (focal, source) = self.focal_length(frames.size, facts.focal_length_35mm);
        write_transforms(&self.out, &views(&frames, focal))?;
        let (of, chosen) = (frames.of, frames.numbers.len());
        let record = VideoRecord { settings, frames: of, chosen, focal, focal_source: source };
        write_file(&self.out.join(VIDEO_NAME), serde_json::to_string_pretty(&record)? + "\n")?;
        Ok(Some(record))
    }

    /// In pixels, for frames of this size; `recorded` in the format of 35 mm film, millimetres.
    fn focal_length(&self, (width, height): (usize, usize), recorded: Option<f64>) -> (f64, FocalSource) {
        let side = width.max(height) as f64;
        match (self.focal, recorded) {
            (Some(given), _) => (given, FocalSource::Given),
            (None, Some(millimetres)) => (side * millimetres / FILM, FocalSource::Recorded),
            (None, None) => (side * USUAL_FOCAL, FocalSource::Assumed),
        }
    }

    fn fit(&self, watch: &Watch) -> anyhow::Result<()> {
        let out = self.out.join(HEAD);
        if out.join(FIT_NAME).exists() {
            return Ok(());
        }
        let job = FitJob::new(self.out.clone(), self.model.clone(), out);
        FitJob { eye_distance: self.eye_distance, force: true, ..job }.work(watch).map(|_| ())
    }

    /// Writes the masks that are missing; `false` when it was stopped.
    fn masks(&self, head: &FittedHead, models: &Path, watch: &Watch) -> anyhow::Result<bool> {
        let person = PersonMask::read(models).map_err(|error| {
            log::warn!("{error}: masks follow the fitted head instead of the person");
        });
        create_folder(&self.out.join(MASKS))?;
        let views = head.capture.views();
        let progress = watch.count("masks", views.len() as u64);
        for (place, view) in views.iter().enumerate() {
            if watch.stops() {
                return Ok(false);
            }
            if !self.out.join(mask_name(view.timestep)).exists() {
                write_mask(&self.out, view.timestep, &head.shading(place), person.as_ref().ok())?;
            }
            progress.inc();
        }
        Ok(true)
    }

    fn train(&self, watch: &Watch) -> anyhow::Result<TrainedAvatar> {
        let out = self.out.join(AVATAR);
        let job = match out.join(RUN_NAME).exists() {
            true => TrainJob { resume: Some(out), ..TrainJob::default() },
            false => TrainJob {
                data: Some(self.out.join(HEAD)),
                out: Some(out),
                config: Some(self.config.clone()),
                overrides: Overrides {
                    iterations: self.iterations,
                    set: vec!["apply_masks=true".to_owned()],
                    ..Overrides::default()
                },
                ..TrainJob::default()
            },
        };
        match job.work(watch)? {
            TrainReport::Run(run) => Ok(run),
            TrainReport::Configuration(_) => {
                wrong_settings!("`print_config` is a setting of `avatar train` alone")
            }
        }
    }
}

/// The fitted head in each frame.
struct FittedHead {
    capture: Capture,
    model: HeadModel,
    shaped: ShapedHead,
    poses: Vec<PoseParameters>,
}

impl FittedHead {
    fn read(dir: &Path, model: &HeadSource) -> anyhow::Result<Self> {
        let capture = Capture::read(dir)?;
        let model = model.model(super::mesh::default_seed())?;
        let HeadParameters { shape, poses, .. } = capture.parameters()?;
        Ok(Self { shaped: model.shaped(&shape), capture, model, poses })
    }

    /// See [`shading`]; at this place among the views.
    fn shading(&self, place: usize) -> Plane {
        let mut vertices = Vec::new();
        self.model.vertices(&self.shaped, &self.poses[place].pose(&self.model), &mut vertices);
        let (surface, triangles) = self.model.surface(&vertices);
        shading(surface, triangles, &self.capture.views()[place].camera)
    }
}

/// The pictures of a camera in front of the head, with square pixels and its axis through the middle.
fn views(frames: &Frames, focal: f64) -> Vec<CaptureView> {
    let facing = DMat3::from_diagonal(DVec3::new(1.0, -1.0, -1.0));
    let camera = Camera::centred(frames.size, [focal; 2]).placed(facing, DVec3::Z);
    let timesteps: Vec<u32> = (0..frames.numbers.len() as u32).collect();
    let split_of = split_of(&timesteps, &[CAMERA]);
    let view = |timestep: &u32| CaptureView {
        split: split_of(*timestep, CAMERA),
        timestep: *timestep,
        camera_index: CAMERA,
        camera,
        image: image_name(*timestep),
        mask: Some(mask_name(*timestep)),
        parameters: None,
    };
    timesteps.iter().map(view).collect()
}

fn focal_text(pixels: f64, source: FocalSource) -> String {
    let source = match source {
        FocalSource::Given => "as given",
        FocalSource::Recorded => "as the camera recorded it",
        FocalSource::Assumed => "assumed; give `focal` if you know it",
    };
    format!("{pixels:.0} px, {source}")
}

/// What [`FromVideoJob`] made.
#[derive(Debug, Clone, Serialize)]
pub struct AvatarOfVideo {
    /// Folder of the avatar, once the run is complete.
    pub avatar: Option<PathBuf>,
    /// Focal length in pixels, and where it is from; `None` before it is known.
    pub focal: Option<(f64, FocalSource)>,
    /// Frames that were chosen.
    pub frames: usize,
    pub out: PathBuf,
    /// The report as a page, once the run is complete.
    pub report: Option<PathBuf>,
    pub stopped: bool,
    /// The training, once it has begun.
    pub training: Option<TrainedAvatar>,
}

impl AvatarOfVideo {
    /// A run that was stopped before anything was done.
    fn stopped(out: &Path) -> Self {
        Self {
            avatar: None,
            focal: None,
            frames: 0,
            out: out.to_owned(),
            report: None,
            stopped: true,
            training: None,
        }
    }
}

impl Report for AvatarOfVideo {
    fn stopped(&self) -> bool {
        self.stopped
    }
}

impl fmt::Display for AvatarOfVideo {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        if let Some((focal, source)) = self.focal {
            writeln!(f, "{} frames, focal length {}", self.frames, focal_text(focal, source))?;
        }
        let (Some(avatar), Some(report)) = (&self.avatar, &self.report) else {
            return writeln!(f, "Stopped on request; the same command continues");
        };
        if let Some(training) = &self.training {
            for score in &training.scores {
                writeln!(f, "{:.2} dB on frames that were not trained on", score.mean.psnr)?;
            }
        }
        write_line(f, format_args!("Avatar: {}", avatar.display()))?;
        write_page(f, report)
    }
}
