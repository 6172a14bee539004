//! The motion of a face along a video, and the expressions in it.

use std::path::{Path, PathBuf};

use anyhow::Context as _;
use srflow_core::{FlowEstimator, Image};
use srflow_data::micro_expression::intervals::Interval;
use srflow_face::{FaceError, FacePoints, write_landmarks};
use srflow_files::{create_folder, write_file};
use srflow_mer::spotting::{FaceFollower, FaceView, Sight, SignalRecorder, Signals, elan, spot_events};

use super::files::write_signals;
use super::page::VideoPage;
use super::settings::SpottingArgs;
use super::spotted::{Event, SpottedVideo};
use crate::Watch;
use crate::error::wrong_settings;
use crate::face::FaceTrack;
use crate::flow::frames::Source;

/// Motion is measured at this rate, or a little more where the video's rate is no multiple of it.
const FPS: f64 = 30.0;

/// Ending of a video's page.
pub(super) const PAGE_ENDING: &str = "html";

/// A video, by its name without an ending.
pub(super) struct Video {
    pub name: String,
    pub path: PathBuf,
    pub source: Source,
    pub fps: f64,
}

impl Video {
    /// # Errors
    /// When there are no frames, or their rate is unknown or useless.
    pub fn open(path: &Path, fps: Option<f64>) -> anyhow::Result<Self> {
        let source = Source::open(&[path.to_owned()])?;
        let path = std::path::absolute(path)?;
        let name = if path.is_dir() { path.file_name() } else { path.file_stem() };
        let name = name.unwrap_or_default().to_string_lossy().into_owned();
        let mut failed = None;
        let fps = match (fps, source.measured_rate()) {
            (Some(fps), _) | (None, Some(fps)) if (10.0..=2000.0).contains(&fps) => fps,
            (None, None) => {
                // A video that cannot be read has no rate either.
                source.read(0, 1, |frame| {
                    failed = frame.err();
                    false
                });
                if let Some(error) = failed {
                    return Err(error);
                }
                wrong_settings!("{}: give its frames per second with `fps`", path.display())
            }
            (fps, found) => wrong_settings!(
                "{}: `fps` must be 10 to 2000, found {}",
                path.display(),
                fps.or(found).unwrap_or_default()
            ),
        };
        Ok(Self { name, path, source, fps })
    }

    /// Every so many frames are used.
    fn stride(&self) -> usize {
        ((self.fps / FPS) as usize).max(1)
    }

    /// Spots the events, and writes the video's own files into a folder; `None` if it was stopped.
    ///
    /// # Errors
    /// When frames cannot be read, no face is found, or files cannot be written.
    pub fn spot(
        &self,
        settings: &SpottingArgs,
        estimator: &dyn FlowEstimator,
        folder: &Path,
        watch: &Watch,
    ) -> anyhow::Result<Option<SpottedVideo>> {
        let followed = self.follow(settings, estimator, watch).with_context(|| self.name.clone())?;
        let Some(Followed { signals, view, landmarks }) = followed else { return Ok(None) };
        self.warn(&signals, &view, matches!(landmarks, Landmarks::None));
        let stride = self.stride();
        let fps = self.fps / stride as f64;
        let events = spot_events(&signals, fps, view.size().width, settings.limits()?);
        let first = self.source.first_number();
        let frame = |place: usize| first + (place * stride) as i64;
        let seconds = |place: usize| place as f64 / fps;
        let events: Vec<Event> =
            events.iter().map(|event| Event::new(event, &signals, frame, seconds, view.pixel())).collect();
        let frames = signals.usable.len();
        let usable = signals.usable.iter().filter(|usable| **usable).count();
        let spotted = SpottedVideo {
            video: self.name.clone(),
            path: self.path.clone(),
            seconds: frames as f64 / fps,
            usable: usable as f64 / frames.max(1) as f64,
            events,
        };
        create_folder(folder)?;
        let file = |ending: &str| folder.join(format!("{}.{ending}", self.name));
        write_signals(&file("frames.csv"), &signals, frame, seconds, view.pixel())?;
        if let Landmarks::Found(found) = &landmarks {
            let keys = |number: &i64| vec![self.name.clone(), number.to_string()];
            let rows = found.iter().map(|(number, points)| (keys(number), points));
            write_landmarks(&file("landmarks.csv"), &["video", "frame"], true, rows)?;
        }
        let intervals: Vec<Interval> =
            spotted.events.iter().map(|event| event.interval(&self.name)).collect();
        let date = chrono::Utc::now().to_rfc3339_opts(chrono::SecondsFormat::Secs, false);
        let media = self.source.video().map_or_else(|| self.name.clone(), |path| path.display().to_string());
        write_file(&file("eaf"), elan(&media, &intervals, first, self.fps, &date))?;
        let page = VideoPage {
            spotted: &spotted,
            signals: &signals,
            source: &self.source,
            stride,
            method: estimator.name(),
            pixel: view.pixel(),
        };
        page.write(&file(PAGE_ENDING))?;
        Ok(Some(spotted))
    }

    /// Measures the motion of the face; `None` if it was stopped.
    fn follow(
        &self,
        settings: &SpottingArgs,
        estimator: &dyn FlowEstimator,
        watch: &Watch,
    ) -> anyhow::Result<Option<Followed>> {
        let stride = self.stride();
        let total = self.source.pairs().map(|pairs| (pairs + 1).div_ceil(stride as u64));
        let done = watch.count("frames", total);
        done.message(self.name.as_str());
        let fps = self.fps / stride as f64;
        let mut track = settings.face.along(&self.name)?;
        let mut follower = FaceFollower::new(fps);
        let mut recorder = SignalRecorder::new(estimator, settings.head_motion, fps);
        let mut first_view = None;
        let mut landmarks = match &track {
            FaceTrack::Still(_) => Landmarks::None,
            FaceTrack::Table(_) => Landmarks::Given,
            FaceTrack::Found(_) => Landmarks::Found(Vec::new()),
        };
        let first_number = self.source.first_number();
        let mut place = 0;
        let mut take = |frame: &Image| -> anyhow::Result<()> {
            let number = first_number + (place * stride) as i64;
            place += 1;
            let sight = match &track {
                FaceTrack::Still(_) if first_view.is_some() => Sight::Same,
                FaceTrack::Still(face) => {
                    let view = FaceView::new(face.points.as_ref(), face.crop.clone(), frame)?;
                    Sight::Anew(Box::new(view))
                }
                _ => follower.follow(frame, || -> anyhow::Result<Option<FacePoints>> {
                    let points = track.points(number, frame)?;
                    if let (Landmarks::Found(found), Some(points)) = (&mut landmarks, &points) {
                        found.push((number, points.clone()));
                    }
                    Ok(points)
                })?,
            };
            if let (Sight::Anew(view), None) = (&sight, &first_view) {
                first_view = Some((**view).clone());
            }
            Ok(recorder.push(frame, sight)?)
        };
        let mut failed = None;
        let mut stopped = false;
        self.source.read(0, stride, |frame| {
            failed = frame.and_then(|frame| take(&frame.image)).err();
            done.inc();
            stopped = watch.stops();
            failed.is_none() && !stopped
        });
        if let Some(error) = failed {
            return Err(error);
        }
        if stopped {
            return Ok(None);
        }
        let view = first_view.ok_or(FaceError::NoFace)?;
        let mut signals = recorder.finish();
        for (usable, steady) in signals.usable.iter_mut().zip(follower.steady()) {
            *usable &= steady;
        }
        Ok(Some(Followed { signals, view, landmarks }))
    }

    /// Says where the face was not where the regions are.
    fn warn(&self, signals: &Signals, view: &FaceView, still: bool) {
        let unusable = signals.usable.iter().filter(|usable| !**usable).count();
        if unusable > 0 {
            log::warn!(
                "{}: in {:.0} % of the frames no face is seen or the head moves fast; no micro-expression is spotted there",
                self.name,
                (100 * unusable) as f64 / signals.usable.len() as f64
            );
        }
        let moved = signals.head.iter().map(|[x, y]| (x * x + y * y).sqrt()).fold(0.0, f64::max);
        let share = moved / view.size().width as f64;
        if still && share > FARTHEST {
            log::warn!(
                "{}: the face moves by {:.0} px, {:.0} % of its crop, which stays where it is: follow the face (`face` detect, or \
                 `landmarks` with a column `frame`)",
                self.name,
                moved * view.pixel(),
                100.0 * share
            );
        }
    }
}

/// How far a face may move in a crop that stays where it is, as a share of the crop's side.
const FARTHEST: f64 = 0.1;

/// What was measured along a video.
struct Followed {
    signals: Signals,
    /// The first one.
    view: FaceView,
    landmarks: Landmarks,
}

/// Where the landmarks that a face was followed by are from.
enum Landmarks {
    /// It was not followed.
    None,
    /// From the user.
    Given,
    /// Of frames in which the face was found.
    Found(Vec<(i64, FacePoints)>),
}
