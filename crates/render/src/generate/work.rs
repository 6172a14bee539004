//! Rendering pairs, from motion to files.
//!
//! A worker goes through its run backwards. The next frame's Gaussians and depth are then already available for a frame's
//! flow and occlusion, and every frame is posed and rendered once; only the frame after a run's last pair is rendered for its
//! depth alone.

use std::collections::BTreeMap;
use std::fs;
use std::ops::Range;
use std::path::{Path, PathBuf};

use srflow_avatar::{Avatars, PosedHead};
use srflow_core::longest_flow;
use srflow_files::{write_file, write_flow_as, write_image_png, write_mask_png};
use srflow_splat::{DeviceRasterizer, Frame, Gaussians, Next, Options, Outputs, RasterizeError};

use super::background::{self, Background};
use super::occlusion::{occlusion, surface_into};
use super::pictures::{write_alpha, write_depth, write_regions, write_shading_change};
use super::rig::Rig;
use super::scene::{self, FrameState, Scene};
use super::settings::Settings;
use crate::RenderError;
use crate::flow_parts::{FlowParts, Seen};
use crate::job::{Clock, Layout, Plan, Run, Stage, leading_number, names_in, remove};
use crate::parts::PartWeights;
use crate::record::{PairRecord, json_text};
use crate::recording::Exposure;
use crate::statistics::FlowSummary;
use srflow_data::flow::Sample;
use srflow_data::manifest::{
    FrameFiles, MANIFEST_NAME, Manifest, PairFiles, STATISTICS_NAME, SceneEntry, SceneSplit,
};

type Work<'w, 'a> = crate::job::Work<'w, Scenes<'a>>;

/// A dataset whose units are frame pairs, in scenes.
pub(super) struct Scenes<'a> {
    pub settings: &'a Settings,
    pub avatars: &'a Avatars,
    pub manifest: Manifest,
    pub rig: Rig,
}

impl Scenes<'_> {
    fn scene(&self, number: u32) -> &SceneEntry {
        &self.manifest.scenes[number as usize]
    }
}

impl Layout for Manifest {
    const MANIFEST: &'static str = MANIFEST_NAME;
    const UNITS: &'static str = "pairs";

    fn groups(&self) -> Vec<u32> {
        self.scenes.iter().map(|scene| scene.pairs).collect()
    }

    /// A frame is written with the pair that starts at it, a scene's last frame with the last pair.
    fn files(&self, dir: &Path, group: u32, pair: u32) -> Vec<PathBuf> {
        let scene = &self.scenes[group as usize];
        let files = self.files(dir, scene, pair);
        let frames = if pair + 1 == scene.pairs { pair..pair + 2 } else { pair..pair + 1 };
        let of_frames =
            frames.flat_map(|frame| self.frame_files(dir, scene, frame).all().cloned().collect::<Vec<_>>());
        files.of_pair().cloned().chain(of_frames).collect()
    }

    fn begun_in(&self, dir: &Path) -> Vec<(u32, u32)> {
        let groups: BTreeMap<&str, u32> =
            (0..).zip(&self.scenes).map(|(group, scene)| (scene.name.as_str(), group)).collect();
        let mut begun = Vec::new();
        for split in SceneSplit::ALL {
            let records = dir.join(split.to_string()).join("pairs");
            for name in names_in(&records) {
                let Some(&group) = name.to_str().and_then(|name| groups.get(name)) else { continue };
                let scene = &self.scenes[group as usize];
                let pairs = names_in(&records.join(&name)).filter_map(|name| leading_number(&name));
                begun.extend(
                    pairs
                        .filter(|pair| scene.split == split && *pair < scene.pairs)
                        .map(|pair| (group, pair)),
                );
            }
        }
        begun
    }

    fn name(&self, group: u32, pair: u32) -> String {
        format!("pair {pair} of {}", self.scenes[group as usize].name)
    }

    fn others(&self) -> Vec<PathBuf> {
        vec![STATISTICS_NAME.into()]
    }
}

impl<'a> Plan for Scenes<'a> {
    type Layout = Manifest;
    type Group = Scene;
    type Worker = Worker;

    /// One frame per run is rendered twice.
    const LONGEST_RUN: u32 = 24;

    fn layout(&self) -> &Manifest {
        &self.manifest
    }

    fn manifest(&self) -> String {
        json_text(&self.manifest)
    }

    fn folders(&self, dir: &Path, run: &Run) -> Vec<PathBuf> {
        let scene = self.scene(run.group);
        self.manifest.kinds().map(|kind| scene_folder(dir, scene, kind)).collect()
    }

    fn makes(&self, run: &Run, _folder: &Path, name: &str) -> bool {
        let last = self.scene(run.group).pairs - 1;
        let frame: Option<u32> = name.split('.').next().and_then(|digits| digits.parse().ok());
        frame.is_some_and(|frame| run.units.contains(&frame.min(last)))
    }

    fn delete(&self, dir: &Path, _found: &str) -> Result<(), RenderError> {
        let manifest = Manifest::read(dir)?;
        for scene in &manifest.scenes {
            for kind in manifest.kinds() {
                remove(&scene_folder(dir, scene, kind))?;
            }
        }
        for split in SceneSplit::ALL {
            let split = dir.join(split.to_string());
            for folder in manifest.kinds().map(|kind| split.join(kind)).chain([split.clone()]) {
                let _ = fs::remove_dir(&folder); // fails, and stays, if it contains other files
            }
        }
        for name in [STATISTICS_NAME, MANIFEST_NAME] {
            remove(&dir.join(name))?;
        }
        Ok(())
    }

    fn group(&self, number: u32) -> Result<Scene, RenderError> {
        let entry = self.scene(number);
        let avatar = scene::subject(self.avatars, &self.settings.dressed_head(), entry)?;
        Scene::new(self.settings, &self.rig, number, entry, avatar)
    }

    fn worker(&self) -> Worker {
        Worker::new(self.settings)
    }

    fn make(
        &self,
        work: &Work<'_, 'a>,
        scene: &Scene,
        run: &Run,
        worker: &mut Worker,
    ) -> Result<(), RenderError> {
        worker.make_run(work, scene, run)
    }
}

fn scene_folder(dir: &Path, scene: &SceneEntry, kind: &str) -> PathBuf {
    dir.join(scene.split.to_string()).join(kind).join(&scene.name)
}

/// The buffers of one worker, reused for every frame: about 0.3 GB at 2200x3208.
#[derive(Default)]
pub(super) struct Worker {
    rasterizer: DeviceRasterizer,
    options: Options,
    head: PosedHead,
    gaussians: Gaussians,
    next_gaussians: Gaussians,
    frame: Frame,
    backward: Frame,
    /// The Gaussians and the picture at a moment of an open shutter, and the sum of such pictures.
    moving: Gaussians,
    moment: Frame,
    exposure: Exposure,
    /// Depth of the next frame where its alpha is above one half, else 0.
    next_surface: Vec<f32>,
    /// Empty without region maps; with them, another 0.2 GB.
    parts: PartWeights,
    flow_parts: FlowParts,
    bytes: Vec<u8>,
}

impl Worker {
    pub fn new(settings: &Settings) -> Self {
        let background = match settings.background {
            Background::Colour(colour) => colour.map(|channel| f32::from(channel) / 255.0),
            Background::Images(_) | Background::Procedural => [0.0; 3],
        };
        Self {
            rasterizer: DeviceRasterizer::new(&settings.device),
            options: Options { background, ..Options::default() },
            ..Self::default()
        }
    }

    fn make_run(&mut self, work: &Work, scene: &Scene, run: &Run) -> Result<(), RenderError> {
        let end = run.units.end;
        let is_last = end == scene.entry.pairs;
        let mut next = self.last_frame(&work.clock, scene, end, is_last)?;
        if is_last {
            self.write_frame(work, scene, end, &next)?;
        }
        work.each(run.units.clone().rev(), |pair| {
            let state = self.frame_before(&work.clock, scene, pair, &next)?;
            self.write_pair(work, scene, pair, &state, &next)?;
            next = state;
            Ok(())
        })
    }

    /// Renders consecutive pairs of a scene: the samples that are read back from the files of [`Worker::make_run`].
    pub fn samples(&mut self, scene: &Scene, pairs: Range<u32>) -> Result<Vec<Sample>, RenderError> {
        let clock = Clock::default();
        let mut next = self.last_frame(&clock, scene, pairs.end, true)?;
        let mut samples = Vec::with_capacity(pairs.len());
        let mut frame2 = self.frame.image.clone();
        for pair in pairs.rev() {
            next = self.frame_before(&clock, scene, pair, &next)?;
            let frame1 = self.frame.image.clone();
            samples.push(Sample {
                frame2: std::mem::replace(&mut frame2, frame1.clone()),
                frame1,
                flow: Some(self.frame.flow.clone()),
                mask: Some(self.frame.mask()),
                occlusion: Some(occlusion(&self.frame, &self.next_surface)),
            });
        }
        samples.reverse();
        Ok(samples)
    }

    /// Renders the frame that ends a run, for its depth, and with its picture if it is `pictured`.
    fn last_frame(
        &mut self,
        clock: &Clock,
        scene: &Scene,
        frame: u32,
        pictured: bool,
    ) -> Result<FrameState, RenderError> {
        // Nothing follows a scene's last frame: its blur is that of the motion from the frame before.
        let step = if frame == scene.entry.pairs { -1 } else { 1 };
        let other = (pictured && scene.blurs_motion()).then(|| {
            let other = self.pose(clock, scene, frame.saturating_add_signed(step));
            std::mem::swap(&mut self.gaussians, &mut self.next_gaussians);
            other
        });
        let state = self.pose(clock, scene, frame);
        let outputs =
            Outputs { image: pictured, alpha: true, depth: true, flow: other.is_some(), ..Outputs::NONE };
        self.render(clock, scene, frame, &state, other.as_ref(), outputs)?;
        if pictured {
            self.take_picture(clock, scene, frame, step as f32)?;
        }
        Ok(state)
    }

    /// Renders the frame before the one rendered last, whose state is `next`, with its picture and its flow.
    fn frame_before(
        &mut self,
        clock: &Clock,
        scene: &Scene,
        frame: u32,
        next: &FrameState,
    ) -> Result<FrameState, RenderError> {
        surface_into(&self.frame, &mut self.next_surface);
        std::mem::swap(&mut self.gaussians, &mut self.next_gaussians);
        let state = self.pose(clock, scene, frame);
        let outputs = Outputs { color: false, ..Outputs::ALL };
        self.render(clock, scene, frame, &state, Some(next), outputs)?;
        self.take_picture(clock, scene, frame, 1.0)?;
        Ok(state)
    }

    /// Poses the head as in `frame`, into `self.gaussians`.
    fn pose(&mut self, clock: &Clock, scene: &Scene, frame: u32) -> FrameState {
        clock.time(Stage::Motion, || {
            let state = scene.frame(frame);
            scene.avatar.gaussians_into(&state.pose, &mut self.head, &mut self.gaussians);
            if let Some(lamps) = &scene.lamps {
                lamps.shade(&scene.avatar, &self.head, &mut self.gaussians);
            }
            state
        })
    }

    /// Renders `self.gaussians` into `self.frame`, with the flow to `self.next_gaussians`.
    fn render(
        &mut self,
        clock: &Clock,
        scene: &Scene,
        frame: u32,
        state: &FrameState,
        next: Option<&FrameState>,
        outputs: Outputs,
    ) -> Result<(), RenderError> {
        let options = Options { outputs, ..self.options };
        let next = next.map(|next| Next { gaussians: &self.next_gaussians, camera: &next.camera });
        clock
            .time(Stage::Rasterize, || {
                self.rasterizer.render(&self.gaussians, &state.camera, next, &options, &mut self.frame)
            })
            .map_err(|error| refused(scene, frame, error))?;
        Ok(())
    }

    fn write_pair(
        &mut self,
        work: &Work,
        scene: &Scene,
        pair: u32,
        state: &FrameState,
        next: &FrameState,
    ) -> Result<(), RenderError> {
        let files = work.plan.manifest.files(work.dir, &scene.entry, pair);
        let PairFiles { flow, flow_backward, shading_change, occlusion: hidden_path, record, .. } = &files;
        if let Some(path) = shading_change {
            self.write_shading_change(work, scene, pair, state, path)?;
        }
        self.write_frame(work, scene, pair, state)?;
        let format = work.plan.settings.flow_format;
        work.write(Stage::Flow, flow, |path| write_flow_as(path, &self.frame.flow, format))?;
        let (hidden, summary) = work.clock.time(Stage::Occlusion, || {
            let hidden = occlusion(&self.frame, &self.next_surface);
            let summary = FlowSummary::of(&self.frame.flow, &self.frame.mask(), &hidden);
            (hidden, summary)
        });
        work.write(Stage::Planes, hidden_path, |path| write_mask_png(path, &hidden))?;
        if let Some(path) = flow_backward {
            self.render_backward(work, scene, pair, state, next)?;
            work.write(Stage::Flow, path, |path| write_flow_as(path, &self.backward.flow, format))?;
        }
        self.write_parts(work, scene, pair, &files, [state, next])?;
        let known = PairRecord {
            frame1: scene.record(pair, state),
            frame2: scene.record(pair + 1, next),
            flow: summary,
        };
        // The record marks the pair as complete, so it comes last.
        let known = serde_json::to_string(&known).expect("numbers, text, lists and maps by text") + "\n";
        work.write(Stage::Records, record, |path| write_file(path, &known))
    }

    /// Writes how the colours change from a frame to the next, at the places of the first.
    fn write_shading_change(
        &mut self,
        work: &Work,
        scene: &Scene,
        pair: u32,
        state: &FrameState,
        path: &Path,
    ) -> Result<(), RenderError> {
        self.moving.clone_from(&self.gaussians);
        let coefficients = self.moving.sh.iter_mut().zip(&self.next_gaussians.sh);
        for (value, next) in coefficients.flat_map(|(here, next)| here.iter_mut().zip(next)) {
            *value = 0.5 * (next - *value);
        }
        let options = Options {
            background: [0.5; 3],
            outputs: Outputs { color: true, ..Outputs::NONE },
            ..self.options
        };
        let Self { rasterizer, moving, backward, bytes, .. } = self;
        work.clock
            .time(Stage::Rasterize, || rasterizer.render(moving, &state.camera, None, &options, backward))
            .map_err(|error| refused(scene, pair, error))?;
        work.write(Stage::Planes, path, |path| write_shading_change(path, backward, bytes))
    }

    /// Writes the flow of the head and that of the expression, if the dataset has them.
    fn write_parts(
        &mut self,
        work: &Work,
        scene: &Scene,
        pair: u32,
        files: &PairFiles,
        states: [&FrameState; 2],
    ) -> Result<(), RenderError> {
        let (Some(head_path), Some(expression_path)) = (&files.head_flow, &files.expression_flow) else {
            return Ok(());
        };
        let seen = states.map(|state| Seen { pose: &state.pose, camera: &state.camera });
        let Self { flow_parts, rasterizer, gaussians, frame, .. } = self;
        let (head, expression) = work
            .clock
            .time(Stage::Rasterize, || flow_parts.of(&frame.flow, rasterizer, &scene.avatar, gaussians, seen))
            .map_err(|error| refused(scene, pair, error))?;
        let format = work.plan.settings.flow_format;
        work.write(Stage::Flow, head_path, |path| write_flow_as(path, head, format))?;
        work.write(Stage::Flow, expression_path, |path| write_flow_as(path, &expression, format))
    }

    fn render_backward(
        &mut self,
        work: &Work,
        scene: &Scene,
        pair: u32,
        state: &FrameState,
        next: &FrameState,
    ) -> Result<(), RenderError> {
        let options = Options { outputs: Outputs { flow: true, ..Outputs::NONE }, ..self.options };
        let back = Next { gaussians: &self.gaussians, camera: &state.camera };
        work.clock
            .time(Stage::Rasterize, || {
                self.rasterizer.render(
                    &self.next_gaussians,
                    &next.camera,
                    Some(back),
                    &options,
                    &mut self.backward,
                )
            })
            .map_err(|error| refused(scene, pair + 1, error))?;
        Ok(())
    }

    /// Replaces the picture of `self.frame` by the mean of those while the shutter is open, each with its background. Gaussians
    /// move in straight lines to or from those in `self.next_gaussians`, the frame `step` frames later: the trace of a point is its
    /// flow times the share of the time that the shutter is open, and its middle is the point.
    fn open_shutter(
        &mut self,
        clock: &Clock,
        scene: &Scene,
        frame: u32,
        step: f32,
        moments: &[f32],
    ) -> Result<(), RenderError> {
        let outputs = Outputs { alpha: scene.background.is_some(), ..Outputs::IMAGE };
        let options = Options { outputs, ..self.options };
        self.moving.clone_from(&self.gaussians);
        for moment in moments {
            clock.time(Stage::Motion, || {
                let ways = self.gaussians.positions.iter().zip(&self.next_gaussians.positions);
                for (place, (here, there)) in self.moving.positions.iter_mut().zip(ways) {
                    *place = *here + (*there - *here) * (moment * step);
                }
            });
            let camera = scene.camera(f64::from(frame) + f64::from(*moment));
            clock
                .time(Stage::Rasterize, || {
                    self.rasterizer.render(&self.moving, &camera, None, &options, &mut self.moment)
                })
                .map_err(|error| refused(scene, frame, error))?;
            clock.time(Stage::Occlusion, || {
                background::composite(&mut self.moment, scene.background.as_ref());
                self.exposure.add(&self.moment.image);
            });
        }
        self.exposure.develop(&mut self.frame.image);
        Ok(())
    }

    /// Turns the picture of `self.frame`, rendered over black or a colour, into the one that the scene's camera records. The
    /// Gaussians in `self.next_gaussians` are those of the frame `step` frames later, where the shutter is open for some time.
    fn take_picture(
        &mut self,
        clock: &Clock,
        scene: &Scene,
        frame: u32,
        step: f32,
    ) -> Result<(), RenderError> {
        clock.time(Stage::Occlusion, || background::composite(&mut self.frame, scene.background.as_ref()));
        if scene.blurs_motion() {
            let moments = scene.moments(longest_flow(&self.frame.flow));
            if !moments.is_empty() {
                self.open_shutter(clock, scene, frame, step, &moments)?;
            }
        }
        clock.time(Stage::Frames, || scene.record_picture(&mut self.frame.image, frame));
        Ok(())
    }

    /// Writes the files that depend on one frame alone: picture, alpha, mask, depth and region map.
    fn write_frame(
        &mut self,
        work: &Work,
        scene: &Scene,
        frame: u32,
        state: &FrameState,
    ) -> Result<(), RenderError> {
        let files: FrameFiles = work.plan.manifest.frame_files(work.dir, &scene.entry, frame);
        let mask = work.clock.time(Stage::Occlusion, || self.frame.mask());
        work.write(Stage::Frames, &files.frame, |path| write_image_png(path, &self.frame.image))?;
        work.write(Stage::Planes, &files.alpha, |path| {
            write_alpha(path, &self.frame.alpha, &mut self.bytes)
        })?;
        work.write(Stage::Planes, &files.mask, |path| write_mask_png(path, &mask))?;
        if let Some(path) = &files.depth {
            work.write(Stage::Planes, path, |path| write_depth(path, &self.frame, &mut self.bytes))?;
        }
        if let Some(path) = &files.regions {
            let Self { parts, rasterizer, gaussians, .. } = self;
            work.clock
                .time(Stage::Rasterize, || parts.render(rasterizer, &scene.avatar, gaussians, &state.camera))
                .map_err(|error| refused(scene, frame, error))?;
            work.write(Stage::Planes, path, |path| {
                write_regions(path, &self.parts, &self.frame.alpha, &mut self.bytes)
            })?;
        }
        Ok(())
    }
}

fn refused(scene: &Scene, frame: u32, error: RasterizeError) -> RenderError {
    RenderError::Rasterize { frame: format!("{}, frame {frame}", scene.entry.name), error }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_pair_with_a_missing_file_is_missing() {
        let folder = tempfile::tempdir().unwrap();
        let dir = folder.path();
        let settings = Settings {
            scenes: 1,
            frames: 3.0,
            size: srflow_core::Size { width: 110, height: 160 },
            splits: srflow_core::Numbers([1.0, 0.0, 0.0]),
            regions: true,
            ..Settings::default()
        };
        let (avatars, manifest) = (Avatars::keeping(1), settings.plan().unwrap());
        let plan = Scenes { settings: &settings, avatars: &avatars, rig: settings.rig(), manifest };
        let left = || -> Vec<u32> { (0..3).filter(|&pair| !plan.layout().is_whole(dir, 0, pair)).collect() };
        assert_eq!(left(), [0, 1, 2]);
        for folder in plan.folders(dir, &Run { group: 0, units: 0..3 }) {
            fs::create_dir_all(folder).unwrap();
        }
        let (manifest, scene) = (&plan.manifest, plan.scene(0));
        for pair in 0..3 {
            let of_frames = [pair, pair + 1].map(|frame| manifest.frame_files(dir, scene, frame));
            let files = manifest.files(dir, scene, pair);
            for file in files.all().chain(of_frames.iter().flat_map(FrameFiles::all)) {
                fs::write(file, "x").unwrap();
            }
        }
        assert!(left().is_empty());
        fs::remove_file(manifest.frame_files(dir, scene, 3).alpha).unwrap();
        assert_eq!(left(), [2]);
        fs::remove_file(manifest.files(dir, scene, 0).occlusion).unwrap();
        assert_eq!(left(), [0, 2]);
        fs::remove_file(manifest.files(dir, scene, 1).regions.unwrap()).unwrap();
        assert_eq!(left(), [0, 1, 2]);
    }
}
