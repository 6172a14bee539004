//! An avatar from a video of one person.

mod capture;
mod frames;
mod masks;
mod motion;
mod page;
mod scores;

use std::fmt;
use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};
use serde_json::Value;
use srflow_avatar::HeadSource;
use srflow_avatar::capture::{Capture, LANDMARKS_NAME, Landmarks, write_transforms};
use srflow_avatar::train::RUN_NAME;
use srflow_core::Plane;
use srflow_face::PersonMask;
use srflow_files::{FileKind, parse_error_in_words, read_text, write_file};
use srflow_head::{HeadModel, HeadParameters, PoseParameters, ShapedHead};

use super::fit::{FIT_NAME, FitJob};
use super::mesh_picture::shading;
use super::train::{Overrides, TrainJob, TrainReport, TrainedAvatar};
use crate::clap::Args;
use crate::error::wrong_settings;
use crate::output::{ensure_folder, write_line, write_page};
use crate::{Job, Report, Watch, WhenStopped};
pub(super) use capture::{CapturedVideo, focal_text};
pub use capture::{FocalSource, VideoArgs};
use masks::head_mask;
pub(super) use masks::{MASKS, write_masks};
pub use motion::MotionScores;
use motion::motion_scores;
use scores::face_scores;

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
    /// Distance between the pupils in millimetres, about 63 in adults; gives the scale that a single camera
    /// cannot see
    #[arg(long, value_name = "MM")]
    #[serde(default)]
    pub eye_distance: Option<f64>,
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
    #[command(flatten)]
    #[serde(flatten)]
    pub capture: VideoArgs,
}

fn default_model() -> HeadSource {
    "builtin-average".parse().unwrap_or_else(|_| HeadSource::builtin())
}

fn default_config() -> PathBuf {
    "video".into()
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

impl Job for FromVideoJob {
    const NAME: &'static str = "avatar from-video";
    const WHEN_STOPPED: WhenStopped = WhenStopped::Saved;

    type Report = AvatarOfVideo;

    fn work(&self, watch: &Watch) -> anyhow::Result<AvatarOfVideo> {
        ensure_folder(&self.out)?;
        self.capture.check()?;
        let models = self.capture.models.path()?;
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
        made.hidden = head.hidden();
        if !self.masks(&head, &models, watch)? {
            return Ok(made);
        }
        let trained = self.train(watch)?;
        if !trained.stopped {
            let landmarks = Landmarks::read(&self.out.join(LANDMARKS_NAME))?;
            let run = self.out.join(AVATAR);
            let source: HeadSource =
                format!("avatar:{}", run.display()).parse().map_err(anyhow::Error::msg)?;
            let avatar = source.avatar(0)?;
            let poses = head.capture.poses_of(&avatar)?;
            let posed = (&avatar, &poses[..]);
            let face = face_scores(&run, posed, &head.capture, &landmarks, page::FRAMES)?;
            made.face_psnr = face.as_ref().map(|face| face.psnr);
            made.motion = motion_scores(posed, &head.capture, &landmarks, watch)?;
            let scores = (face.as_ref(), made.motion.as_ref());
            let page = page::page(&self.video, &record, &head, &trained, scores)?;
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
            "frames": self.capture.most_frames(),
            "focal": self.capture.focal,
            "eye_distance": self.eye_distance,
            "face_index": self.capture.face_index,
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
        let Some(captured) = self.capture.capture(&self.video, &self.out, models, watch)? else {
            return Ok(None);
        };
        write_transforms(&self.out, &captured.views)?;
        let CapturedVideo { views, frames, focal, focal_source } = captured;
        let record = VideoRecord { settings, frames, chosen: views.len(), focal, focal_source };
        write_file(&self.out.join(VIDEO_NAME), serde_json::to_string_pretty(&record)? + "\n")?;
        Ok(Some(record))
    }

    fn fit(&self, watch: &Watch) -> anyhow::Result<()> {
        let out = self.out.join(HEAD);
        if out.join(FIT_NAME).exists() {
            return Ok(());
        }
        let job = FitJob::new(self.out.clone(), self.model.clone(), out);
        FitJob { eye_distance: self.eye_distance, photometric: true, force: true, ..job }
            .work(watch)
            .map(|_| ())
    }

    /// Writes the masks that are missing; `false` when it was stopped.
    fn masks(&self, head: &FittedHead, models: &Path, watch: &Watch) -> anyhow::Result<bool> {
        let person = PersonMask::read(models).map_err(|error| {
            log::warn!("{error}: masks follow the fitted head instead of the person");
        });
        write_masks(&self.out, head.capture.views(), watch, |place, image| {
            head_mask(image, &head.shading(place), person.as_ref().ok())
        })
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
    /// The contents of `fit.json`.
    report: Value,
    model: HeadModel,
    shaped: ShapedHead,
    poses: Vec<PoseParameters>,
}

impl FittedHead {
    fn read(dir: &Path, model: &HeadSource) -> anyhow::Result<Self> {
        let capture = Capture::read(dir)?;
        let path = dir.join(FIT_NAME);
        let report = serde_json::from_str(&read_text(&path, FileKind::Json)?)
            .map_err(|error| anyhow::anyhow!("{}: {}", path.display(), parse_error_in_words(&error)))?;
        let model = model.model(super::mesh::default_seed())?;
        let HeadParameters { shape, poses, .. } = capture.parameters()?;
        Ok(Self { shaped: model.shaped(&shape), capture, report, model, poses })
    }

    /// Frames that were left out, since something hides the face.
    fn hidden(&self) -> usize {
        self.report.pointer("/pictures/hidden").and_then(Value::as_array).map_or(0, Vec::len)
    }

    /// See [`shading`]; at this place among the views.
    fn shading(&self, place: usize) -> Plane {
        let mut vertices = Vec::new();
        self.model.vertices(&self.shaped, &self.poses[place].pose(&self.model), &mut vertices);
        let (surface, triangles) = self.model.surface(&vertices);
        shading(surface, triangles, &self.capture.views()[place].camera)
    }
}

/// What [`FromVideoJob`] made.
#[derive(Debug, Clone, Serialize)]
pub struct AvatarOfVideo {
    /// Folder of the avatar, once the run is complete.
    pub avatar: Option<PathBuf>,
    /// Focal length in pixels, and where it is from; `None` before it is known.
    pub focal: Option<(f64, FocalSource)>,
    /// PSNR on the face in held-out frames, dB, once the run is complete.
    pub face_psnr: Option<f64>,
    /// How far the avatar's flow is from the one measured in held-out frames, once the run is complete.
    pub motion: Option<MotionScores>,
    /// Frames that were chosen.
    pub frames: usize,
    /// Those of them that were left out, since something hides the face.
    pub hidden: usize,
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
            face_psnr: None,
            focal: None,
            frames: 0,
            hidden: 0,
            motion: None,
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
            let hidden = match self.hidden {
                0 => String::new(),
                hidden => format!(" (left out, since something hides the face: {hidden})"),
            };
            writeln!(f, "{} frames{hidden}, focal length {}", self.frames, focal_text(focal, source))?;
        }
        let (Some(avatar), Some(report)) = (&self.avatar, &self.report) else {
            return writeln!(f, "Stopped on request; the same command continues");
        };
        if let Some(psnr) = self.face_psnr {
            writeln!(f, "{psnr:.2} dB on the face in frames that were not trained on")?;
        }
        if let Some(MotionScores { distance, length, .. }) = self.motion {
            writeln!(
                f,
                "{distance:.2} px between the avatar's flow and the measured one, whose median length is {length:.2} px"
            )?;
        }
        write_line(f, format_args!("Avatar: {}", avatar.display()))?;
        write_page(f, report)
    }
}
