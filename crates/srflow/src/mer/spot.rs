//! Expressions in long videos.

use std::collections::BTreeSet;
use std::fmt;
use std::path::{Path, PathBuf};

use anyhow::{Context as _, ensure};
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};
use srflow_core::resize::resize_image_antialiased;
use srflow_core::{FlowEstimator, Image};
use srflow_data::micro_expression::intervals::{ExpressionKind, Interval};
use srflow_files::{FileKind, create_folder, read_text, write_atomically, write_file};
use srflow_mer::HeadMotion;
use srflow_mer::spotting::{
    REGIONS, SignalRecorder, Signals, SpottedEvent, SpottingSettings, elan, regions, spot_events,
};

use crate::clap::Args;
use crate::error::wrong_settings;
use crate::face::FaceArgs;
use crate::flow::frames::Source;
use crate::methods::{self, MethodParameters, MethodSpec};
use crate::output::{ensure_folder, write_line};
use crate::{Job, Report, Watch, WhenStopped};

/// Motion is measured at this rate, or a little more where the video's rate is no multiple of it.
const FPS: f64 = 30.0;

/// Larger faces are shrunk to this side, in pixels.
const LARGEST_SIDE: usize = 256;

/// The list of the settings, in the folder of the results.
const SETTINGS_NAME: &str = "spot.json";
/// Ending of the record of a finished video.
const RECORD_ENDING: &str = ".events.json";
const EVENTS_NAME: &str = "events.csv";
const MEGC_NAME: &str = "megc.csv";

/// Spot micro- and macro-expressions in long videos
#[derive(Args, Debug, Clone, PartialEq, Serialize, Deserialize)]
#[command(after_help = "\
Examples:
  srflow mer spot interview.mp4 --face detect --out spotted
  srflow mer spot long/s01 long/s02 --fps 30 --landmarks long/landmarks.csv --out spotted
  srflow mer spot-score spotted/events.csv --truth long/events.csv

The folder has events.csv (all events, with seconds, region and strength), megc.csv (the challenges' form), and for each \
video NAME.frames.csv (the motion of 16 regions) and NAME.eaf (for ELAN). The face should stay near its place in the first \
frame. Running the same command again continues with the videos that are missing.")]
pub struct SpotJob {
    /// Videos, or folders of frames
    #[arg(required = true, value_name = "VIDEO|FRAMES")]
    pub videos: Vec<PathBuf>,
    /// Folder of the results
    #[arg(short, long, value_name = "DIR")]
    pub out: PathBuf,
    /// Frames per second [default: the video's]
    #[arg(long, value_name = "RATE")]
    #[serde(default)]
    pub fps: Option<f64>,
    /// How to estimate the flow
    #[arg(long, value_name = "METHOD", default_value_t = default_method(), help = methods::Method::help())]
    #[serde(default = "default_method")]
    pub method: MethodSpec,
    /// The head's motion in the flow: keep or subtract
    #[arg(long, value_name = "WHAT", default_value_t)]
    #[serde(default)]
    pub head_motion: HeadMotion,
    /// Spot micro-expressions that stand out from noise and surroundings by this factor
    #[arg(long, value_name = "FACTOR", default_value_t = SpottingSettings::default().micro_score)]
    #[serde(default = "default_micro_score")]
    pub micro_score: f64,
    /// Spot macro-expressions that stand out from noise by this factor
    #[arg(long, value_name = "FACTOR", default_value_t = SpottingSettings::default().macro_score)]
    #[serde(default = "default_macro_score")]
    pub macro_score: f64,
    /// Start over where the folder has results of other settings
    #[arg(long)]
    #[serde(default)]
    pub force: bool,
    #[command(flatten)]
    #[serde(flatten)]
    pub face: FaceArgs,
    #[command(flatten)]
    #[serde(flatten)]
    pub parameters: MethodParameters,
}

/// The fastest one: a video has many frames, and their motion is averaged over regions.
fn default_method() -> MethodSpec {
    "farneback".parse().expect("the name of a method")
}

fn default_micro_score() -> f64 {
    SpottingSettings::default().micro_score
}

fn default_macro_score() -> f64 {
    SpottingSettings::default().macro_score
}

impl Job for SpotJob {
    const NAME: &'static str = "mer spot";
    const WHEN_STOPPED: WhenStopped = WhenStopped::UnitsKept;

    type Report = SpotReport;

    fn work(&self, watch: &Watch) -> anyhow::Result<SpotReport> {
        for (name, value) in [("micro_score", self.micro_score), ("macro_score", self.macro_score)] {
            if !(value > 0.0 && value.is_finite()) {
                wrong_settings!("`{name}` must be a positive number");
            }
        }
        ensure_folder(&self.out)?;
        let mut names = BTreeSet::new();
        let mut videos = Vec::new();
        for path in &self.videos {
            let source = Source::open(std::slice::from_ref(path))?;
            let path = std::path::absolute(path)?;
            let name = if path.is_dir() { path.file_name() } else { path.file_stem() };
            let name = name.unwrap_or_default().to_string_lossy().into_owned();
            if !names.insert(name.clone()) {
                wrong_settings!("{}: another video is called `{name}`, too; rename one", path.display());
            }
            let fps = match (self.fps, source.measured_rate()) {
                (Some(fps), _) | (None, Some(fps)) if (10.0..=2000.0).contains(&fps) => fps,
                (None, None) => wrong_settings!("{}: give its frames per second with `fps`", path.display()),
                (fps, found) => wrong_settings!(
                    "{}: `fps` must be 10 to 2000, found {}",
                    path.display(),
                    fps.or(found).unwrap_or_default()
                ),
            };
            videos.push(Video { name, path, source, fps });
        }
        let estimator = methods::estimator(&self.method, &self.parameters, watch)?;
        self.claim()?;

        let mut spotted = Vec::new();
        let mut stopped = false;
        for video in &videos {
            let kept = self.out.join(format!("{}{RECORD_ENDING}", video.name));
            let result = match kept.is_file() {
                true => video.kept(&kept)?,
                false => match self.spot(video, estimator.as_ref(), watch)? {
                    Some(result) => result,
                    None => {
                        stopped = true;
                        break;
                    }
                },
            };
            spotted.push(result);
        }
        if !stopped {
            write_events(&self.out.join(EVENTS_NAME), &spotted)?;
            write_megc(&self.out.join(MEGC_NAME), &spotted)?;
        }
        Ok(SpotReport {
            out: self.out.clone(),
            method: estimator.name().to_owned(),
            videos: spotted,
            stopped,
        })
    }
}

struct Video {
    name: String,
    path: PathBuf,
    source: Source,
    fps: f64,
}

impl Video {
    /// What an earlier run spotted in this video.
    fn kept(&self, record: &Path) -> anyhow::Result<SpottedVideo> {
        let spotted: SpottedVideo = serde_json::from_str(&read_text(record, FileKind::Json)?)
            .with_context(|| format!("{}: delete it and run the command again", record.display()))?;
        ensure!(
            spotted.path == self.path,
            "{}: expected the events of {}, found those of {}; choose another folder",
            record.display(),
            self.path.display(),
            spotted.path.display()
        );
        Ok(spotted)
    }
}

impl SpotJob {
    /// Writes the settings into the folder, which has none or the same.
    fn claim(&self) -> anyhow::Result<()> {
        let mut settings = serde_json::to_value(self)?;
        if let Value::Object(settings) = &mut settings {
            ["videos", "out", "force"].iter().for_each(|field| _ = settings.remove(*field));
        }
        let settings = json!({ "srflow_version": env!("CARGO_PKG_VERSION"), "settings": settings });
        let path = self.out.join(SETTINGS_NAME);
        if path.is_file() && !self.force {
            let found: Value = serde_json::from_str(&read_text(&path, FileKind::Json)?).unwrap_or_default();
            ensure!(
                found == settings,
                "{}: the folder has results of other settings; choose another, or `force` to start over",
                self.out.display()
            );
            return Ok(());
        }
        create_folder(&self.out)?;
        if self.force {
            self.forget()?;
        }
        Ok(write_file(&path, serde_json::to_string_pretty(&settings)? + "\n")?)
    }

    /// Removes the records of all videos: they may be of other settings.
    fn forget(&self) -> anyhow::Result<()> {
        for entry in std::fs::read_dir(&self.out).with_context(|| self.out.display().to_string())? {
            let path = entry?.path();
            if path.to_string_lossy().ends_with(RECORD_ENDING) {
                std::fs::remove_file(&path).with_context(|| path.display().to_string())?;
            }
        }
        Ok(())
    }

    /// Spots the events of a video, and writes its files; `None` if it was stopped.
    fn spot(
        &self,
        video: &Video,
        estimator: &dyn FlowEstimator,
        watch: &Watch,
    ) -> anyhow::Result<Option<SpottedVideo>> {
        let stride = ((video.fps / FPS) as usize).max(1);
        let fps = video.fps / stride as f64;
        let total = video.source.pairs().map(|pairs| (pairs + 1).div_ceil(stride as u64));
        let done = watch.count("frames", total);
        done.message(video.name.as_str());
        let mut followed: Option<Followed> = None;
        let mut failed = None;
        let mut stopped = false;
        video.source.read(0, stride, |frame| {
            let follow = || -> anyhow::Result<()> {
                let frame = frame?;
                let followed = match &mut followed {
                    Some(followed) => followed,
                    none => none.insert(Followed::new(self, video, &frame.image, estimator, fps)?),
                };
                followed.recorder.push(followed.face.cut(&frame.image)?)?;
                done.inc();
                Ok(())
            };
            failed = follow().err();
            stopped = watch.stops();
            failed.is_none() && !stopped
        });
        if let Some(error) = failed {
            return Err(error.context(video.name.clone()));
        }
        if stopped {
            return Ok(None);
        }
        let Followed { recorder, face } = followed.context("the video has no frames")?;
        let signals = recorder.finish();
        warn_of_head_motion(&video.name, &signals, &face);
        let Self { micro_score, macro_score, .. } = *self;
        let events = spot_events(&signals, fps, face.side, SpottingSettings { micro_score, macro_score });
        let first = video.source.first_number();
        let frame = |place: usize| first + (place * stride) as i64;
        let seconds = |place: usize| place as f64 / fps;
        let events: Vec<Event> =
            events.iter().map(|event| Event::new(event, frame, seconds, face.shrunk)).collect();
        let spotted = SpottedVideo {
            video: video.name.clone(),
            path: video.path.clone(),
            seconds: signals.regions.len() as f64 / fps,
            events,
        };

        write_signals(
            &self.out.join(format!("{}.frames.csv", video.name)),
            &signals,
            frame,
            seconds,
            face.shrunk,
        )?;
        let intervals: Vec<Interval> =
            spotted.events.iter().map(|event| event.interval(&video.name)).collect();
        let date = chrono::Utc::now().to_rfc3339_opts(chrono::SecondsFormat::Secs, false);
        let media =
            video.source.video().map_or_else(|| video.name.clone(), |path| path.display().to_string());
        write_file(
            &self.out.join(format!("{}.eaf", video.name)),
            elan(&media, &intervals, first, video.fps, &date),
        )?;
        // The record says that the video is finished, so it comes last.
        write_file(
            &self.out.join(format!("{}{RECORD_ENDING}", video.name)),
            serde_json::to_string_pretty(&spotted)? + "\n",
        )?;
        Ok(Some(spotted))
    }
}

/// A video that is being followed.
struct Followed<'a> {
    recorder: SignalRecorder<'a>,
    face: Face,
}

/// How far a face may move from its place in the first frame, as a share of the crop's side.
const FARTHEST: f64 = 0.1;

fn warn_of_head_motion(video: &str, signals: &Signals, face: &Face) {
    let moved = signals.head.iter().map(|[x, y]| (x * x + y * y).sqrt()).fold(0.0, f64::max);
    if moved > FARTHEST * face.side as f64 {
        log::warn!(
            "{video}: the face moves by {:.0} px, {:.0} % of its crop: regions are no longer where they were in the first frame, so \
             check what is spotted, or cut the video",
            moved * face.shrunk,
            100.0 * moved / face.side as f64
        );
    }
}

/// How the face is cut out of every frame.
struct Face {
    crop: srflow_face::FrameCrop,
    size: (usize, usize),
    side: usize,
    /// Pixels of the video per pixel of the face that flow is estimated on.
    shrunk: f64,
}

impl<'a> Followed<'a> {
    fn new(
        job: &SpotJob,
        video: &Video,
        first: &Image,
        estimator: &'a dyn FlowEstimator,
        fps: f64,
    ) -> anyhow::Result<Self> {
        let found = job.face.of_video(&video.name, first)?;
        let cropped = found.crop.apply(first)?.size();
        let boxes = regions(found.points.as_ref(), &found.crop, cropped);
        let longest = cropped.0.max(cropped.1);
        let shrunk = (longest as f64 / LARGEST_SIDE as f64).max(1.0);
        let small = |length: usize| ((length as f64 / shrunk).round() as usize).max(1);
        let size = (small(cropped.0), small(cropped.1));
        let boxes = boxes.map(|ranges| {
            ranges.map(|[first, end]| {
                let first = (first as f64 / shrunk) as usize;
                [first, ((end as f64 / shrunk).round() as usize).max(first + 1)]
            })
        });
        let recorder = SignalRecorder::new(estimator, job.head_motion, boxes, fps);
        Ok(Self { recorder, face: Face { crop: found.crop, size, side: size.0, shrunk } })
    }
}

impl Face {
    fn cut(&self, frame: &Image) -> anyhow::Result<Image> {
        let face = self.crop.apply(frame)?;
        Ok(if face.size() == self.size { face } else { resize_image_antialiased(&face, self.size) })
    }
}

/// What was spotted in a video.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct SpottedVideo {
    pub video: String,
    /// Its file or folder.
    pub path: PathBuf,
    pub seconds: f64,
    pub events: Vec<Event>,
}

/// A spotted expression. Frames are numbered as in the names of the files, or from 1 in a video, and inclusive.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Event {
    #[serde(rename = "type")]
    pub kind: ExpressionKind,
    pub onset: i64,
    pub apex: i64,
    pub offset: i64,
    pub onset_seconds: f64,
    pub apex_seconds: f64,
    pub offset_seconds: f64,
    /// The region that stands out most.
    pub region: String,
    /// How far it moves, in pixels of the video.
    pub height_px: f64,
    /// How far it stands out from noise, and from its surroundings if the expression is short.
    pub score: f64,
    /// Whether the lids move more: perhaps a blink.
    pub with_lids: bool,
}

impl Event {
    fn new(
        event: &SpottedEvent,
        frame: impl Fn(usize) -> i64,
        seconds: impl Fn(usize) -> f64,
        shrunk: f64,
    ) -> Self {
        Self {
            kind: event.kind,
            onset: frame(event.onset),
            apex: frame(event.apex),
            offset: frame(event.offset),
            onset_seconds: seconds(event.onset),
            apex_seconds: seconds(event.apex),
            offset_seconds: seconds(event.offset),
            region: event.region.to_owned(),
            height_px: event.height_px * shrunk,
            score: event.score,
            with_lids: event.with_lids,
        }
    }

    fn interval(&self, video: &str) -> Interval {
        Interval {
            video: video.to_owned(),
            kind: self.kind,
            onset: self.onset,
            apex: Some(self.apex),
            offset: self.offset,
            label: self.region.clone(),
            action_units: String::new(),
        }
    }
}

/// The events of all videos, with the names of these.
fn events_of(videos: &[SpottedVideo]) -> impl Iterator<Item = (&str, &Event)> {
    videos.iter().flat_map(|video| video.events.iter().map(move |event| (video.video.as_str(), event)))
}

/// All events, with seconds, region and strength.
fn write_events(path: &Path, videos: &[SpottedVideo]) -> anyhow::Result<()> {
    Ok(write_atomically(path, |writer| {
        let mut table = csv::Writer::from_writer(writer);
        table.write_record([
            "video",
            "type",
            "onset",
            "apex",
            "offset",
            "onset_s",
            "apex_s",
            "offset_s",
            "duration_ms",
            "rise_ms",
            "region",
            "height_px",
            "score",
            "with_lids",
        ])?;
        for (video, event) in events_of(videos) {
            let milliseconds = |from: f64, to: f64| format!("{:.0}", 1000.0 * (to - from));
            table.write_record([
                video,
                event.kind.name(),
                &event.onset.to_string(),
                &event.apex.to_string(),
                &event.offset.to_string(),
                &format!("{:.3}", event.onset_seconds),
                &format!("{:.3}", event.apex_seconds),
                &format!("{:.3}", event.offset_seconds),
                &milliseconds(event.onset_seconds, event.offset_seconds),
                &milliseconds(event.onset_seconds, event.apex_seconds),
                &event.region,
                &format!("{:.3}", event.height_px),
                &format!("{:.2}", event.score),
                if event.with_lids { "yes" } else { "no" },
            ])?;
        }
        table.flush()
    })?)
}

/// As the challenges take it: `vid,pred_onset,pred_offset,type`.
fn write_megc(path: &Path, videos: &[SpottedVideo]) -> anyhow::Result<()> {
    Ok(write_atomically(path, |writer| {
        let mut table = csv::Writer::from_writer(writer);
        table.write_record(["vid", "pred_onset", "pred_offset", "type"])?;
        for (video, event) in events_of(videos) {
            let kind = match event.kind {
                ExpressionKind::Micro => "me",
                ExpressionKind::Macro => "mae",
            };
            table.write_record([video, &event.onset.to_string(), &event.offset.to_string(), kind])?;
        }
        table.flush()
    })?)
}

/// The motion of every region in every frame, in pixels of the video.
fn write_signals(
    path: &Path,
    signals: &Signals,
    frame: impl Fn(usize) -> i64,
    seconds: impl Fn(usize) -> f64,
    shrunk: f64,
) -> anyhow::Result<()> {
    Ok(write_atomically(path, |writer| {
        let mut table = csv::Writer::from_writer(writer);
        let columns = REGIONS.iter().flat_map(|region| ["x", "y"].map(|axis| format!("{region}_{axis}")));
        let first = ["frame", "timestamp", "head_x", "head_y"].map(str::to_owned);
        table.write_record(first.into_iter().chain(columns))?;
        for (place, (regions, head)) in signals.regions.iter().zip(&signals.head).enumerate() {
            let values =
                head.iter().chain(regions.as_flattened()).map(|value| format!("{:.4}", value * shrunk));
            let place = [frame(place).to_string(), format!("{:.4}", seconds(place))];
            table.write_record(place.into_iter().chain(values))?;
        }
        table.flush()
    })?)
}

/// The result of spotting.
#[derive(Debug, Clone, Serialize)]
pub struct SpotReport {
    #[serde(skip)]
    out: PathBuf,
    pub method: String,
    pub videos: Vec<SpottedVideo>,
    #[serde(skip)]
    stopped: bool,
}

impl Report for SpotReport {
    fn stopped(&self) -> bool {
        self.stopped
    }
}

impl fmt::Display for SpotReport {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        for SpottedVideo { video, seconds, events, .. } in &self.videos {
            let micro = events.iter().filter(|event| event.kind == ExpressionKind::Micro).count();
            write_line(
                f,
                format_args!(
                    "{video}: {micro} micro- and {} macro-expressions in {seconds:.1} s",
                    events.len() - micro
                ),
            )?;
        }
        if self.stopped {
            return Ok(());
        }
        write_line(f, format_args!("Events: {}", self.out.join(EVENTS_NAME).display()))
    }
}
