mod extra;
mod frames;
mod outputs;

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};
use std::time::Instant;

use anyhow::{Context as _, anyhow, ensure};
use clap::Args;
use indicatif::ProgressBar;
use serde::Serialize;
use srflow_core::{FlowEstimate, FlowEstimator, FlowField, FlowSequence, Shard, flow_colors, in_stages};
use srflow_eval::report::heat;
use srflow_face::{FrameCrop, write_landmarks};
use srflow_files::{FlowFormat, create_folder, read_flow, write_flow, write_image_png, write_npy_plane};

use self::extra::ExtraOutput;
use self::frames::{Frame, Source};
use self::outputs::Outputs;
use crate::Context;
use crate::face::{FaceArgs, FoundFace};
use crate::interrupt::Continuable;
use crate::large_frames::Resolution;
use crate::methods::{self, Method, MethodParameters, MethodSpec};
use crate::progress::bar;
use crate::rendering::{Rendered, ShardArgs};
use crate::usage::wrong_usage;
use crate::video::{VideoWriter, is_video};

/// Estimate optical flow between frames
#[derive(Args)]
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
from 1). Several videos or folders of frames give one folder per input, named after it, and --shard divides them among processes or machines. Run the same command again to continue an interrupted run. Frames are read on demand: memory does not grow with \
the length of a sequence. Videos are read and written by the program ffmpeg. With \
--face detect the flow is that of the face, upright and cut out of all frames alike: docs/faces.md.")]
pub struct Flow {
    /// Two frames or more, a folder of them, or a video; or several folders or videos
    #[arg(required = true, value_name = "FRAME")]
    frames: Vec<PathBuf>,
    /// Flow file, or folder of flow files
    #[arg(short, long, value_name = "OUT")]
    out: PathBuf,
    /// How to estimate the flow
    #[arg(long, value_name = "METHOD", default_value = Method::DEFAULT.name(), help = Method::help())]
    method: MethodSpec,
    /// Format of the files in a folder
    #[arg(long, value_name = "FORMAT", default_value = "flo")]
    format: FlowFormat,
    /// Also draw the flow in colours: into a PNG file, a folder of PNG files, or a video
    #[arg(long, value_name = "OUT")]
    viz: Option<PathBuf>,
    /// Also write the expected error of the flow, in pixels
    #[arg(long, value_name = "OUT", help = ExtraOutput::Uncertainty.help())]
    uncertainty: Option<PathBuf>,
    /// Also write the probability that a pixel of the first frame is hidden in the second
    #[arg(long, value_name = "OUT", help = ExtraOutput::Occlusion.help())]
    occlusion: Option<PathBuf>,
    /// Length in pixels of the flow with full colour, and the uncertainty with the brightest [default: the largest of each pair]
    #[arg(long, value_name = "PIXELS", requires = "viz", value_parser = super::convert::positive)]
    viz_max: Option<f32>,
    /// Start from this flow (for two frames)
    #[arg(long, value_name = "FLOW")]
    initial_flow: Option<PathBuf>,
    /// Start each pair of a sequence from the flow of the previous one, projected forward
    #[arg(long)]
    warm_start: bool,
    /// Pairs of a sequence that a network estimates at once
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = clap::value_parser!(u16).range(1..=1024))]
    batch: u16,
    /// Overwrite existing files
    #[arg(long)]
    force: bool,
    /// With --face, --face-box or --landmarks: also write the cropped frames, which the flow belongs to, as PNG files
    #[arg(long, value_name = "DIR")]
    save_crops: Option<PathBuf>,
    #[command(flatten)]
    shard: ShardArgs,
    #[command(flatten)]
    face: FaceArgs,
    #[command(flatten)]
    parameters: MethodParameters,
}

/// What `--json` prints of several sequences.
#[derive(Serialize)]
struct Sequences {
    sequences: BTreeMap<String, Estimated>,
}

/// What `--json` prints.
#[derive(Serialize)]
struct Estimated {
    method: String,
    #[serde(skip_serializing_if = "Option::is_none")]
    network: Option<NetworkUsed>,
    /// Landmarks of the face that was found.
    #[serde(skip_serializing_if = "Option::is_none")]
    landmarks: Option<PathBuf>,
    /// Size of the network's input, after `--scale` and `--tile`.
    resolution: Option<Resolution>,
    /// Pairs already written by an interrupted run; they are not listed.
    #[serde(skip_serializing_if = "is_zero")]
    resumed: u64,
    pairs: Vec<EstimatedPair>,
}

#[derive(Serialize)]
struct NetworkUsed {
    weights: Option<String>,
    /// At most.
    iterations: usize,
    /// Of `--iters auto`.
    #[serde(skip_serializing_if = "Option::is_none")]
    still_px: Option<f32>,
    #[serde(skip_serializing_if = "BTreeMap::is_empty")]
    settings: BTreeMap<&'static str, usize>,
    /// In which the flow of an input of this size is refined.
    #[serde(skip_serializing_if = "Option::is_none")]
    levels: Option<usize>,
    device: String,
    /// What is multiplied: `auto` says here what it chose.
    precision: &'static str,
    /// What attention may leave out of the weights of a pixel.
    #[serde(skip_serializing_if = "Option::is_none")]
    attention_tolerance: Option<f32>,
    batch: usize,
    warm_start: bool,
}

#[derive(Serialize)]
struct EstimatedPair {
    frame1: String,
    frame2: String,
    flow: PathBuf,
    #[serde(skip_serializing_if = "Option::is_none")]
    viz: Option<PathBuf>,
    #[serde(flatten)]
    extra: BTreeMap<&'static str, PathBuf>,
    width: usize,
    height: usize,
    /// Time of estimation, while other frames are read and written; in a batch, an equal share.
    seconds: f64,
    /// Those that `--iters auto` did; the mean over tiles.
    #[serde(skip_serializing_if = "Option::is_none")]
    iterations: Option<f32>,
}

impl Flow {
    /// Path of an extra output.
    fn extra(&self, output: ExtraOutput) -> Option<&Path> {
        match output {
            ExtraOutput::Uncertainty => self.uncertainty.as_deref(),
            ExtraOutput::Occlusion => self.occlusion.as_deref(),
        }
    }
}

pub fn run(mut args: Flow, context: &Context) -> anyhow::Result<()> {
    args.parameters.network.batch = args.batch.into();
    let shard = args.shard.taken()?;
    let is_sequence = |path: &PathBuf| path.is_dir() || is_video(path);
    if args.frames.len() < 2 || !args.frames.iter().all(is_sequence) {
        if shard.shard != Shard::WHOLE {
            wrong_usage!("--shard divides several videos or folders of frames: give two or more");
        }
        let estimated = estimate(&args, context)?;
        return if context.json { crate::output::print_json(&estimated) } else { print(&estimated) };
    }
    if let Some(video) = args.viz.as_deref().filter(|viz| is_video(viz)) {
        wrong_usage!("{}: several sequences give a folder of pictures each, not one video", video.display());
    }
    let sequences = named(std::mem::take(&mut args.frames))?;
    let part = shard.shard.range(sequences.len() as u64);
    let extra = [&args.viz, &args.uncertainty, &args.occlusion, &args.save_crops].map(Clone::clone);
    let out = args.out.clone();
    let mut all = BTreeMap::new();
    for (name, path) in &sequences[part.start as usize..part.end as usize] {
        let within = |folder: &Option<PathBuf>| folder.as_ref().map(|folder| folder.join(name));
        args.frames = vec![path.clone()];
        args.out = out.join(name);
        [args.viz, args.uncertainty, args.occlusion, args.save_crops] = extra.each_ref().map(within);
        let estimated = estimate(&args, context)?;
        if !context.json {
            print(&estimated)?;
        }
        all.insert(name.clone(), estimated);
    }
    if context.json {
        return Rendered { report: Sequences { sequences: all }, shard }.print_json();
    }
    Ok(())
}

/// The sequences by the names of their folders of flow.
fn named(paths: Vec<PathBuf>) -> anyhow::Result<Vec<(String, PathBuf)>> {
    let mut names = BTreeSet::new();
    let mut sequences = Vec::new();
    for path in paths {
        let name = if path.is_dir() { path.file_name() } else { path.file_stem() };
        let name = name.map(|name| name.to_string_lossy().into_owned());
        match name.filter(|name| names.insert(name.clone())) {
            Some(name) => sequences.push((name, path)),
            None => wrong_usage!(
                "{}: the flow of each video or folder goes into a folder of its name: expected a name of its own",
                path.display()
            ),
        }
    }
    Ok(sequences)
}

/// The flow of one sequence, or pair.
fn estimate(args: &Flow, context: &Context) -> anyhow::Result<Estimated> {
    let network = &args.parameters.network;
    if args.warm_start && network.batch > 1 {
        wrong_usage!(
            "--warm-start needs the flow of the previous pair, so --batch must be 1: leave one of them out"
        );
    }
    let source = Source::open(&args.frames)?;
    let mut outputs = Outputs::plan(args, &source)?;
    let method = args.method.method;
    for output in ExtraOutput::ALL {
        let is_predicted = method.network().is_some_and(|network| output.is_predicted_by(network));
        if args.extra(output).is_some() && !is_predicted {
            wrong_usage!("{}", output.missing(method.name()));
        }
    }
    let estimator = methods::estimator(&args.method, &args.parameters)?;
    if estimator.remembers() && network.batch > 1 {
        wrong_usage!("{} waits for the pair before, so that --batch is 1: leave it out", estimator.name());
    }
    let found = match args.face.is_whole() {
        true => None,
        false => Some(args.face.of_first_frame(&source.first()?)?),
    };
    if args.save_crops.is_some() && found.is_none() {
        wrong_usage!("--save-crops writes cropped frames: give --face detect, --face-box or --landmarks too");
    }
    let crop = found.as_ref().map_or(FrameCrop::Whole, |found| found.crop.clone());
    let one_by_one = args.warm_start || estimator.remembers();
    let resumed = outputs.claim(&identity(args, &crop)?, &source, one_by_one)?;
    if let Some(folder) = &args.save_crops {
        create_folder(folder)?;
    }
    let landmarks = match &found {
        Some(FoundFace { points: Some(points), .. }) if args.face.detects() => {
            let file = outputs.landmarks();
            write_landmarks(&file, &[], args.force, [(Vec::new(), points)])?;
            Some(file)
        }
        _ => None,
    };
    let initial = args.initial_flow.as_deref().map(read_flow).transpose()?;

    let template = match source.pairs() {
        Some(_) => "{bar:30} {pos}/{len} flows, {per_sec}, {eta} left",
        None => "{spinner} {pos} flows, {per_sec}, {elapsed}",
    };
    let bar = bar(source.pairs(), template);
    bar.set_position(resumed);
    let continuable = Continuable::counted(&bar, "flows");
    let work = Work {
        args,
        source: &source,
        outputs: &outputs,
        estimator: estimator.as_ref(),
        counts_iterations: method.network().is_some_and(|architecture| network.is_auto(architecture)),
        bar: &bar,
    };
    let reports = work.run(resumed, &crop, initial.as_ref());
    drop(continuable);
    bar.finish_and_clear();
    let reports = reports?;
    outputs.finish()?;
    let size = reports.first().map(|pair| (pair.width, pair.height));
    let resolution = size
        .filter(|_| context.json)
        .map(|size| args.parameters.large_frames.resolution(size, args.method.method, network))
        .transpose()?;
    Ok(Estimated {
        method: estimator.name().to_owned(),
        network: match args.method.method {
            Method::Network(architecture) if context.json => Some(NetworkUsed {
                weights: args.method.weights.clone().or_else(|| network.weights.clone()),
                iterations: network.iterations(architecture),
                still_px: network.still_px(architecture),
                settings: network.settings(architecture)?,
                levels: match &resolution {
                    Some(input) => network.init(architecture)?.levels([input.tile_height, input.tile_width]),
                    None => None,
                },
                device: network.device.clone(),
                precision: network.precision()?.name(),
                attention_tolerance: Some(network.attention_tolerance(architecture))
                    .filter(|&share| share > 0.0),
                batch: network.batch,
                warm_start: args.warm_start,
            }),
            _ => None,
        },
        landmarks,
        resolution,
        resumed,
        pairs: reports,
    })
}

fn print(estimated: &Estimated) -> anyhow::Result<()> {
    if estimated.resumed > 0 {
        say!("{} flows from the interrupted run were kept", estimated.resumed)?;
    }
    if let Some(file) = &estimated.landmarks {
        say!("{}: landmarks of the face in the first frame", file.display())?;
    }
    for pair in &estimated.pairs {
        let iterations = match pair.iterations {
            Some(number) => format!("  {} iterations", (10.0 * number).round() / 10.0),
            None => String::new(),
        };
        say!("{}  {}x{}  {:.3} s{iterations}", pair.flow.display(), pair.width, pair.height, pair.seconds)?;
    }
    Ok(())
}

fn is_zero(count: &u64) -> bool {
    *count == 0
}

/// Everything the flow depends on: runs with the same identity write the same files.
fn identity(args: &Flow, crop: &FrameCrop) -> anyhow::Result<String> {
    let records = methods::records(std::slice::from_ref(&args.method), &args.parameters)?;
    let method: Vec<String> = records.iter().map(|record| record.identity()).collect();
    let frames: Vec<PathBuf> = args.frames.iter().map(std::path::absolute).collect::<Result<_, _>>()?;
    Ok(format!(
        "{}\n{frames:?}\n{} {:?} {:?} {:?} {:?} {}{}\n",
        method.join("\n"),
        args.format,
        args.viz,
        args.viz_max,
        args.uncertainty,
        args.occlusion,
        args.warm_start,
        match crop {
            FrameCrop::Whole => String::new(),
            crop => format!(" {crop:?}"),
        }
    ))
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

/// Batches of frames that wait to be estimated, and of flows that wait to be written: a frame takes about as long to decode as its flow to
/// encode, and both less than the estimation.
const AHEAD: usize = 1;

/// From frames to files.
struct Work<'a> {
    args: &'a Flow,
    source: &'a Source,
    outputs: &'a Outputs,
    estimator: &'a dyn FlowEstimator,
    /// Whether pairs may differ in their iterations.
    counts_iterations: bool,
    bar: &'a ProgressBar,
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
    /// Estimates the pairs of a sequence, except the first `resumed`, `--batch` at a time; or one pair, starting from an initial flow. Frames
    /// are decoded and flows encoded meanwhile.
    fn run(
        &self,
        resumed: u64,
        crop: &FrameCrop,
        initial: Option<&FlowField>,
    ) -> anyhow::Result<Vec<EstimatedPair>> {
        let mut sequence = self.estimator.sequence(self.args.warm_start);
        let mut last = None;
        let estimate = |frames: Vec<Frame>| match initial {
            Some(initial) => self.pair_from(frames, initial),
            None => self.next(sequence.as_mut(), &mut last, frames),
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
        video.map_or(Ok(()), VideoWriter::finish)?;
        Ok(reports)
    }

    /// The frames, except the first `skip`, in batches: the first has one frame more, as it takes two for a pair.
    fn read(&self, skip: u64, crop: &FrameCrop, give: &mut dyn FnMut(anyhow::Result<Vec<Frame>>) -> bool) {
        let batch = self.args.parameters.network.batch;
        let (mut frames, mut wanted, mut more) = (Vec::new(), batch + 1, true);
        self.source.read(skip, |frame| {
            match frame.and_then(|frame| cropped(frame, crop, self.args.save_crops.as_deref())) {
                Ok(frame) => frames.push(frame),
                Err(error) => {
                    frames.clear();
                    give(Err(error));
                    more = false;
                }
            }
            if frames.len() == wanted {
                more = give(Ok(std::mem::take(&mut frames)));
                wanted = batch;
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
        let ((width, height), (initial_width, initial_height)) = (first.image.size(), initial.size());
        ensure!(
            (initial_width, initial_height) == (width, height),
            "--initial-flow is {initial_width}x{initial_height}, the frames are {width}x{height} (WIDTHxHEIGHT): \
             give a flow of the frames' size"
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
                write_image_png(png, &heat(plane, output.brightest(plane, self.args.viz_max)))?;
            }
        }
        let colours = || flow_colors(flow, self.args.viz_max);
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
        self.bar.inc(1);
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
