//! Rendering clips: their frames, flow, mask and record.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};
use srflow_avatar::{Avatar, HeadSource, PosedHead};
use srflow_data::micro_expression::PLAIN_NAME;
use srflow_files::{write_file, write_flow_as, write_image_png, write_mask_png};
use srflow_head::MicroExpression;
use srflow_splat::{DeviceRasterizer, Frame, Gaussians, Next, Options, Outputs, RasterizeError};

use super::clip::{Clip, Disturbance};
use super::portrait::BACKDROP;
use super::settings::{ClipPlan, Motion, SynthSettings};
use crate::flow_parts::{FlowParts, Seen};
use crate::job::{Layout, Plan, Run, Stage, leading_number, names_in, remove};
use crate::record::json_text;
use crate::{RenderError, head};

/// Name of the file with the arguments.
const SETTINGS_NAME: &str = "synth.json";

/// Name of the file of landmarks.
pub const LANDMARKS_NAME: &str = "landmarks.csv";

/// Name of the file with what else the frames of a dataset show than expressions.
pub const DISTURBANCES_NAME: &str = "disturbances.csv";

type Work<'w> = crate::job::Work<'w, Clips>;

/// The contents of `synth.json`.
#[derive(Debug, Serialize, Deserialize)]
struct Arguments {
    srflow_version: String,
    #[serde(flatten)]
    settings: SynthSettings,
}

/// The contents of `s03/c05.json`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ClipRecord {
    pub subject: String,
    pub class: String,
    /// Action units at the apex and their intensities, 0 to 1.
    pub action_units: BTreeMap<String, f32>,
    pub coded_units: String,
    pub onset: u64,
    pub apex: u64,
    pub offset: u64,
    /// Frames that were written.
    pub frames: usize,
    /// Mean length of the true flow from onset to apex on the head, in pixels.
    pub mean_flow: f64,
    /// The 68 landmarks of dlib in the onset frame, in pixels.
    pub landmarks: Vec<[f64; 2]>,
    /// Blinks and glances.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub disturbances: Vec<Disturbance>,
}

/// A dataset of clips, grouped by subject.
pub(crate) struct Clips {
    arguments: Arguments,
    head: Vec<HeadSource>,
    pub(super) clips: Vec<ClipPlan>,
}

impl Clips {
    pub fn new(settings: SynthSettings) -> Result<Self, RenderError> {
        let clips = settings.plan()?;
        let recorded = head::recorded_in_turn(&settings.head)?;
        let head = head::with_look(&settings.head, settings.look);
        let settings = SynthSettings { head: recorded, ..settings };
        let arguments = Arguments { srflow_version: env!("CARGO_PKG_VERSION").to_owned(), settings };
        Ok(Self { arguments, head, clips })
    }

    /// Of the dataset in a folder.
    pub fn read(dir: &Path) -> Result<Self, RenderError> {
        let arguments: Arguments = head::read_settings(&dir.join(SETTINGS_NAME))?;
        let settings = &arguments.settings;
        let head = head::with_look(&settings.head, settings.look);
        Ok(Self { clips: settings.plan()?, head, arguments })
    }

    pub(super) fn settings(&self) -> &SynthSettings {
        &self.arguments.settings
    }

    fn clip(&self, subject: u32, within: u32) -> &ClipPlan {
        &self.clips[(subject * self.settings().clips + within) as usize]
    }
}

impl Layout for Clips {
    const MANIFEST: &'static str = SETTINGS_NAME;
    const UNITS: &'static str = "clips";

    fn groups(&self) -> Vec<u32> {
        vec![self.settings().clips; self.settings().subjects as usize]
    }

    /// The frames are those that exist: they are written before the record, which knows how many they are.
    fn files(&self, dir: &Path, subject: u32, within: u32) -> Vec<PathBuf> {
        let clip = self.clip(subject, within);
        let folder = clip.folder(dir);
        let mut frames: Vec<PathBuf> = names_in(&folder)
            .filter(|name| leading_number(name).is_some())
            .map(|name| folder.join(name))
            .collect();
        frames.sort();
        let format = self.settings().flow_format;
        let flows = clip.flows(dir, format);
        [clip.record(dir), clip.mask(dir)].into_iter().chain(flows).chain(frames).collect()
    }

    fn begun_in(&self, dir: &Path) -> Vec<(u32, u32)> {
        let per_subject = self.settings().clips;
        let numbers: BTreeMap<&str, u32> =
            self.clips.iter().map(|clip| (clip.name.as_str(), clip.number)).collect();
        let mut begun = Vec::new();
        for subject in names_in(dir) {
            for record in names_in(&dir.join(&subject)) {
                let name = Path::new(&subject).join(Path::new(&record).with_extension(""));
                let is_record = Path::new(&record).extension().is_some_and(|extension| extension == "json");
                if let Some(number) = name.to_str().filter(|_| is_record).and_then(|name| numbers.get(name)) {
                    begun.push((number / per_subject, number % per_subject));
                }
            }
        }
        begun
    }

    fn name(&self, subject: u32, within: u32) -> String {
        format!("clip {}", self.clip(subject, within).name)
    }

    fn others(&self) -> Vec<PathBuf> {
        let disturbances = self.settings().has_disturbances().then_some(DISTURBANCES_NAME);
        disturbances.into_iter().chain([LANDMARKS_NAME, PLAIN_NAME]).map(PathBuf::from).collect()
    }
}

impl Plan for Clips {
    type Layout = Self;
    type Group = Avatar;
    type Worker = Renderer;

    const LONGEST_RUN: u32 = 1;

    fn layout(&self) -> &Self {
        self
    }

    fn manifest(&self) -> String {
        json_text(&self.arguments)
    }

    fn folders(&self, dir: &Path, run: &Run) -> Vec<PathBuf> {
        let clips = run.units.clone().map(|within| self.clip(run.group, within));
        let subject = clips.clone().next().map(|clip| dir.join(&clip.subject_name));
        subject.into_iter().chain(clips.map(|clip| clip.folder(dir))).collect()
    }

    fn makes(&self, run: &Run, folder: &Path, name: &str) -> bool {
        // The subject's folder contains the flow and records of other shards' clips too.
        run.units.clone().any(|within| {
            let clip = Path::new(&self.clip(run.group, within).name);
            let stem = clip.file_name().unwrap_or_default().to_string_lossy();
            let of_clip = name.strip_prefix(&*stem).is_some_and(|rest| rest.starts_with(['.', '_']));
            folder.ends_with(clip) || of_clip
        })
    }

    fn delete(&self, dir: &Path, found: &str) -> Result<(), RenderError> {
        // If the settings cannot be read, the dataset's files are unknown: they are overwritten instead.
        let Ok(other) = serde_json::from_str::<SynthSettings>(found) else { return Ok(()) };
        // The tables first: without them the set does not count as complete.
        for table in [DISTURBANCES_NAME, LANDMARKS_NAME, PLAIN_NAME] {
            remove(&dir.join(table))?;
        }
        for clip in other.plan()? {
            // The record first: without it the clip does not count.
            let flows = clip.flows(dir, other.flow_format);
            for file in [clip.record(dir), clip.mask(dir)].iter().chain(&flows) {
                remove(file)?;
            }
            remove(&clip.folder(dir))?;
        }
        Ok(())
    }

    fn group(&self, subject: u32) -> Result<Avatar, RenderError> {
        let who = &self.clip(subject, 0).subject_name;
        head::of_subject(&self.head, self.settings().seed, subject, who)
    }

    fn worker(&self) -> Renderer {
        Renderer::default()
    }

    fn make(
        &self,
        work: &Work<'_>,
        avatar: &Avatar,
        run: &Run,
        renderer: &mut Renderer,
    ) -> Result<(), RenderError> {
        work.each(run.units.clone(), |within| renderer.make(work, avatar, self.clip(run.group, within)))
    }
}

/// The buffers of one worker, reused for every frame.
#[derive(Default)]
pub struct Renderer {
    rasterizer: DeviceRasterizer,
    head: PosedHead,
    gaussians: Gaussians,
    apex: Gaussians,
    frame: Frame,
    parts: FlowParts,
}

impl Renderer {
    /// Renders a clip, its flow whole and in parts, its mask and its record.
    fn make(&mut self, work: &Work, avatar: &Avatar, plan: &ClipPlan) -> Result<(), RenderError> {
        let settings = work.plan.settings();
        let clip = Clip::new(avatar, settings, plan)?;
        let refused = |error: RasterizeError| RenderError::Rasterize { frame: plan.name.clone(), error };
        let folder = plan.folder(work.dir);

        let MicroExpression { onset, apex, offset, .. } = clip.expression;

        let mut options = Options { background: BACKDROP, outputs: Outputs::IMAGE, ..Options::default() };
        let mut frames = 0;
        for number in (0..clip.len()).filter(|&n| !settings.only_key_frames || n == onset || n == apex) {
            avatar.gaussians_into(&clip.pose(avatar, number)?, &mut self.head, &mut self.gaussians);
            self.rasterizer
                .render(&self.gaussians, &clip.camera, None, &options, &mut self.frame)
                .map_err(refused)?;
            let seconds = number as f32 / settings.fps;
            clip.light.record(&mut self.frame.image, seconds, settings.noise, clip.key.frame(number as u32));
            let path = folder.join(format!("{number:04}.png"));
            work.write(Stage::Frames, &path, |path| write_image_png(path, &self.frame.image))?;
            frames += 1;
        }

        let [pose, next] = [clip.pose(avatar, onset)?, clip.pose(avatar, apex)?];
        avatar.gaussians_into(&next, &mut self.head, &mut self.apex);
        avatar.gaussians_into(&pose, &mut self.head, &mut self.gaussians);
        let landmarks = clip.landmarks(avatar, &self.head);
        options.outputs = Outputs { alpha: true, flow: true, ..Outputs::NONE };
        let apex_seen = Next { gaussians: &self.apex, camera: &clip.camera };
        self.rasterizer
            .render(&self.gaussians, &clip.camera, Some(apex_seen), &options, &mut self.frame)
            .map_err(refused)?;
        let seen = [&pose, &next].map(|pose| Seen { pose, camera: &clip.camera });
        let Self { parts, rasterizer, gaussians, frame, .. } = &mut *self;
        let whole = &frame.flow;
        let (head, expression) = parts.of(whole, rasterizer, avatar, gaussians, seen).map_err(refused)?;
        for (motion, flow) in Motion::ALL.into_iter().zip([whole, head, &expression]) {
            let format = settings.flow_format;
            work.write(Stage::Flow, &plan.flow(work.dir, motion, format), |path| {
                write_flow_as(path, flow, format)
            })?;
        }
        let mean_flow = self.mean_flow();

        work.write(Stage::Planes, &plan.mask(work.dir), |path| write_mask_png(path, &self.frame.mask()))?;

        let action_units: BTreeMap<String, f32> = clip.action_units().collect();
        let record = ClipRecord {
            subject: plan.subject_name.clone(),
            class: plan.class.name().to_owned(),
            action_units,
            coded_units: clip.coded_units(),
            onset: onset as u64,
            apex: apex as u64,
            offset: offset as u64,
            frames,
            mean_flow,
            landmarks,
            disturbances: clip.disturbances(),
        };
        // The record marks the clip as complete, so it comes last.
        work.write(Stage::Records, &plan.record(work.dir), |path| write_file(path, json_text(&record)))
    }

    /// Mean length of the flow on the head, in pixels.
    fn mean_flow(&self) -> f64 {
        let pixels = self.frame.flow.pixels().iter().zip(self.frame.alpha.pixels());
        let (mut sum, mut count) = (0.0, 0_u64);
        for ([u, v], _) in pixels.filter(|(_, alpha)| **alpha > 0.5) {
            sum += f64::from(u * u + v * v).sqrt();
            count += 1;
        }
        sum / count.max(1) as f64
    }
}
