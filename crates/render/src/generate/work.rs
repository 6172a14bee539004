//! The work itself: workers take runs of consecutive pairs, and make each pair from its frames to its files.
//!
//! A worker goes through its run backwards. So it has the next frame's Gaussians and depth at hand when it renders a
//! frame with its flow and tells what the next frame hides, and every frame is posed and rendered once; only the frame
//! after a run's last pair is rendered for its depth alone.

use std::io::Write;
use std::path::Path;
use std::sync::atomic::{AtomicBool, AtomicU64, AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, PoisonError};

use srflow_avatar::PosedHead;
use srflow_field::{FileError, write_atomically, write_flow_as, write_image_png, write_mask_png};
use srflow_splat::{Frame, Gaussians, Next, Options, Outputs, Rasterizer};

use super::background::{self, Background};
use super::error::GenerateError;
use super::folder::Run;
use super::occlusion::{occlusion, surface_into};
use super::pictures::{write_alpha, write_depth};
use super::rig::Rig;
use super::scene::{FrameState, Scene};
use super::settings::Settings;
use super::timing::{Clock, Stage};
use super::{Event, MAX_WORKERS};
use crate::record::PairRecord;
use crate::statistics::FlowSummary;
use srflow_read::manifest::{FrameFiles, Manifest, PairFiles};

/// Everything that workers share.
pub(super) struct Work<'a> {
    pub settings: &'a Settings,
    pub manifest: &'a Manifest,
    pub rig: &'a Rig,
    pub dir: &'a Path,
    pub runs: &'a [Run],
    /// Pairs of this part in all, and those that were there before.
    pub total: u64,
    pub before: u64,
    pub clock: &'a Clock,
    pub on_event: &'a (dyn Fn(Event) + Sync),
    pub current_scene: Mutex<Option<(u32, Arc<Scene>)>>,
    pub next_run: AtomicUsize,
    pub written: AtomicU64,
    pub bytes: AtomicU64,
    pub stopped: AtomicBool,
}

impl Work<'_> {
    /// Makes all runs on the threads of the current rayon pool.
    ///
    /// # Errors
    /// The first that any worker meets; the others stop after the pair that they are at.
    pub fn make(&self) -> Result<(), GenerateError> {
        let threads = rayon::current_num_threads();
        let workers = threads.min(MAX_WORKERS).min(self.runs.len()).max(1);
        let pools = (0..workers).map(|worker| {
            // Threads that do not come out even go to the first workers.
            let threads = threads / workers + usize::from(worker < threads % workers);
            rayon::ThreadPoolBuilder::new()
                .num_threads(threads)
                .build()
                .map_err(|error| GenerateError::Threads { threads, reason: error.to_string() })
        });
        let pools: Vec<rayon::ThreadPool> = pools.collect::<Result<_, _>>()?;
        let first_error = Mutex::new(None);
        std::thread::scope(|scope| {
            for pool in &pools {
                scope.spawn(|| {
                    if let Err(error) = pool.install(|| self.work()) {
                        self.stopped.store(true, Ordering::Relaxed);
                        lock(&first_error).get_or_insert(error);
                    }
                });
            }
        });
        first_error.into_inner().unwrap_or_else(PoisonError::into_inner).map_or(Ok(()), Err)
    }

    fn work(&self) -> Result<(), GenerateError> {
        let mut worker = Worker::new(self.settings);
        while let Some(run) = self.runs.get(self.next_run.fetch_add(1, Ordering::Relaxed)) {
            let scene = self.scene(run.scene)?;
            worker.make_run(self, &scene, run)?;
        }
        Ok(())
    }

    /// The scene, which the workers that are at it share. Runs are taken in order: at most one scene is begun at a time.
    fn scene(&self, number: u32) -> Result<Arc<Scene>, GenerateError> {
        let mut current = lock(&self.current_scene);
        if let Some((at, scene)) = &*current
            && *at == number
        {
            return Ok(Arc::clone(scene));
        }
        *current = None; // frees the scene before, unless a worker is still at it
        let entry = &self.manifest.scenes[number as usize];
        let scene = self.clock.time(Stage::Heads, || Scene::new(self.settings, self.rig, number, entry))?;
        let scene = Arc::new(scene);
        *current = Some((number, Arc::clone(&scene)));
        Ok(scene)
    }

    fn write_failed(&self, error: FileError) -> GenerateError {
        let written = self.before + self.written.load(Ordering::Relaxed);
        GenerateError::Write { error, written, total: self.total }
    }

    /// Writes a file on the account of `stage`.
    fn write(
        &self,
        stage: Stage,
        path: &Path,
        write: impl FnOnce(&Path) -> Result<(), FileError>,
    ) -> Result<(), GenerateError> {
        self.clock.time(stage, || write(path)).map_err(|error| self.write_failed(error))?;
        let size = std::fs::metadata(path).map_or(0, |metadata| metadata.len());
        self.bytes.fetch_add(size, Ordering::Relaxed);
        Ok(())
    }
}

fn lock<T>(mutex: &Mutex<T>) -> std::sync::MutexGuard<'_, T> {
    // A worker that panicked takes the whole run down; what it held is not looked at again.
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

/// The buffers of one worker, used again for every frame: about 0.3 GB at 2200x3208.
struct Worker {
    rasterizer: Rasterizer,
    options: Options,
    head: PosedHead,
    gaussians: Gaussians,
    next_gaussians: Gaussians,
    frame: Frame,
    backward: Frame,
    /// Depth of the next frame where its alpha is above one half, else 0.
    next_surface: Vec<f32>,
    bytes: Vec<u8>,
}

impl Worker {
    fn new(settings: &Settings) -> Self {
        let background = match settings.background {
            Background::Colour(colour) => colour.map(|channel| f32::from(channel) / 255.0),
            Background::Images(_) => [0.0; 3],
        };
        Self {
            rasterizer: Rasterizer::new(),
            options: Options { background, ..Options::default() },
            head: PosedHead::default(),
            gaussians: Gaussians::default(),
            next_gaussians: Gaussians::default(),
            frame: Frame::new(),
            backward: Frame::new(),
            next_surface: Vec::new(),
            bytes: Vec::new(),
        }
    }

    fn make_run(&mut self, work: &Work<'_>, scene: &Scene, run: &Run) -> Result<(), GenerateError> {
        let end = run.pairs.end;
        let mut next = self.pose(work, scene, end);
        let is_last = end == scene.pairs();
        let outputs = Outputs { image: is_last, alpha: true, depth: true, ..NOTHING };
        self.render(work, run.scene, end, &next, None, outputs)?;
        if is_last {
            self.write_frame(work, scene, run.scene, end)?;
        }
        for pair in run.pairs.clone().rev() {
            if work.stopped.load(Ordering::Relaxed) {
                break;
            }
            surface_into(&self.frame, &mut self.next_surface);
            std::mem::swap(&mut self.gaussians, &mut self.next_gaussians);
            let state = self.pose(work, scene, pair);
            let outputs = Outputs { color: false, ..Outputs::ALL };
            self.render(work, run.scene, pair, &state, Some(&next), outputs)?;
            self.write_pair(work, scene, run.scene, pair, &state, &next)?;
            work.written.fetch_add(1, Ordering::Relaxed);
            (work.on_event)(Event::PairWritten { bytes: work.bytes.load(Ordering::Relaxed) });
            next = state;
        }
        Ok(())
    }

    /// Poses the head as in `frame`, into `self.gaussians`.
    fn pose(&mut self, work: &Work<'_>, scene: &Scene, frame: u32) -> FrameState {
        work.clock.time(Stage::Motion, || {
            let state = scene.frame(frame);
            scene.avatar.gaussians_into(&state.pose, &mut self.head, &mut self.gaussians);
            state
        })
    }

    /// Renders `self.gaussians` into `self.frame`, with the flow to `self.next_gaussians`.
    fn render(
        &mut self,
        work: &Work<'_>,
        scene: u32,
        frame: u32,
        state: &FrameState,
        next: Option<&FrameState>,
        outputs: Outputs,
    ) -> Result<(), GenerateError> {
        let options = Options { outputs, ..self.options };
        let next = next.map(|next| Next { gaussians: &self.next_gaussians, camera: &next.camera });
        work.clock
            .time(Stage::Rasterize, || {
                self.rasterizer.render(&self.gaussians, &state.camera, next, &options, &mut self.frame)
            })
            .map_err(|error| refused(work, scene, frame, error))
    }

    fn write_pair(
        &mut self,
        work: &Work<'_>,
        scene: &Scene,
        number: u32,
        pair: u32,
        state: &FrameState,
        next: &FrameState,
    ) -> Result<(), GenerateError> {
        let entry = &work.manifest.scenes[number as usize];
        let PairFiles { flow, flow_backward, occlusion: hidden_path, record, .. } =
            work.manifest.files(work.dir, entry, pair);
        self.write_frame(work, scene, number, pair)?;
        let format = work.settings.flow_format;
        work.write(Stage::Flow, &flow, |path| write_flow_as(path, &self.frame.flow, format))?;
        let (hidden, summary) = work.clock.time(Stage::Occlusion, || {
            let hidden = occlusion(&self.frame, &self.next_surface);
            let summary = FlowSummary::of(&self.frame.flow, &self.frame.mask(), &hidden);
            (hidden, summary)
        });
        work.write(Stage::Planes, &hidden_path, |path| write_mask_png(path, &hidden))?;
        if let Some(path) = flow_backward {
            self.render_backward(work, number, pair, state, next)?;
            work.write(Stage::Flow, &path, |path| write_flow_as(path, &self.backward.flow, format))?;
        }
        let known = PairRecord {
            frame1: scene.record(pair, state),
            frame2: scene.record(pair + 1, next),
            flow: summary,
        };
        // The record tells that the pair is whole, so it comes last.
        work.write(Stage::Records, &record, |path| {
            write_atomically(path, |writer| {
                serde_json::to_writer(&mut *writer, &known)?;
                writer.write_all(b"\n")
            })
        })
    }

    fn render_backward(
        &mut self,
        work: &Work<'_>,
        scene: u32,
        pair: u32,
        state: &FrameState,
        next: &FrameState,
    ) -> Result<(), GenerateError> {
        let options = Options { outputs: Outputs { flow: true, ..NOTHING }, ..self.options };
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
            .map_err(|error| refused(work, scene, pair + 1, error))
    }

    /// Writes what `self.frame` alone holds: picture, alpha, mask and depth.
    fn write_frame(
        &mut self,
        work: &Work<'_>,
        scene: &Scene,
        number: u32,
        frame: u32,
    ) -> Result<(), GenerateError> {
        let entry = &work.manifest.scenes[number as usize];
        let files: FrameFiles = work.manifest.frame_files(work.dir, entry, frame);
        let mask = work.clock.time(Stage::Occlusion, || {
            if let Some(behind) = &scene.background {
                background::composite(&mut self.frame.image, &self.frame.alpha, behind);
            }
            self.frame.mask()
        });
        work.write(Stage::Frames, &files.frame, |path| write_image_png(path, &self.frame.image))?;
        work.write(Stage::Planes, &files.alpha, |path| {
            write_alpha(path, &self.frame.alpha, &mut self.bytes)
        })?;
        work.write(Stage::Planes, &files.mask, |path| write_mask_png(path, &mask))?;
        if let Some(path) = &files.depth {
            work.write(Stage::Planes, path, |path| write_depth(path, &self.frame, &mut self.bytes))?;
        }
        Ok(())
    }
}

const NOTHING: Outputs =
    Outputs { image: false, color: false, alpha: false, depth: false, flow: false, depth_next: false };

fn refused(work: &Work<'_>, scene: u32, frame: u32, error: srflow_splat::RasterizeError) -> GenerateError {
    GenerateError::Rasterize { scene: work.manifest.scenes[scene as usize].name.clone(), frame, error }
}
