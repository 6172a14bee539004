//! Facial optical-flow datasets, rendered from synthetic heads with exact flow.

use std::fmt;
use std::path::PathBuf;

use serde::{Deserialize, Serialize};
use srflow_render::generate::generate;
use srflow_render::job::StageTime;
use srflow_render::statistics::Statistics;

pub use srflow_render::generate::{Background, MotionSource, Settings};

/// The help of a setting that is a head.
pub fn head_help() -> String {
    format!("Head model: {}", srflow_avatar::HeadSource::help())
}

use crate::clap::{Args, ValueEnum};
use crate::rendering::{Rendered, RenderingArgs};
use crate::{Job, Report, Watch, WhenStopped};

/// Render a facial optical-flow dataset with exact flow from a head avatar
#[derive(Args, Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[command(after_help = "\
Examples:
  srflow render --out srflow               the paper's 11,161 pairs at 2200x3208
  srflow render --out tiny --scenes 3 --frames 8 --size 550x802
  srflow render --out part --shard 2/8     one of eight parts; join them with srflow merge
  srflow render --out train --preset wild --size 550x802     frames that look like recordings

Running the same command again continues a stopped run. `srflow check` examines the dataset.")]
pub struct RenderJob {
    /// Folder of the dataset
    #[arg(long, value_name = "DIR")]
    pub out: PathBuf,
    /// Defaults of other settings: `wild` combines a procedural background, mixed motion and every effect of
    /// a recording
    #[arg(long, value_name = "NAME")]
    #[serde(default)]
    pub preset: Option<Preset>,
    #[command(flatten)]
    #[serde(flatten)]
    pub rendering: RenderingArgs,
    // Last: it ends with a heading.
    #[command(flatten)]
    #[serde(flatten)]
    pub settings: Settings,
}

/// Defaults that belong together.
#[derive(ValueEnum, Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Preset {
    /// Frames that look like recordings.
    Wild,
}

impl Preset {
    /// The settings that the preset starts from.
    pub fn settings(self) -> Settings {
        match self {
            Self::Wild => Settings::wild(),
        }
    }
}

impl RenderJob {
    /// The paper's dataset in the folder `out`.
    pub fn new(out: impl Into<PathBuf>) -> Self {
        Self { out: out.into(), ..Self::default() }
    }
}

impl Job for RenderJob {
    const NAME: &'static str = "render";
    const WHEN_STOPPED: WhenStopped = WhenStopped::UnitsKept;

    type Report = Rendered<RenderReport>;

    fn preset_defaults(&self) -> Option<serde_json::Value> {
        Some(serde_json::json!(self.preset?.settings()))
    }

    fn work(&self, watch: &Watch) -> anyhow::Result<Self::Report> {
        let notes = self.settings.empty_splits();
        for note in &notes {
            log::warn!("{note}");
        }
        let rendered =
            self.rendering.make(&self.out, "pairs", watch, |request| generate(&self.settings, request))?;
        Ok(rendered.map(|report| {
            let run = report.run;
            let pairs_per_minute = if run.made == 0 { 0.0 } else { 60.0 * run.made as f64 / run.seconds };
            RenderReport {
                dataset: self.out.clone(),
                pairs: run.units,
                made: run.made,
                bytes: run.bytes,
                seconds: run.seconds,
                pairs_per_minute,
                stages: run.stages,
                stopped: run.stopped,
                statistics: report.statistics,
                notes,
            }
        }))
    }
}

/// What a run of [`RenderJob`] has made.
#[derive(Debug, Clone, Serialize)]
pub struct RenderReport {
    pub dataset: PathBuf,
    /// Pairs of the part.
    pub pairs: u64,
    /// Pairs rendered by this run.
    pub made: u64,
    /// Bytes written by this run.
    pub bytes: u64,
    pub seconds: f64,
    pub pairs_per_minute: f64,
    /// The workers' time by stage.
    pub stages: Vec<StageTime>,
    /// Whether the run was stopped before the part was complete.
    pub stopped: bool,
    /// Of the whole dataset, once it is complete.
    pub statistics: Option<Statistics>,
    pub notes: Vec<String>,
}

impl Report for Rendered<RenderReport> {
    fn stopped(&self) -> bool {
        self.report.stopped
    }
}

impl fmt::Display for Rendered<RenderReport> {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        let RenderReport { pairs, made, bytes, seconds, pairs_per_minute, stages, stopped, .. } =
            &self.report;
        let megabytes = *bytes as f64 / 1e6;
        writeln!(
            f,
            "{made} of {pairs} pairs rendered in {seconds:.1} s: {pairs_per_minute:.1} pairs a minute, {megabytes:.1} MB, {:.1} MB/s",
            megabytes / seconds.max(1e-9),
        )?;
        let spent: f64 = stages.iter().map(|stage| stage.worker_seconds).sum();
        if *made > 0 && spent > 0.0 {
            writeln!(f, "\nstage       ms/pair  share")?;
            for stage in stages {
                let milliseconds = 1e3 * stage.worker_seconds / *made as f64;
                let share = 100.0 * stage.worker_seconds / spent;
                writeln!(f, "{:<10} {milliseconds:>8.1} {share:>5.1}%", stage.stage)?;
            }
        }
        match &self.report.statistics {
            Some(statistics) => write_statistics(f, statistics),
            None if *stopped => Ok(()),
            None => self.write_part(f, "statistics.json"),
        }
    }
}

/// Writes the paper's Table I and the histogram of flow magnitudes.
pub(crate) fn write_statistics(f: &mut fmt::Formatter, statistics: &Statistics) -> fmt::Result {
    writeln!(f, "\nScenes        {}", statistics.scenes)?;
    writeln!(f, "Avg. Frames   {:.0}", statistics.average_frames)?;
    writeln!(f, "Total Frames  {}", statistics.total_frames)?;
    writeln!(f, "Resolution    {}x{}", statistics.width, statistics.height)?;
    for part in &statistics.splits {
        writeln!(f, "{:<13} {} scenes, {} pairs", part.split.to_string(), part.scenes, part.pairs)?;
    }
    writeln!(
        f,
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
        writeln!(f, "{:>6} to {upper} px {:>6.2}% {bar}", edges[bin], 100.0 * share)?;
    }
    Ok(())
}
