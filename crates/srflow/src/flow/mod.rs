//! Flow between frames: pairs, folders of frames, videos.

mod extra;
pub(crate) mod frames;
mod outputs;
mod report;

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Instant;

use anyhow::{Context as _, anyhow, ensure};
use serde::{Deserialize, Serialize};
use serde_json::json;
use srflow_core::{
    FlowEstimate, FlowEstimator, FlowField, FlowSequence, SettingError, Shard, Size, flow_colors, in_stages,
};
use srflow_face::{FrameCrop, write_landmarks};
use srflow_files::{FlowFormat, create_folder, read_flow, write_flow, write_image_png, write_npy_plane};
use srflow_report::heat;

use self::extra::ExtraOutput;
use self::frames::{Frame, Source};
use self::outputs::Outputs;
use crate::clap::Args;
use crate::convert::ensure_positive;
use crate::error::wrong_settings;
use crate::face::{FaceArgs, FoundFace};
use crate::methods;
use crate::networks::CPU;
use crate::rendering::{Rendered, ShardArgs};
use crate::video::{VideoWriter, is_video};
use crate::watch::Count;
use crate::{Error, Job, Watch, WhenStopped};

pub use self::report::{EstimatedPair, FlowReport, NetworkUsed, SequenceReport, Sequences};
pub use crate::methods::{Method, MethodParameters, MethodSpec};

/// A method that estimates flow in memory, with the weights that its parameters name. Published weights are
/// downloaded if they are not cached, which `watch` follows.
///
/// # Errors
/// [`ErrorKind::Setting`](crate::ErrorKind::Setting) when a parameter is out of range or does not apply to
/// the method; otherwise when weights cannot be loaded.
pub fn estimator(
    method: &MethodSpec,
    parameters: &MethodParameters,
    watch: &Watch,
) -> Result<Box<dyn FlowEstimator>, Error> {
    Ok(methods::estimator(method, parameters, watch)?)
}

/// Estimate optical flow between frames
#[derive(Args, Debug, Clone, PartialEq, Serialize, Deserialize)]
#[command(after_help = "\
Examples:
  srflow flow frame1.png frame2.png -o flow.flo --viz flow.png
  srflow flow --method farneback video/ -o flows/ --format flo5 --viz colours/
  srflow flow --method skflow --weights skflow-things.ckpt clip.mp4 -o flows/ --viz colours.mp4 --viz-max 20
  srflow flow --method raft --weights raft.pth --tile auto 4k1.png 4k2.png -o flow.flo
  srflow flow --face detect clip.mp4 -o flows/ --save-crops faces/
  srflow flow clips/*.mp4 -o flows/ --shard auto

Two frames give one file, in the format of its extension. More frames, a folder of them (in the order of their numbers), or \
a video give a folder with the flow from each frame to the next, named after the first frame (in a video after its number, \
from 1). Several videos or folders of frames give one folder each, named after it, and --shard divides them among processes \
or machines. Run the same command again to continue an interrupted run. Frames are read on demand: memory does not grow with \
the length of a sequence. The program ffmpeg reads and writes videos. With --face detect the flow is that of the face, \
upright, with the same crop for all frames: docs/guides/faces.md.")]
pub struct FlowJob {
    /// Two frames or more, a folder of them, or a video; or several folders or videos
    #[arg(required = true, value_name = "FRAME")]
    pub frames: Vec<PathBuf>,
    /// Flow file, or folder of flow files
    #[arg(short, long, value_name = "OUT")]
    pub out: PathBuf,
    /// How to estimate the flow
    #[arg(long, value_name = "METHOD", default_value_t, help = Method::help())]
    #[serde(default)]
    pub method: MethodSpec,
    /// Format of the files in a folder
    #[arg(long, value_name = "FORMAT", default_value_t = flo())]
    #[serde(default = "flo")]
    pub format: FlowFormat,
    /// Also draw the flow in colours: into a PNG file, a folder of PNG files, or a video
    #[arg(long, value_name = "OUT")]
    #[serde(default)]
    pub viz: Option<PathBuf>,
    /// Also write the expected error of the flow, in pixels
    #[arg(long, value_name = "OUT", help = ExtraOutput::Uncertainty.help())]
    #[serde(default)]
    pub uncertainty: Option<PathBuf>,
    /// Also write the probability that a pixel of the first frame is hidden in the second
    #[arg(long, value_name = "OUT", help = ExtraOutput::Occlusion.help())]
    #[serde(default)]
    pub occlusion: Option<PathBuf>,
    /// Flow length in pixels of full colour, and the uncertainty drawn brightest [default: the largest of
    /// each pair]
    #[arg(long, value_name = "PIXELS", requires = "viz", value_parser = crate::convert::positive)]
    #[serde(default)]
    pub viz_max: Option<f32>,
    /// Start from this flow (for two frames)
    #[arg(long, value_name = "FLOW")]
    #[serde(default)]
    pub initial_flow: Option<PathBuf>,
    /// Start each pair of a sequence from the flow of the previous one, projected forward
    #[arg(long)]
    #[serde(default)]
    pub warm_start: bool,
    /// Pairs of a sequence to estimate at once with a network
    #[arg(long, value_name = "N", default_value_t = one(), value_parser = clap::value_parser!(u16).range(1..=MOST_AT_ONCE))]
    #[serde(default = "one")]
    pub batch: u16,
    /// Overwrite existing files
    #[arg(long)]
    #[serde(default)]
    pub force: bool,
    /// With --face, --face-box or --landmarks: also write the cropped frames as PNG files; the flow is that
    /// of these frames
    #[arg(long, value_name = "DIR")]
    #[serde(default)]
    pub save_crops: Option<PathBuf>,
    #[command(flatten)]
    #[serde(flatten)]
    pub shard: ShardArgs,
    #[command(flatten)]
    #[serde(flatten)]
    pub face: FaceArgs,
    #[command(flatten)]
    #[serde(flatten)]
    pub parameters: MethodParameters,
}

/// Most pairs estimated at once.
const MOST_AT_ONCE: i64 = 1024;

fn one() -> u16 {
    1
}

fn flo() -> FlowFormat {
    FlowFormat::Flo
}

impl FlowJob {
    /// The flow between `frames` by the built-in network, into the file or folder `out`.
    pub fn new(frames: impl IntoIterator<Item: Into<PathBuf>>, out: impl Into<PathBuf>) -> Self {
        Self {
            frames: frames.into_iter().map(Into::into).collect(),
            out: out.into(),
            method: MethodSpec::default(),
            format: flo(),
            viz: None,
            uncertainty: None,
            occlusion: None,
            viz_max: None,
            initial_flow: None,
            warm_start: false,
            batch: one(),
            force: false,
            save_crops: None,
            shard: ShardArgs::default(),
            face: FaceArgs::default(),
            parameters: MethodParameters::default(),
        }
    }

    /// Path of an extra output.
    fn extra(&self, output: ExtraOutput) -> Option<&Path> {
        match output {
            ExtraOutput::Uncertainty => self.uncertainty.as_deref(),
            ExtraOutput::Occlusion => self.occlusion.as_deref(),
        }
    }

    /// The job for one of several sequences: its outputs are folders named `name`.
    fn for_sequence(&self, name: &str, path: &Path) -> Self {
        let within = |folder: &Option<PathBuf>| folder.as_ref().map(|folder| folder.join(name));
        Self {
            frames: vec![path.to_owned()],
            out: self.out.join(name),
            viz: within(&self.viz),
            uncertainty: within(&self.uncertainty),
            occlusion: within(&self.occlusion),
            save_crops: within(&self.save_crops),
            ..self.clone()
        }
    }
}

impl Job for FlowJob {
    const NAME: &'static str = "flow";
    const WHEN_STOPPED: WhenStopped = WhenStopped::UnitsKept;

    type Report = FlowReport;

    fn work(&self, watch: &Watch) -> anyhow::Result<FlowReport> {
        ensure_positive("viz_max", self.viz_max)?;
        if !(1..=MOST_AT_ONCE).contains(&self.batch.into()) {
            let expected = format!("1 to {MOST_AT_ONCE} pairs");
            return Err(SettingError { field: "batch", found: self.batch.to_string(), expected }.into());
        }
        let mut job = self.clone();
        job.parameters.network.batch = self.batch.into();
        let shard = self.shard.taken()?;
        let is_sequence = |path: &PathBuf| path.is_dir() || is_video(path);
        if self.frames.len() < 2 || !self.frames.iter().all(is_sequence) {
            if shard.shard != Shard::WHOLE {
                wrong_settings!("`shard` divides several videos or folders of frames: give two or more");
            }
            return Ok(FlowReport::Sequence(Box::new(estimate(&job, watch)?)));
        }
        if let Some(video) = self.viz.as_deref().filter(|viz| is_video(viz)) {
            wrong_settings!(
                "{}: several sequences give a folder of pictures each, not one video",
                video.display()
            );
        }
        let named = named(&self.frames)?;
        let part = shard.shard.range(named.len() as u64);
        let mut sequences = BTreeMap::new();
        for (name, path) in &named[part.start as usize..part.end as usize] {
            let sequence = estimate(&job.for_sequence(name, path), watch)?;
            let stopped = sequence.stopped;
            sequences.insert(name.clone(), sequence);
            if stopped {
                break;
            }
        }
        Ok(FlowReport::Sequences(Rendered { report: Sequences { sequences }, shard }))
    }
}

/// The sequences by the names of their folders of flow.
fn named(paths: &[PathBuf]) -> anyhow::Result<Vec<(String, &Path)>> {
    let mut names = BTreeSet::new();
    let mut sequences = Vec::new();
    for path in paths {
        let name = if path.is_dir() { path.file_name() } else { path.file_stem() };
        let name = name.map(|name| name.to_string_lossy().into_owned());
        match name.filter(|name| names.insert(name.clone())) {
            Some(name) => sequences.push((name, path.as_path())),
            None => wrong_settings!(
                "{}: the flow of each video or folder goes into a folder of its name: expected a name of its own",
                path.display()
            ),
        }
    }
    Ok(sequences)
}

/// The flow of one sequence, or pair.
fn estimate(job: &FlowJob, watch: &Watch) -> anyhow::Result<SequenceReport> {
    let network = &job.parameters.network;
    if job.parameters.start.is_some() && (job.warm_start || job.initial_flow.is_some()) {
        wrong_settings!(
            "`start` does not go together with `warm_start` or `initial_flow`: leave one of them out"
        );
    }
    if job.warm_start && network.batch > 1 {
        wrong_settings!(
            "`warm_start` needs the flow of the previous pair, so `batch` must be 1: leave one of them out"
        );
    }
    let source = Source::open(&job.frames)?;
    let mut outputs = Outputs::plan(job, &source)?;
    let method = job.method.method;
    for output in ExtraOutput::ALL {
        let is_predicted = method.network().is_some_and(|network| output.is_predicted_by(network));
        if job.extra(output).is_some() && !is_predicted {
            wrong_settings!("{}", output.missing(method.name()));
        }
    }
    let estimator = methods::estimator(&job.method, &job.parameters, watch)?;
    if estimator.remembers() && network.batch > 1 {
        wrong_settings!("{} waits for the pair before, so that `batch` is 1: leave it out", estimator.name());
    }
    let found = match job.face.is_whole() {
        true => None,
        false => Some(
            job.face.of_sequence(|take| source.read(0, 1, |frame| take(frame.map(|frame| frame.image))))?,
        ),
    };
    if job.save_crops.is_some() && found.is_none() {
        wrong_settings!(
            "`save_crops` writes cropped frames: give `face` detect, `face_box` or `landmarks` too"
        );
    }
    let crop = found.as_ref().map_or(FrameCrop::Whole, |found| found.crop.clone());
    let one_by_one = job.warm_start || estimator.remembers();
    let resumed = outputs.claim(&identity(job, &crop, watch)?, &source, one_by_one)?;
    if let Some(folder) = &job.save_crops {
        create_folder(folder)?;
    }
    let landmarks = match &found {
        Some(FoundFace { points: Some(points), .. }) if job.face.detects() => {
            let file = outputs.landmarks();
            write_landmarks(&file, &[], job.force, [(Vec::new(), points)])?;
            Some(file)
        }
        _ => None,
    };
    let initial = job.initial_flow.as_deref().map(read_flow).transpose()?;

    let flows = watch.count("flows", source.pairs());
    flows.set(resumed);
    let work = Work {
        job,
        source: &source,
        outputs: &outputs,
        estimator: estimator.as_ref(),
        counts_iterations: method.network().is_some_and(|architecture| network.is_auto(architecture)),
        flows: &flows,
        watch: *watch,
        stopped: AtomicBool::new(false),
    };
    let pairs = work.run(resumed, &crop, initial.as_ref())?;
    let stopped = work.stopped.into_inner();
    if !stopped {
        outputs.finish()?;
    }
    let size = pairs.first().map(|pair| Size::new(pair.width, pair.height));
    let resolution = size
        .map(|size| job.parameters.large_frames.resolution(size, job.method.method, network))
        .transpose()?;
    Ok(SequenceReport {
        method: estimator.name().to_owned(),
        network: match job.method.method {
            Method::Network(architecture) => Some(NetworkUsed {
                weights: job.method.weights.clone().or_else(|| network.weights.clone()),
                iterations: network.iterations(architecture),
                still_px: network.still_px(architecture),
                settings: network.settings(architecture)?,
                levels: match &resolution {
                    Some(input) => network.init(architecture)?.levels([input.tile_height, input.tile_width]),
                    None => None,
                },
                device: network.device.clone(),
                precision: network.precision()?.name(),
                batch: network.batch,
                warm_start: job.warm_start,
            }),
            _ => None,
        },
        landmarks,
        resolution,
        resumed,
        pairs,
        stopped,
    })
}

/// Everything that the files depend on, as JSON: runs with the same identity write the same files.
fn identity(job: &FlowJob, crop: &FrameCrop, watch: &Watch) -> anyhow::Result<String> {
    let records = methods::records(std::slice::from_ref(&job.method), &job.parameters, watch)?;
    let frames: Vec<PathBuf> = job.frames.iter().map(std::path::absolute).collect::<Result<_, _>>()?;
    let text = |path: &PathBuf| path.display().to_string();
    let identity = json!({
        "version": 2,
        "method": records[0].identity,
        "frames": frames.iter().map(text).collect::<Vec<_>>(),
        "format": job.format,
        "viz": job.viz.as_ref().map(text),
        "viz_max": job.viz_max,
        "uncertainty": job.uncertainty.as_ref().map(text),
        "occlusion": job.occlusion.as_ref().map(text),
        "warm_start": job.warm_start,
        "crop": crop,
    });
    Ok(identity.to_string() + "\n")
}

/// The face in a frame, also written into `folder`.
fn cropped(frame: Frame, crop: &FrameCrop, folder: Option<&Path>) -> anyhow::Result<Frame> {
    if matches!(crop, FrameCrop::Whole) {
        return Ok(frame);
    }
    let image = crop.apply(&frame.image).with_context(|| frame.label.clone())?;
    if let Some(folder) = folder {
        write_image_png(&folder.join(format!("{}.png", frame.stem)), &image)?;
    }
    Ok(Frame { image, ..frame })
}

/// Batches of frames that wait to be estimated, and of flows that wait to be written: a frame takes about as
/// long to decode as its flow to encode, and both less than the estimation.
const AHEAD: usize = 1;

/// Pairs that are estimated one after another while as many others are: much of a method waits for a single thread.
const PAIRS_BESIDE_OTHERS: usize = 4;
/// Pixels of the largest frames that are estimated beside others, which takes the memory of two.
const PIXELS_BESIDE_OTHERS: usize = 1 << 20;

/// From frames to files.
struct Work<'a> {
    job: &'a FlowJob,
    source: &'a Source,
    outputs: &'a Outputs,
    estimator: &'a dyn FlowEstimator,
    /// Whether pairs may differ in their iterations.
    counts_iterations: bool,
    flows: &'a Count<'a>,
    watch: Watch<'a>,
    /// Whether the watch stopped the work before the last pair.
    stopped: AtomicBool,
}

/// An estimated pair, to be written.
struct Pair {
    /// The frames.
    labels: [String; 2],
    /// Of the first frame.
    stem: String,
    estimate: FlowEstimate,
    /// Time of estimation.
    seconds: f64,
}

impl Work<'_> {
    /// Estimates the pairs of a sequence, except the first `resumed`, `batch` at a time; or one pair,
    /// starting from an initial flow. Frames are decoded and flows encoded at the same time.
    fn run(
        &self,
        resumed: u64,
        crop: &FrameCrop,
        initial: Option<&FlowField>,
    ) -> anyhow::Result<Vec<EstimatedPair>> {
        let mut sequence = self.estimator.sequence(self.job.warm_start);
        let (mut last, mut last_frame) = (None, None);
        let estimate = |frames: Vec<Frame>| match (initial, frames.first()) {
            (Some(initial), _) => self.pair_from(frames, initial),
            (None, Some(first)) if self.runs_beside_others(first) => self.next_two(&mut last_frame, frames),
            (None, _) => self.next(sequence.as_mut(), &mut last, frames),
        };
        let (mut video, mut reports) = (None, Vec::new());
        in_stages(
            AHEAD,
            |give| self.read(resumed, crop, give),
            estimate,
            |pairs| {
                for pair in pairs {
                    reports.push(self.write(pair, &mut video)?);
                }
                Ok(())
            },
        )?;
        // An incomplete video is removed.
        if let Some(video) = video.filter(|_| !self.stopped.load(Ordering::Relaxed)) {
            video.finish()?;
        }
        Ok(reports)
    }

    /// Whether the pairs of these frames are independent of each other, and small enough for two at once.
    fn runs_beside_others(&self, frame: &Frame) -> bool {
        let independent =
            !self.job.warm_start && !self.estimator.remembers() && self.job.initial_flow.is_none();
        independent
            && frame.image.size().pixels() <= PIXELS_BESIDE_OTHERS
            && self.job.parameters.network.device == CPU
            && rayon::current_num_threads() > 1
    }

    /// Pairs of frames of this size that are given to the estimation at once.
    fn pairs_together(&self, frame: &Frame) -> usize {
        let batch = self.job.parameters.network.batch;
        if self.runs_beside_others(frame) { 2 * batch.max(PAIRS_BESIDE_OTHERS) } else { batch }
    }

    /// The frames, except the first `skip`, [`pairs_together`](Self::pairs_together).
    fn read(&self, skip: u64, crop: &FrameCrop, give: &mut dyn FnMut(anyhow::Result<Vec<Frame>>) -> bool) {
        // The first pair takes a frame more.
        let (mut frames, mut first, mut more) = (Vec::new(), 1, true);
        self.source.read(skip, 1, |frame| {
            if self.watch.stops() {
                self.stopped.store(true, Ordering::Relaxed);
                frames.clear();
                more = false;
                return more;
            }
            match frame.and_then(|frame| cropped(frame, crop, self.job.save_crops.as_deref())) {
                Ok(frame) => {
                    let wanted = self.pairs_together(&frame) + first;
                    frames.push(frame);
                    if frames.len() == wanted {
                        more = give(Ok(std::mem::take(&mut frames)));
                        first = 0;
                    }
                }
                Err(error) => {
                    let before = std::mem::take(&mut frames);
                    // The pairs before it are estimated.
                    if before.len() > first {
                        give(Ok(before));
                    }
                    give(Err(error));
                    more = false;
                }
            }
            more
        });
        if more && !frames.is_empty() {
            give(Ok(frames));
        }
    }

    /// Two frames, starting from an initial flow.
    fn pair_from(&self, frames: Vec<Frame>, initial: &FlowField) -> anyhow::Result<Vec<Pair>> {
        let [first, second] = <[Frame; 2]>::try_from(frames)
            .map_err(|frames| anyhow!("expected two frames to start from a flow, found {}", frames.len()))?;
        let (size, found) = (first.image.size(), initial.size());
        ensure!(
            found == size,
            "`initial_flow` is {found}, the frames are {size} (WIDTHxHEIGHT): give a flow of the frames' size"
        );
        let start = Instant::now();
        let estimate = self
            .estimator
            .estimate_from(&first.image, &second.image, initial)
            .with_context(|| format!("{} and {}", first.label, second.label))?;
        let seconds = start.elapsed().as_secs_f64();
        Ok(vec![Pair { labels: [first.label, second.label], stem: first.stem, estimate, seconds }])
    }

    /// The pairs that end at `frames`. `last` has the names of the frame before them, and then of the last.
    fn next(
        &self,
        sequence: &mut (dyn FlowSequence + '_),
        last: &mut Option<[String; 2]>,
        frames: Vec<Frame>,
    ) -> anyhow::Result<Vec<Pair>> {
        let (mut names, mut images) = (Vec::from_iter(last.take()), Vec::with_capacity(frames.len()));
        for Frame { label, stem, image } in frames {
            names.push([label, stem]);
            images.push(image);
        }
        let start = Instant::now();
        let estimates = sequence.push(&images).with_context(|| self.labels(&names))?;
        let seconds = start.elapsed().as_secs_f64() / estimates.len().max(1) as f64;
        let pairs = names.windows(2).zip(estimates).map(|(pair, estimate)| {
            let [[first, stem], [second, _]] = [&pair[0], &pair[1]];
            Pair { labels: [first.clone(), second.clone()], stem: stem.clone(), estimate, seconds }
        });
        let pairs = pairs.collect();
        *last = names.pop();
        Ok(pairs)
    }

    /// The pairs that end at `frames`, in two halves at the same time. `last` is the frame before them, and then the last.
    fn next_two(&self, last: &mut Option<Frame>, frames: Vec<Frame>) -> anyhow::Result<Vec<Pair>> {
        let frames: Vec<Frame> = last.take().into_iter().chain(frames).collect();
        let start = Instant::now();
        let middle = (frames.len() - 1).div_ceil(2);
        let half = |frames: &[Frame]| -> anyhow::Result<Vec<Pair>> {
            let mut sequence = self.estimator.sequence(false);
            let (mut pairs, mut last) = (Vec::new(), None);
            let batch = self.job.parameters.network.batch;
            let (first, others) = frames.split_at(1);
            if others.is_empty() {
                return Ok(pairs);
            }
            for frames in std::iter::once(first).chain(others.chunks(batch)) {
                pairs.extend(self.next(sequence.as_mut(), &mut last, frames.to_vec())?);
            }
            Ok(pairs)
        };
        let (before, after) = rayon::join(|| half(&frames[..=middle]), || half(&frames[middle..]));
        let mut pairs = before?;
        pairs.extend(after?);
        let seconds = start.elapsed().as_secs_f64() / pairs.len().max(1) as f64;
        pairs.iter_mut().for_each(|pair| pair.seconds = seconds);
        *last = frames.into_iter().next_back();
        Ok(pairs)
    }

    fn labels(&self, names: &[[String; 2]]) -> String {
        match names {
            [[first, _], .., [last, _]] => format!("{first} to {last}"),
            [[one, _]] => one.clone(),
            [] => String::new(),
        }
    }

    fn write(&self, pair: Pair, video: &mut Option<VideoWriter>) -> anyhow::Result<EstimatedPair> {
        let Pair { labels: [frame1, frame2], stem, estimate, seconds } = pair;
        self.outputs.check_pair(&stem)?;
        let files = self.outputs.pair(&stem);
        let flow = &estimate.flow;
        write_flow(&files.flow, flow)?;
        for (output, plane_files) in &files.extra {
            let plane = output.of(&estimate).with_context(|| output.missing(self.estimator.name()))?;
            write_npy_plane(&plane_files.npy, plane)?;
            if let Some(png) = &plane_files.png {
                write_image_png(png, &heat(plane, output.brightest(plane, self.job.viz_max)))?;
            }
        }
        let colours = || flow_colors(flow, self.job.viz_max);
        if let Some(viz) = &files.viz {
            write_image_png(viz, &colours())?;
        }
        if let Some(path) = self.outputs.video() {
            let video = match video {
                Some(video) => video,
                None => video.insert(VideoWriter::create(path, flow.size(), self.source.rate())?),
            };
            video.write(&colours())?;
        }
        self.flows.inc();
        Ok(EstimatedPair {
            frame1,
            frame2,
            flow: files.flow,
            viz: files.viz,
            extra: files.extra.into_iter().map(|(output, files)| (output.name(), files.npy)).collect(),
            width: flow.width(),
            height: flow.height(),
            seconds,
            iterations: estimate.iterations.filter(|_| self.counts_iterations),
        })
    }
}

#[cfg(test)]
mod tests {
    use serde_json::Value;

    use super::*;
    use crate::ErrorKind;
    use crate::settings::from_json;

    fn of_json(method: &str, parameters: &Value) -> Result<Box<dyn FlowEstimator>, Error> {
        let method = method.parse().map_err(|error| anyhow!(crate::error::WrongSettings(error)))?;
        let parameters: MethodParameters = from_json(parameters.as_object().unwrap())?;
        estimator(&method, &parameters, &Watch::SILENT)
    }

    #[test]
    fn estimators_have_the_settings_of_the_job() {
        let none = json!({});
        assert_eq!(of_json(&MethodSpec::default().to_string(), &none).unwrap().name(), "srflow");
        let tvl1 = of_json("tvl1", &json!({ "warps": 2, "refine": true }));
        assert_eq!(tvl1.unwrap().name(), "tvl1");
        for (method, parameters, message) in [
            ("pwc", none.clone(), "unknown method `pwc`; the methods are farneback, tvl1, srflow"),
            ("tvl1", json!({ "wraps": 2 }), "unknown setting `wraps`; the settings are "),
            ("tvl1", json!({ "warps": "x", "tau": 0.1 }), "`warps`: invalid type: string \"x\""),
            ("tvl1", json!({ "iters": 0 }), "`iters`: "),
            ("tvl1", json!({ "iters": 2 }), "`iters` is for networks"),
            ("tvl1", json!({ "scale": 0 }), "scale 0: expected a factor from 1/64 to 64"),
            ("raft", none, "raft needs weights"),
        ] {
            let error = of_json(method, &parameters).err().unwrap();
            assert_eq!(error.kind(), ErrorKind::Setting, "{error}");
            assert!(error.to_string().starts_with(message), "{error}");
        }
    }

    #[test]
    fn a_job_is_its_settings_as_json() {
        let job = FlowJob { batch: 4, viz_max: Some(20.0), ..FlowJob::new(["a.png", "b.png"], "ab.flo") };
        let written = serde_json::to_value(&job).unwrap();
        assert_eq!((&written["method"], &written["format"]), (&json!("srflow"), &json!("flo")));
        assert_eq!(from_json::<FlowJob>(written.as_object().unwrap()).unwrap(), job);
        let given = json!({ "frames": ["a.png", "b.png"], "out": "ab.flo", "batch": 4, "viz_max": 20 });
        assert_eq!(from_json::<FlowJob>(given.as_object().unwrap()).unwrap(), job);
    }
}
