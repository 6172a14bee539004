use std::collections::HashSet;
use std::path::{Path, PathBuf};
use std::sync::mpsc::sync_channel;
use std::time::Instant;

use anyhow::{Context as _, bail, ensure};
use clap::Args;
use indicatif::{ProgressBar, ProgressStyle};
use serde::Serialize;
use srflow_data::read::pictures;
use srflow_field::{
    FlowEstimator, FlowField, FlowFormat, IMAGE_EXTENSIONS, Image, create_folder, flow_colors, read_flow,
    read_image, write_flow, write_image_png,
};

use crate::Context;
use crate::methods::{self, Method, MethodParameters};

/// Estimate optical flow between frames
#[derive(Args)]
#[command(after_help = "\
Examples:
  srflow flow --method farneback frame1.png frame2.png -o flow.flo --viz flow.png
  srflow flow --method farneback video/ -o flows/ --format flo5 --viz colours/

Two frames give one file, in the format of its extension. More frames, or a folder of them in the \
order of their numbers, give a folder: the flow from each frame to the next, under the name of the former.")]
pub struct Flow {
    /// Two frames or more, or a folder of them
    #[arg(required = true, value_name = "FRAME")]
    frames: Vec<PathBuf>,
    /// File of the flow, or folder of the flows
    #[arg(short, long, value_name = "OUT")]
    out: PathBuf,
    /// How to estimate the flow
    #[arg(long, value_enum)]
    method: Method,
    /// Format of the files in a folder
    #[arg(long, value_name = "FORMAT", default_value = "flo")]
    format: FlowFormat,
    /// Draw the flow in colours too: a PNG file, or a folder of them
    #[arg(long, value_name = "OUT")]
    viz: Option<PathBuf>,
    /// Length in pixels of the flow that gets the fullest colour [default: the longest of each flow]
    #[arg(long, value_name = "PIXELS", requires = "viz", value_parser = super::convert::positive)]
    viz_max: Option<f32>,
    /// Start from this flow, for two frames
    #[arg(long, value_name = "FLOW")]
    initial_flow: Option<PathBuf>,
    /// Overwrite files that exist
    #[arg(long)]
    force: bool,
    #[command(flatten)]
    parameters: MethodParameters,
}

/// One pair of frames and what is made of it.
#[derive(Debug, Clone)]
struct Pair {
    frame1: PathBuf,
    frame2: PathBuf,
    flow: PathBuf,
    viz: Option<PathBuf>,
}

#[derive(Serialize)]
struct Report {
    method: String,
    pairs: Vec<PairReport>,
}

#[derive(Serialize)]
struct PairReport {
    frame1: PathBuf,
    frame2: PathBuf,
    flow: PathBuf,
    #[serde(skip_serializing_if = "Option::is_none")]
    viz: Option<PathBuf>,
    width: usize,
    height: usize,
    /// Time the estimation took, without reading and writing.
    seconds: f64,
}

/// Runs the command.
pub fn run(args: Flow, context: &Context) -> anyhow::Result<()> {
    let estimator = methods::estimator(args.method, &args.parameters)?;
    let pairs = plan(&args)?;
    if !args.force {
        let outputs = pairs.iter().flat_map(|pair| [Some(&pair.flow), pair.viz.as_ref()]).flatten();
        if let Some(existing) = outputs.into_iter().find(|path| path.exists()) {
            bail!("{} exists; give --force to overwrite it, or another name", existing.display());
        }
    }
    for folder in
        pairs.iter().flat_map(|pair| [pair.flow.parent(), pair.viz.as_deref().and_then(Path::parent)])
    {
        if let Some(folder) = folder.filter(|folder| !folder.as_os_str().is_empty()) {
            create_folder(folder)?;
        }
    }

    let reports = estimate_all(&pairs, estimator.as_ref(), &args)?;
    if context.json {
        let report = Report { method: estimator.name().to_owned(), pairs: reports };
        say!("{}", serde_json::to_string_pretty(&report)?)?;
    } else {
        for pair in &reports {
            say!("{}  {}x{}  {:.3} s", pair.flow.display(), pair.width, pair.height, pair.seconds)?;
        }
    }
    Ok(())
}

/// Which flows are made from which frames.
fn plan(args: &Flow) -> anyhow::Result<Vec<Pair>> {
    let frames = match args.frames.as_slice() {
        [folder] if folder.is_dir() => frames_of(folder)?,
        [frame] => {
            bail!("{}: one frame has no flow; give two or more, or a folder of frames", frame.display())
        }
        frames => frames.to_vec(),
    };
    let is_file = frames.len() == 2
        && args.frames.len() == 2
        && !args.out.is_dir()
        && args.out.extension().is_some()
        && !ends_with_separator(&args.out);
    if is_file {
        if FlowFormat::from_path(&args.out).is_none() {
            let names = FlowFormat::ALL.map(FlowFormat::extension).join(", ");
            bail!("{}: its extension is no flow format; there are {names}", args.out.display());
        }
        if let Some(viz) = &args.viz {
            let is_png = viz.extension().is_some_and(|extension| extension.eq_ignore_ascii_case("png"));
            ensure!(
                is_png && !viz.is_dir(),
                "{}: two frames give one picture: expected the name of a file ending in .png",
                viz.display()
            );
        }
        return Ok(vec![Pair {
            frame1: frames[0].clone(),
            frame2: frames[1].clone(),
            flow: args.out.clone(),
            viz: args.viz.clone(),
        }]);
    }
    ensure!(args.initial_flow.is_none(), "--initial-flow is for two frames and a file, not for a sequence");
    for folder in [Some(&args.out), args.viz.as_ref()].into_iter().flatten() {
        let like_file = folder.is_file() || FlowFormat::from_path(folder).is_some();
        ensure!(
            !like_file || folder.is_dir(),
            "{}: {} frames give {} flows, which take a folder, not a file",
            folder.display(),
            frames.len(),
            frames.len() - 1
        );
    }
    let mut names = HashSet::new();
    let pair = |frames: &[PathBuf]| {
        let stem = frames[0].file_stem().unwrap_or_default();
        ensure!(
            names.insert(stem.to_owned()),
            "{}: another frame has the same name, and their flows would overwrite each other; rename one",
            frames[0].display()
        );
        let named = |folder: &Path, extension: &str| {
            let mut name = stem.to_owned();
            name.push(".");
            name.push(extension);
            folder.join(name)
        };
        Ok(Pair {
            frame1: frames[0].clone(),
            frame2: frames[1].clone(),
            flow: named(&args.out, args.format.extension()),
            viz: args.viz.as_deref().map(|folder| named(folder, "png")),
        })
    };
    frames.windows(2).map(pair).collect()
}

fn ends_with_separator(path: &Path) -> bool {
    path.as_os_str().to_string_lossy().ends_with(std::path::is_separator)
}

/// The frames in a folder, in the order of the numbers in their names.
fn frames_of(folder: &Path) -> anyhow::Result<Vec<PathBuf>> {
    let frames = pictures(folder)?;
    ensure!(
        frames.len() >= 2,
        "{}: two frames or more were looked for (files named *.{}); found {}",
        folder.display(),
        IMAGE_EXTENSIONS.join(", *."),
        frames.len()
    );
    Ok(frames)
}

/// Estimates and writes the flow of every pair. The next frame is read meanwhile; never more than four are in memory.
fn estimate_all(
    pairs: &[Pair],
    estimator: &dyn FlowEstimator,
    args: &Flow,
) -> anyhow::Result<Vec<PairReport>> {
    let initial = args.initial_flow.as_deref().map(read_flow).transpose()?;
    let progress = progress_bar(pairs.len());
    std::thread::scope(|scope| {
        let (sender, frames) = sync_channel(1);
        scope.spawn(move || {
            for path in pairs
                .first()
                .map(|pair| &pair.frame1)
                .into_iter()
                .chain(pairs.iter().map(|pair| &pair.frame2))
            {
                if sender.send(read_image(path)).is_err() {
                    return; // an error ended the other side
                }
            }
        });
        let next = || frames.recv().context("the thread that reads frames ended early");
        let mut frame1 = next()??;
        let mut reports = Vec::with_capacity(pairs.len());
        for pair in pairs {
            let frame2 = next()??;
            reports.push(estimate_pair(pair, &frame1, &frame2, estimator, initial.as_ref(), args.viz_max)?);
            frame1 = frame2;
            progress.inc(1);
        }
        progress.finish_and_clear();
        Ok(reports)
    })
}

fn estimate_pair(
    pair: &Pair,
    frame1: &Image,
    frame2: &Image,
    estimator: &dyn FlowEstimator,
    initial: Option<&FlowField>,
    viz_max: Option<f32>,
) -> anyhow::Result<PairReport> {
    let names = || format!("{} and {}", pair.frame1.display(), pair.frame2.display());
    let ((width, height), (width2, height2)) = (frame1.size(), frame2.size());
    ensure!(
        (width, height) == (width2, height2),
        "the frames differ in size: {} is {width}x{height}, {} is {width2}x{height2}; resize or crop one",
        pair.frame1.display(),
        pair.frame2.display()
    );
    if let Some((initial_width, initial_height)) = initial.map(FlowField::size) {
        ensure!(
            (initial_width, initial_height) == (width, height),
            "--initial-flow is {initial_width}x{initial_height}, the frames are {width}x{height} (WIDTHxHEIGHT): \
             give a flow of the frames' size"
        );
    }
    let start = Instant::now();
    let flow = match initial {
        Some(initial) => estimator.estimate_from(frame1, frame2, initial),
        None => estimator.estimate(frame1, frame2),
    }
    .with_context(names)?;
    let seconds = start.elapsed().as_secs_f64();
    write_flow(&pair.flow, &flow)?;
    if let Some(viz) = &pair.viz {
        write_image_png(viz, &flow_colors(&flow, viz_max))?;
    }
    Ok(PairReport {
        frame1: pair.frame1.clone(),
        frame2: pair.frame2.clone(),
        flow: pair.flow.clone(),
        viz: pair.viz.clone(),
        width,
        height,
        seconds,
    })
}

/// A bar on standard error with the time left; indicatif hides it when that is no terminal.
fn progress_bar(pairs: usize) -> ProgressBar {
    let style = ProgressStyle::with_template("{bar:30} {pos}/{len} flows, {per_sec}, {eta} left")
        .unwrap_or_else(|_| ProgressStyle::default_bar());
    ProgressBar::new(pairs as u64).with_style(style)
}
