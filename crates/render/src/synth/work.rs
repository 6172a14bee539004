//! The work itself: workers take clips one by one, render their frames and write them.

use std::collections::BTreeMap;
use std::io::Write;
use std::path::Path;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use srflow_avatar::{Avatar, PosedHead};
use srflow_field::{create_folder, write_atomically, write_flow_as, write_image_png};
use srflow_splat::{Frame, Gaussians, Next, Options, Outputs, RasterizeError, Rasterizer};

use super::clip::Clip;
use super::error::SynthError;
use super::settings::{ClipPlan, SynthSettings};
use super::{ClipRecord, SynthEvent};

/// The most clips in the making at once.
const MAX_WORKERS: usize = 16;

/// What is behind the heads: the grey of a laboratory's backdrop.
const BACKDROP: [f32; 3] = [0.55, 0.56, 0.57];

/// Makes clips on the threads of the current rayon pool, each worker with its share of them.
///
/// # Errors
/// The first that any worker meets; the others stop after the clip that they are at.
pub fn make(
    settings: &SynthSettings,
    dir: &Path,
    clips: &[&ClipPlan],
    on_event: &(dyn Fn(SynthEvent) + Sync),
) -> Result<(), SynthError> {
    let threads = rayon::current_num_threads();
    let workers = threads.min(MAX_WORKERS).min(clips.len()).max(1);
    let pools = (0..workers).map(|worker| {
        let threads = threads / workers + usize::from(worker < threads % workers);
        rayon::ThreadPoolBuilder::new()
            .num_threads(threads)
            .build()
            .map_err(|error| SynthError::Threads { threads, reason: error.to_string() })
    });
    let pools: Vec<rayon::ThreadPool> = pools.collect::<Result<_, _>>()?;
    let work = Work {
        settings,
        dir,
        clips,
        on_event,
        next: AtomicUsize::new(0),
        stopped: AtomicBool::new(false),
        current: Mutex::new(None),
    };
    let first_error = Mutex::new(None);
    std::thread::scope(|scope| {
        for pool in &pools {
            scope.spawn(|| {
                if let Err(error) = pool.install(|| work.run()) {
                    work.stopped.store(true, Ordering::Relaxed);
                    lock(&first_error).get_or_insert(error);
                }
            });
        }
    });
    first_error.into_inner().unwrap_or_else(PoisonError::into_inner).map_or(Ok(()), Err)
}

fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    // A worker that panicked takes the whole run down; what it held is not looked at again.
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Everything that workers share.
struct Work<'a> {
    settings: &'a SynthSettings,
    dir: &'a Path,
    clips: &'a [&'a ClipPlan],
    on_event: &'a (dyn Fn(SynthEvent) + Sync),
    next: AtomicUsize,
    stopped: AtomicBool,
    /// The subject whose clips are being made. Clips come by subject, so that each head is mostly made once.
    current: Mutex<Option<(u32, Arc<Avatar>)>>,
}

impl Work<'_> {
    fn run(&self) -> Result<(), SynthError> {
        let mut renderer = Renderer::new();
        while let Some(plan) = self.clips.get(self.next.fetch_add(1, Ordering::Relaxed)) {
            if self.stopped.load(Ordering::Relaxed) {
                break;
            }
            let avatar = self.avatar(plan)?;
            let frames = renderer.make(self, &avatar, plan)?;
            (self.on_event)(SynthEvent::ClipWritten { frames });
        }
        Ok(())
    }

    fn avatar(&self, plan: &ClipPlan) -> Result<Arc<Avatar>, SynthError> {
        let mut current = lock(&self.current);
        if let Some((subject, avatar)) = &*current
            && *subject == plan.subject
        {
            return Ok(Arc::clone(avatar));
        }
        *current = None; // frees the subject before, unless a worker is still at it
        let avatar = Avatar::builtin(self.settings.head_of(plan.subject))
            .map_err(|error| SynthError::Head { subject: plan.subject_name.clone(), error })?;
        let avatar = Arc::new(avatar);
        *current = Some((plan.subject, Arc::clone(&avatar)));
        Ok(avatar)
    }
}

/// The buffers of one worker, used again for every frame.
struct Renderer {
    rasterizer: Rasterizer,
    head: PosedHead,
    gaussians: Gaussians,
    apex: Gaussians,
    frame: Frame,
}

impl Renderer {
    fn new() -> Self {
        Self {
            rasterizer: Rasterizer::new(),
            head: PosedHead::default(),
            gaussians: Gaussians::default(),
            apex: Gaussians::default(),
            frame: Frame::new(),
        }
    }

    /// Renders a clip, its flow and its record; gives its number of frames.
    fn make(&mut self, work: &Work, avatar: &Avatar, plan: &ClipPlan) -> Result<usize, SynthError> {
        let settings = work.settings;
        let clip = Clip::new(avatar, settings, plan)?;
        let refused = |error: RasterizeError| SynthError::Rasterize { clip: plan.name.clone(), error };
        let folder = plan.folder(work.dir);
        create_folder(&folder)?;

        let image_alone =
            Outputs { image: true, color: false, alpha: false, depth: false, flow: false, depth_next: false };
        let mut options = Options { background: BACKDROP, outputs: image_alone, ..Options::default() };
        for number in 0..clip.len() {
            clip.gaussians(avatar, number, &mut self.head, &mut self.gaussians)?;
            self.rasterizer
                .render(&self.gaussians, &clip.camera, None, &options, &mut self.frame)
                .map_err(refused)?;
            let seconds = number as f32 / settings.frames_per_second;
            clip.light.record(&mut self.frame.image, seconds, settings.noise, clip.key.frame(number as u32));
            write_image_png(&folder.join(format!("{number:04}.png")), &self.frame.image)?;
        }

        let expression = &clip.expression;
        clip.gaussians(avatar, expression.apex, &mut self.head, &mut self.apex)?;
        clip.gaussians(avatar, expression.onset, &mut self.head, &mut self.gaussians)?;
        options.outputs = Outputs { image: false, alpha: true, flow: true, ..image_alone };
        let next = Next { gaussians: &self.apex, camera: &clip.camera };
        self.rasterizer
            .render(&self.gaussians, &clip.camera, Some(next), &options, &mut self.frame)
            .map_err(refused)?;
        let format = settings.flow_format()?;
        write_flow_as(&plan.flow(work.dir, format), &self.frame.flow, format)?;

        let action_units: BTreeMap<String, f32> = clip.action_units().collect();
        let record = ClipRecord {
            subject: plan.subject_name.clone(),
            class: plan.class.name().to_owned(),
            action_units,
            coded_units: clip.coded_units(),
            onset: expression.onset as u64,
            apex: expression.apex as u64,
            offset: expression.offset as u64,
            frames: clip.len(),
            mean_flow: self.mean_flow(),
            landmarks: clip.landmarks(avatar, &self.head),
        };
        // The record tells that the clip is whole, so it comes last.
        write_atomically(&plan.record(work.dir), |writer| {
            serde_json::to_writer_pretty(&mut *writer, &record)?;
            writer.write_all(b"\n")
        })?;
        Ok(clip.len())
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
