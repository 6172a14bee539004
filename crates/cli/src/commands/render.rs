use std::io::Write as _;
use std::path::PathBuf;
use std::sync::atomic::{AtomicU64, Ordering};

use clap::Args;
use indicatif::{ProgressBar, ProgressStyle};
use serde_json::json;
use srflow_field::FlowFormat;
use srflow_render::RenderError;
use srflow_render::generate::{Background, Head, Report, Settings, generate};
use srflow_render::job::{Event, Made, Request, Shard};
use srflow_render::statistics::Statistics;

use crate::Context;
use crate::size::Size;
use crate::usage::wrong_usage;

/// Render a facial optical-flow dataset with exact flow from a head avatar
#[derive(Args)]
#[command(after_help = "\
Examples:
  srflow render --out srflow               the paper's 11,161 pairs at 2200x3208
  srflow render --out tiny --scenes 3 --frames 8 --size 550x802
  srflow render --out part --shard 2/8     one of eight parts; merge by copying

The same command given again continues where a run was stopped. `srflow check`
examines the dataset; its files are described in docs/dataset.md.")]
pub struct Render {
    /// Folder of the dataset
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// Whose heads: `builtin`, or `ict:DIR` with ICT-FaceKit's FaceXModel folder
    #[arg(long, value_name = "HEAD", default_value = "builtin")]
    head: Head,
    /// Number of scenes, each with a subject of its own
    #[arg(long, value_name = "N", default_value_t = 27)]
    scenes: u32,
    /// Frame pairs in a scene; the mean of the scenes where it is not whole
    #[arg(long, value_name = "N", default_value_t = 413.37)]
    frames: f64,
    /// Size of the frames, WIDTHxHEIGHT
    #[arg(long, value_name = "SIZE", default_value = "2200x3208")]
    size: Size,
    /// Shares of train, val and test scenes
    #[arg(long, value_name = "SHARES", default_value = "0.61,0.11,0.28", value_parser = shares)]
    splits: Shares,
    /// Seed of every random choice
    #[arg(long, value_name = "N", default_value_t = 1)]
    seed: u64,
    /// How flow is stored
    #[arg(long, value_name = "FORMAT", default_value_t = FlowFormat::Npz16, help = flow_format_help())]
    flow_format: FlowFormat,
    /// Write the flow from frame 2 to frame 1 too
    #[arg(long)]
    backward: bool,
    /// Write depth too
    #[arg(long)]
    depth: bool,
    /// What is behind the subject: white, black, #rrggbb, or a folder of images
    #[arg(long, value_name = "COLOUR|DIR", default_value = "white")]
    background: Background,
    /// Make part I of N only
    #[arg(long, value_name = "I/N", default_value = "1/1", hide_default_value = true)]
    shard: Shard,
    /// Stop after making N pairs, exit code 75; the same command continues
    #[arg(long, value_name = "N")]
    stop_after: Option<u64>,
    /// Delete the dataset that lies in the folder and start over
    #[arg(long)]
    force: bool,
}

type Shares = [f64; 3];

fn flow_format_help() -> String {
    format!("How flow is stored: {}", FlowFormat::ALL.map(FlowFormat::extension).join(", "))
}

fn shares(text: &str) -> Result<Shares, String> {
    let shares: Option<Vec<f64>> = text.split(',').map(|share| share.trim().parse().ok()).collect();
    shares
        .and_then(|shares| shares.try_into().ok())
        .ok_or_else(|| format!("`{text}` are not three shares; expected TRAIN,VAL,TEST, e.g. 0.61,0.11,0.28"))
}

pub fn run(args: Render, context: &Context) -> anyhow::Result<()> {
    crate::output::ensure_folder(&args.out)?;
    let settings = Settings {
        head: args.head,
        scenes: args.scenes,
        frames: args.frames,
        width: args.size.width,
        height: args.size.height,
        splits: args.splits,
        seed: args.seed,
        flow_format: args.flow_format,
        backward: args.backward,
        depth: args.depth,
        background: args.background,
    };
    let notes = settings.empty_splits();
    for note in &notes {
        note!("note: {note}");
    }
    let progress = Progress::new("pairs");
    let request = Request {
        dir: &args.out,
        shard: args.shard,
        force: args.force,
        stop_after: args.stop_after,
        on_event: &|event| progress.show(event),
    };
    let result = generate(&settings, request);
    progress.finish();
    let report = usage_error(result)?;
    if context.json {
        crate::output::print_json(&summary(&args.out, &report, &notes))?;
    } else {
        print_report(args.shard, &report)?;
    }
    exit_if_stopped(report.run.stopped)
}

/// Exit code of a run that was stopped on request.
const STOPPED: i32 = 75;

/// Ends the program when a run was stopped on request.
pub fn exit_if_stopped(stopped: bool) -> anyhow::Result<()> {
    if stopped {
        std::io::stdout().flush()?;
        note!("stopped on request; the same command without --stop-after continues");
        std::process::exit(STOPPED);
    }
    Ok(())
}

/// What was rendered; an argument that is out of range is wrong usage.
pub fn usage_error<T>(result: Result<T, RenderError>) -> anyhow::Result<T> {
    match result {
        Err(error @ RenderError::Argument { .. }) => wrong_usage!("{error}"),
        result => Ok(result?),
    }
}

/// A bar on standard error, where that is a terminal.
pub struct Progress {
    bar: ProgressBar,
    bytes: AtomicU64,
}

impl Progress {
    pub fn new(units: &str) -> Self {
        let bar = ProgressBar::new(0);
        let template = format!("{{wide_bar}} {{pos}}/{{len}} {units}, {{msg}}, {{eta}} left");
        bar.set_style(
            ProgressStyle::with_template(&template).unwrap_or_else(|_| ProgressStyle::default_bar()),
        );
        Self { bar, bytes: AtomicU64::new(0) }
    }

    pub fn show(&self, event: Event) {
        match event {
            Event::Started { units, whole } => {
                self.bar.set_length(units);
                self.bar.set_position(whole);
                self.bar.reset_eta();
                self.bar.reset_elapsed();
            }
            Event::Made { bytes } => {
                // Workers report out of order: the most that was reported stands.
                let bytes = self.bytes.fetch_max(bytes, Ordering::Relaxed).max(bytes);
                let seconds = self.bar.elapsed().as_secs_f64().max(1e-3);
                self.bar.set_message(format!("{:.1} MB/s", bytes as f64 / 1e6 / seconds));
                self.bar.inc(1);
            }
        }
    }

    pub fn finish(&self) {
        self.bar.finish_and_clear();
    }
}

fn summary(out: &std::path::Path, report: &Report, notes: &[String]) -> serde_json::Value {
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

fn print_report(shard: Shard, report: &Report) -> anyhow::Result<()> {
    let Made { units, made, bytes, seconds, stages, stopped } = &report.run;
    say!(
        "{made} of {units} pairs made in {seconds:.1} s: {:.1} pairs a minute, {:.1} MB, {:.1} MB/s",
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
        None => say!(
            "\nPart {shard} is whole. Copy the parts together; `srflow render` with the same arguments and without --shard\n\
             then writes statistics.json."
        )?,
    }
    Ok(())
}

/// The paper's Table I, and the histogram of flow magnitudes.
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
        "\nFlow on the head: mean {:.3} px, greatest {:.1} px, {:.2}% occluded",
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
