//! Rendering the frames of long videos.

use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};
use srflow_avatar::{HeadSource, PosedHead};
use srflow_files::write_image_png;
use srflow_splat::{Frame, Gaussians, Options, Outputs, RasterizeError, Rasterizer};

use super::settings::LongSettings;
use super::timeline::Video;
use crate::job::{Layout, Plan, Run, Stage, leading_number, names_in, remove};
use crate::record::json_text;
use crate::synth::portrait::BACKDROP;
use crate::synth::{DISTURBANCES_NAME, LANDMARKS_NAME};
use crate::{RenderError, head};

/// Name of the file with the arguments.
const SETTINGS_NAME: &str = "long.json";

/// Name of the file with every expression.
pub const EVENTS_NAME: &str = "events.csv";

/// Frames that are made together. A video has a whole number of pieces.
pub const PIECE: u32 = 30;

type Work<'w> = crate::job::Work<'w, Videos>;

/// The contents of `long.json`.
#[derive(Debug, Serialize, Deserialize)]
struct Arguments {
    srflow_version: String,
    #[serde(flatten)]
    settings: LongSettings,
}

/// A set of long videos, one for each subject.
pub(crate) struct Videos {
    arguments: Arguments,
    head: Vec<HeadSource>,
}

impl Videos {
    pub fn new(settings: LongSettings) -> Result<Self, RenderError> {
        settings.check()?;
        let recorded = head::recorded_in_turn(&settings.head)?;
        let head = head::with_look(&settings.head, settings.look);
        let settings = LongSettings { head: recorded, ..settings };
        let srflow_version = env!("CARGO_PKG_VERSION").to_owned();
        Ok(Self { arguments: Arguments { srflow_version, settings }, head })
    }

    /// Of the set in a folder.
    pub fn read(dir: &Path) -> Result<Self, RenderError> {
        let arguments: Arguments = head::read_settings(&dir.join(SETTINGS_NAME))?;
        let settings = &arguments.settings;
        settings.check()?;
        Ok(Self { head: head::with_look(&settings.head, settings.look), arguments })
    }

    pub fn settings(&self) -> &LongSettings {
        &self.arguments.settings
    }

    pub fn video(&self, subject: u32) -> Result<Video, RenderError> {
        let name = name(subject);
        let avatar = head::of_subject(&self.head, self.settings().seed, subject, &name)?;
        Ok(Video::new(name, avatar, self.settings(), subject, self.settings().frames(PIECE))?)
    }
}

/// The name of a subject's video, e.g. `s03`.
fn name(subject: u32) -> String {
    format!("s{:02}", subject + 1)
}

/// The frames of a piece, from 1.
fn frames_of(piece: u32) -> std::ops::RangeInclusive<u32> {
    piece * PIECE + 1..=(piece + 1) * PIECE
}

fn file_of(dir: &Path, subject: u32, frame: u32) -> PathBuf {
    dir.join(name(subject)).join(format!("{frame:06}.png"))
}

impl Layout for Videos {
    const MANIFEST: &'static str = SETTINGS_NAME;
    const UNITS: &'static str = "pieces of 30 frames";

    fn groups(&self) -> Vec<u32> {
        vec![self.settings().frames(PIECE) / PIECE; self.settings().subjects as usize]
    }

    fn files(&self, dir: &Path, subject: u32, piece: u32) -> Vec<PathBuf> {
        frames_of(piece).rev().map(|frame| file_of(dir, subject, frame)).collect()
    }

    fn begun_in(&self, dir: &Path) -> Vec<(u32, u32)> {
        let pieces = self.settings().frames(PIECE) / PIECE;
        let of_subject = |subject: u32| {
            let frames = names_in(&dir.join(name(subject))).filter_map(|name| leading_number(&name));
            let last = frames.filter(|frame| frame % PIECE == 0 && (1..=pieces).contains(&(frame / PIECE)));
            last.map(move |frame| (subject, frame / PIECE - 1)).collect::<Vec<_>>()
        };
        (0..self.settings().subjects).flat_map(of_subject).collect()
    }

    fn name(&self, subject: u32, piece: u32) -> String {
        let frames = frames_of(piece);
        format!("frames {} to {} of {}", frames.start(), frames.end(), name(subject))
    }

    fn others(&self) -> Vec<PathBuf> {
        [LANDMARKS_NAME, DISTURBANCES_NAME, EVENTS_NAME].map(PathBuf::from).to_vec()
    }
}

impl Plan for Videos {
    type Layout = Self;
    type Group = Video;
    type Worker = Renderer;

    const LONGEST_RUN: u32 = 8;

    fn layout(&self) -> &Self {
        self
    }

    fn manifest(&self) -> String {
        json_text(&self.arguments)
    }

    fn folders(&self, dir: &Path, run: &Run) -> Vec<PathBuf> {
        vec![dir.join(name(run.group))]
    }

    fn makes(&self, run: &Run, _folder: &Path, name: &str) -> bool {
        let frame: Option<u32> = name.split('.').next().and_then(|digits| digits.parse().ok());
        let piece = frame.and_then(|frame| frame.checked_sub(1)).map(|frame| frame / PIECE);
        piece.is_some_and(|piece| run.units.contains(&piece))
    }

    fn delete(&self, dir: &Path, found: &str) -> Result<(), RenderError> {
        // If the settings cannot be read, the set's files are unknown: they are overwritten instead.
        let Ok(other) = serde_json::from_str::<LongSettings>(found) else { return Ok(()) };
        other.check()?;
        // The tables first: without them the set does not count as complete.
        self.others().iter().try_for_each(|file| remove(&dir.join(file)))?;
        (0..other.subjects).try_for_each(|subject| remove(&dir.join(name(subject))))
    }

    fn group(&self, subject: u32) -> Result<Video, RenderError> {
        self.video(subject)
    }

    fn worker(&self) -> Renderer {
        Renderer::default()
    }

    fn make(
        &self,
        work: &Work<'_>,
        video: &Video,
        run: &Run,
        renderer: &mut Renderer,
    ) -> Result<(), RenderError> {
        work.each(run.units.clone(), |piece| {
            frames_of(piece).try_for_each(|frame| {
                renderer.render(video, self.settings(), frame)?;
                let path = file_of(work.dir, run.group, frame);
                work.write(Stage::Frames, &path, |path| write_image_png(path, &renderer.frame.image))
            })
        })
    }
}

/// The buffers of one worker, reused for every frame.
#[derive(Default)]
pub(crate) struct Renderer {
    rasterizer: Rasterizer,
    head: PosedHead,
    gaussians: Gaussians,
    frame: Frame,
}

impl Renderer {
    fn render(&mut self, video: &Video, settings: &LongSettings, frame: u32) -> Result<(), RenderError> {
        let refused = |error: RasterizeError| RenderError::Rasterize {
            frame: format!("{} {frame}", video.name),
            error,
        };
        video.gaussians(frame, &mut self.head, &mut self.gaussians)?;
        let options = Options { background: BACKDROP, outputs: Outputs::IMAGE, ..Options::default() };
        self.rasterizer
            .render(&self.gaussians, &video.camera, None, &options, &mut self.frame)
            .map_err(refused)?;
        let seconds = (frame - 1) as f32 / settings.fps;
        video.light.record(&mut self.frame.image, seconds, settings.noise, video.key.frame(frame));
        Ok(())
    }
}
