use std::ffi::OsString;
use std::path::{Path, PathBuf};
use std::str::FromStr;

use clap::Args;
use serde_json::{Value, json};
use srflow_avatar::HeadSource;
use srflow_core::Size;
use srflow_files::FlowFormat;
use srflow_read::manifest::Recording;
use srflow_render::generate::{Background, MotionSource, Report, Settings, generate};
use srflow_render::job::Made;
use srflow_render::statistics::Statistics;
use srflow_splat::Device;

use crate::Context;
use crate::library::{Watch, parsed};
use crate::networks::device_help;
use crate::rendering::{Rendered, RenderingArgs, exit_if_stopped};

/// Render a facial optical-flow dataset with exact flow from a head avatar
#[derive(Args)]
#[command(after_help = "\
Examples:
  srflow render --out srflow               the paper's 11,161 pairs at 2200x3208
  srflow render --out tiny --scenes 3 --frames 8 --size 550x802
  srflow render --out part --shard 2/8     one of eight parts; merge by copying
  srflow render --out train --preset wild --size 550x802     frames that look like recordings

The same command given again continues where a run was stopped. `srflow check`
examines the dataset; its files are described in docs/reference/dataset-format.md.")]
pub struct Render {
    /// Folder of the dataset
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// Head model
    #[arg(long, value_name = "HEAD", default_value = "builtin", help = head_help())]
    head: HeadSource,
    /// Number of scenes, one subject each
    #[arg(long, value_name = "N", default_value_t = Settings::default().scenes)]
    scenes: u32,
    /// Frame pairs per scene; if not an integer, the mean over the scenes
    #[arg(long, value_name = "N", default_value_t = Settings::default().frames)]
    frames: f64,
    /// Size of the frames, WIDTHxHEIGHT
    #[arg(long, value_name = "SIZE", default_value = "2200x3208")]
    size: Size,
    /// Shares of train, val and test scenes
    #[arg(long, value_name = "SHARES", default_value = "0.61,0.11,0.28", value_parser = shares)]
    splits: Shares,
    /// Random seed
    #[arg(long, value_name = "N", default_value_t = Settings::default().seed)]
    seed: u64,
    /// File format of the flow
    #[arg(long, value_name = "FORMAT", default_value_t = Settings::default().flow_format, help = flow_format_help())]
    flow_format: FlowFormat,
    /// Also write the flow from frame 2 to frame 1
    #[arg(long)]
    backward: bool,
    /// Also write depth
    #[arg(long)]
    depth: bool,
    /// Also write region maps: whether a pixel shows skin, eyes, mouth, hair or neck
    #[arg(long)]
    regions: bool,
    /// Background: white, black, #rrggbb, `procedural` (rooms, textures, gradients, lights), or a folder of images
    /// [default: white]
    #[arg(long, value_name = "COLOUR|DIR")]
    background: Option<Background>,
    /// Motion: `curves` (random expressions, speech, blinks, gaze and turns), `mixed` (with micro-expressions, small and large),
    /// `own` (the one that an avatar was trained on), or a flame_param.npz or capture of another subject with the same kind of head
    /// [default: curves]
    #[arg(long, value_name = "MOTION")]
    motion: Option<MotionSource>,
    #[arg(long, value_name = "DEVICE", default_value = "cpu", value_parser = Device::named, help = device_help())]
    device: Device,
    #[command(flatten)]
    rendering: RenderingArgs,
    // Last: its heading holds for all that follow.
    #[command(flatten)]
    effects: Effects,
}

/// Each scene draws its own strength of every effect, up to the one given here. Flow, masks and depth stay exact.
#[derive(Args)]
#[command(next_help_heading = "Frames like recordings")]
struct Effects {
    #[arg(long, value_name = "NAME", value_parser = ["wild"], help = preset_help())]
    preset: Option<String>,
    /// Sensor noise; at 1 a standard deviation of 1.8 of 255 levels in mid-grey
    #[arg(long, value_name = "F")]
    noise: Option<f32>,
    /// Exposure and white balance; at 1 off by half a stop at most, changing by 2 % within a scene
    #[arg(long, value_name = "F")]
    lighting: Option<f32>,
    /// Share of the head's light that comes from lamps on some sides, 0 to 1
    #[arg(long, value_name = "SHARE")]
    lamps: Option<f32>,
    /// Motion blur: share of the time between frames during which the shutter is open, 0 to 1
    #[arg(long, value_name = "SHARE")]
    shutter: Option<f32>,
    /// Radius of the blur of a lens out of focus, pixels
    #[arg(long, value_name = "PX")]
    defocus: Option<f32>,
    /// Least quality of JPEG compression, 1 to 100; a scene's is from here to 95
    #[arg(long, value_name = "QUALITY")]
    jpeg: Option<u8>,
}

impl Effects {
    fn preset(&self) -> Settings {
        if self.preset.is_some() { Settings::wild() } else { Settings::default() }
    }

    /// Those of the preset, where not given.
    fn recording(&self, preset: Recording) -> Recording {
        Recording {
            noise: self.noise.unwrap_or(preset.noise),
            lighting: self.lighting.unwrap_or(preset.lighting),
            lamps: self.lamps.unwrap_or(preset.lamps),
            shutter: self.shutter.unwrap_or(preset.shutter),
            defocus: self.defocus.unwrap_or(preset.defocus),
            jpeg: self.jpeg.or(preset.jpeg),
        }
    }
}

type Shares = [f64; 3];

/// The help of `--head`.
pub fn head_help() -> String {
    format!("Head model: {}", HeadSource::help())
}

/// The help of `--flow-format`.
pub fn flow_format_help() -> String {
    format!("File format of the flow: {}", FlowFormat::ALL.map(FlowFormat::extension).join(", "))
}

/// `N` numbers between commas.
pub fn numbers<T: FromStr, const N: usize>(text: &str) -> Option<[T; N]> {
    let numbers: Option<Vec<T>> = text.split(',').map(|number| number.trim().parse().ok()).collect();
    numbers?.try_into().ok()
}

fn preset_help() -> String {
    let Recording { noise, lighting, lamps, shutter, defocus, jpeg } = Recording::wild();
    let jpeg = jpeg.map_or(String::new(), |quality| format!(" --jpeg {quality}"));
    format!(
        "`wild` is --background procedural --motion mixed --noise {noise} --lighting {lighting} --lamps {lamps} --shutter {shutter} \
         --defocus {defocus}{jpeg}, where not given otherwise"
    )
}

fn shares(text: &str) -> Result<Shares, String> {
    numbers(text)
        .ok_or_else(|| format!("expected three shares TRAIN,VAL,TEST, e.g. 0.61,0.11,0.28, found `{text}`"))
}

impl Render {
    fn settings(&self) -> Settings {
        let preset = self.effects.preset();
        Settings {
            head: self.head.clone(),
            scenes: self.scenes,
            frames: self.frames,
            width: self.size.width,
            height: self.size.height,
            splits: self.splits,
            seed: self.seed,
            flow_format: self.flow_format,
            backward: self.backward,
            depth: self.depth,
            background: self.background.clone().unwrap_or(preset.background),
            motion: self.motion.clone().unwrap_or(preset.motion),
            regions: self.regions,
            recording: self.effects.recording(preset.recording),
            device: self.device.clone(),
        }
    }
}

/// `srflow render` with these options. Returns what `--json` prints.
///
/// # Errors
/// Those of the command; [`UsageError`](crate::UsageError) for a wrong option.
pub fn render(options: impl IntoIterator<Item = OsString>, watch: &Watch) -> anyhow::Result<Value> {
    let args: Render = parsed("srflow render", options)?;
    let settings = args.settings();
    let report = args.rendering.make_watched(&args.out, watch, |request| generate(&settings, request))?;
    let summary = report.map(|report| summary(&args.out, report, &settings.empty_splits()));
    Ok(serde_json::to_value(summary)?)
}

pub fn run(args: Render, context: &Context) -> anyhow::Result<()> {
    let settings = args.settings();
    let notes = settings.empty_splits();
    for note in &notes {
        note!("note: {note}");
    }
    let rendered = args.rendering.make(&args.out, "pairs", |request| generate(&settings, request))?;
    let stopped = rendered.report.run.stopped;
    if context.json {
        rendered.map(|report| summary(&args.out, report, &notes)).print_json()?;
    } else {
        print_report(&rendered)?;
    }
    exit_if_stopped(stopped)
}

fn summary(out: &Path, report: &Report, notes: &[String]) -> Value {
    json!({
        "dataset": out,
        "pairs": report.run.units,
        "made": report.run.made,
        "bytes": report.run.bytes,
        "seconds": report.run.seconds,
        "pairs_per_minute": pairs_per_minute(&report.run),
        "stages": report.run.stages,
        "stopped": report.run.stopped,
        "statistics": report.statistics,
        "notes": notes,
    })
}

fn pairs_per_minute(made: &Made) -> f64 {
    if made.made == 0 { 0.0 } else { 60.0 * made.made as f64 / made.seconds }
}

fn print_report(rendered: &Rendered<Report>) -> anyhow::Result<()> {
    let report = &rendered.report;
    let Made { units, made, bytes, seconds, stages, stopped } = &report.run;
    say!(
        "{made} of {units} pairs rendered in {seconds:.1} s: {:.1} pairs a minute, {:.1} MB, {:.1} MB/s",
        pairs_per_minute(&report.run),
        *bytes as f64 / 1e6,
        *bytes as f64 / 1e6 / seconds.max(1e-9),
    )?;
    let spent: f64 = stages.iter().map(|stage| stage.worker_seconds).sum();
    if *made > 0 && spent > 0.0 {
        say!("\nstage       ms/pair  share")?;
        for stage in stages {
            let milliseconds = 1e3 * stage.worker_seconds / *made as f64;
            say!("{:<10} {milliseconds:>8.1} {:>5.1}%", stage.stage, 100.0 * stage.worker_seconds / spent)?;
        }
    }
    match &report.statistics {
        Some(statistics) => print_statistics(statistics)?,
        None if *stopped => {}
        None => rendered.print_part("statistics.json")?,
    }
    Ok(())
}

/// Prints the paper's Table I and the histogram of flow magnitudes.
///
/// # Errors
/// When standard output cannot be written to.
pub fn print_statistics(statistics: &Statistics) -> anyhow::Result<()> {
    say!("\nScenes        {}", statistics.scenes)?;
    say!("Avg. Frames   {:.0}", statistics.average_frames)?;
    say!("Total Frames  {}", statistics.total_frames)?;
    say!("Resolution    {}x{}", statistics.width, statistics.height)?;
    for part in &statistics.splits {
        say!("{:<13} {} scenes, {} pairs", part.split.to_string(), part.scenes, part.pairs)?;
    }
    say!(
        "\nFlow on the head: mean {:.3} px, maximum {:.1} px, {:.2}% occluded",
        statistics.mean_magnitude,
        statistics.flow.max,
        100.0 * statistics.occluded_share
    )?;
    let pixels = statistics.flow.pixels.max(1) as f64;
    let edges = statistics.bin_edges;
    for (bin, count) in statistics.flow.histogram.iter().enumerate() {
        let share = *count as f64 / pixels;
        let upper = edges.get(bin + 1).map_or("    up".to_owned(), |edge| format!("{edge:>6}"));
        let bar = "#".repeat((share * 60.0).round() as usize);
        say!("{:>6} to {upper} px {:>6.2}% {bar}", edges[bin], 100.0 * share)?;
    }
    Ok(())
}
