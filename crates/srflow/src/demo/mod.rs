//! The pipeline end to end, in a few minutes.

mod action_units;
mod datasets;
mod page;
mod stage;

use std::fmt;
use std::path::{Path, PathBuf};
use std::process::Command;

use anyhow::Context as _;
use serde::{Deserialize, Serialize};
use srflow_avatar::{Avatars, HeadSource};
use srflow_core::{FlowEstimator, Size};
use srflow_data::flow::{DatasetSpec, FlowDataset};
use srflow_eval::{Evaluation, Settings, pair_figures};
use srflow_files::write_file;
use srflow_render::generate::FULL_SIZE;
use srflow_report::html::Figure;

use crate::clap::Args;
use crate::error::wrong_settings;
use crate::head_page::head_page;
use crate::methods::{self, Method, MethodParameters, MethodSpec};
use crate::output::{ensure_folder, ensure_free};
use crate::posed_head::MovingHead;
use crate::{Job, Report, Watch, machine, scoring};
use stage::{StageTime, Stages};

/// Render a small dataset, estimate its flow, score it and show everything in one report
#[derive(Args, Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default)]
#[command(after_help = "\
Renders three heads at 2200x3208 and a smaller dataset of the same heads in motion, estimates the flow with every \
method, scores it and writes one self-contained HTML file.

Example: with a pair of real photographs too, and the report opened at the end
  srflow demo --pair frame1.png frame2.png true_flow.png --open")]
pub struct DemoJob {
    /// Folder for the datasets, the scores and report.html
    #[arg(long, value_name = "DIR", default_value_os_t = Self::default().out)]
    pub out: PathBuf,
    /// Head model
    #[arg(long, value_name = "HEAD", default_value_t = Self::default().head, help = crate::render::head_help())]
    pub head: HeadSource,
    /// Random seed; each seed renders other heads
    #[arg(long, value_name = "N", default_value_t = Self::default().seed)]
    pub seed: u64,
    /// Size of the large frames, WIDTHxHEIGHT; smaller is faster
    #[arg(long, value_name = "SIZE", default_value_t = Self::default().size)]
    pub size: Size,
    /// Folder of KITTI 2015, to also score photographs with true flow
    #[arg(long, value_name = "DIR", conflicts_with = "pair")]
    pub kitti: Option<PathBuf>,
    /// Two photographs and the true flow between them
    #[arg(long, num_args = 3, value_names = ["FRAME1", "FRAME2", "FLOW"])]
    pub pair: Option<Vec<PathBuf>>,
    /// Open the report in the browser
    #[arg(long)]
    pub open: bool,
    /// Delete an existing demo and regenerate everything
    #[arg(long)]
    pub force: bool,
}

impl Default for DemoJob {
    fn default() -> Self {
        Self {
            out: "srflow-demo".into(),
            head: HeadSource::builtin(),
            seed: 5,
            size: FULL_SIZE,
            kitti: None,
            pair: None,
            open: false,
            force: false,
        }
    }
}

/// The paper scores 1200 by 1600 pixels around the head in frames of 2200 by 3208; other sizes use the same proportion.
fn paper_crop(size: Size) -> Size {
    let side = |side: usize, crop: usize, whole: usize| (side * crop / whole).max(1);
    Size::new(side(size.width, 1200, FULL_SIZE.width), side(size.height, 1600, FULL_SIZE.height))
}

impl Job for DemoJob {
    const NAME: &'static str = "demo";

    type Report = DemoReport;

    fn work(&self, watch: &Watch) -> anyhow::Result<DemoReport> {
        ensure_folder(&self.out)?;
        let report = self.out.join("report.html");
        ensure_free([&report], self.force)?;
        let photographs = photographs(self)?;
        let shown = [&[Method::DEFAULT][..], &Method::CLASSICAL].concat();
        let shown: Vec<MethodSpec> = shown.into_iter().map(MethodSpec::from).collect();
        let estimators = methods::estimators(&shown, &MethodParameters::default(), watch)?;

        let (stills_plan, clips_plan) = (datasets::stills(self.size), datasets::clips(self.size));
        // Both datasets and the action units show the same heads.
        let avatars = Avatars::keeping(datasets::HEADS as usize);
        let mut stages = Stages::of(if photographs.is_some() { 6 } else { 5 }, watch);
        let (stills, heads) = stages.run("Rendering three heads", || {
            let stills = stills_plan.render(&self.out, &self.head, &avatars, self.seed, self.force, watch)?;
            let heads = datasets::portraits(&stills)?;
            Ok((stills, heads))
        })?;
        let (clips, films) = stages.run("Rendering the heads in motion", || {
            let clips = clips_plan.render(&self.out, &self.head, &avatars, self.seed, self.force, watch)?;
            let films = datasets::films(&clips)?;
            Ok((clips, films))
        })?;
        let (gaussians, avatar, cards) = stages.run("Showing every action unit", || {
            let subject = stills.first_subject()?;
            let head = MovingHead::made(avatars.get(&self.head, subject)?, subject)?;
            let (cards, page) = rayon::join(
                || action_units::cards(&head.avatar, datasets::BACKGROUND),
                || Ok::<_, anyhow::Error>(head_page(&head, "The first head")?.html()),
            );
            Ok((head.avatar.bound().len(), page?, cards?))
        })?;
        let at_full_size = stages.run("Estimating and scoring at full size", || {
            score(&stills.dataset, &estimators, Some(paper_crop(self.size)), 3, watch)
        })?;
        let in_motion = stages.run("Estimating and scoring the heads in motion", || {
            score(&clips.dataset, &estimators, None, 12, watch)
        })?;
        let on_photographs = photographs
            .map(|dataset| {
                stages.run("Estimating and scoring photographs", || {
                    score(&dataset, &estimators, None, 2, watch)
                })
            })
            .transpose()?;

        for (evaluation, name) in
            [(&at_full_size.0, "scores-full-size.csv"), (&in_motion.0, "scores-in-motion.csv")]
        {
            write_file(&self.out.join(name), evaluation.csv())?;
        }
        let shown = page::Shown {
            heads,
            stills,
            clips,
            films,
            gaussians,
            avatar,
            cards,
            at_full_size,
            in_motion,
            on_photographs,
            commands: vec![
                stills_plan.command(&self.head, self.seed),
                clips_plan.command(&self.head, self.seed),
            ],
            machine: machine::describe(),
        };
        write_file(&report, page::page(&shown, &stages)?.html())?;
        if self.open {
            open(&report)?;
        }
        Ok(DemoReport {
            report,
            datasets: [shown.stills.dir, shown.clips.dir],
            stages: stages.done,
            evaluations: Evaluations {
                full_size: shown.at_full_size.0,
                in_motion: shown.in_motion.0,
                photographs: shown.on_photographs.map(|(evaluation, _)| evaluation),
            },
        })
    }
}

/// What [`DemoJob`] has made and measured.
#[derive(Debug, Clone, Serialize)]
pub struct DemoReport {
    /// The page that shows everything.
    pub report: PathBuf,
    /// Folders of the rendered datasets.
    pub datasets: [PathBuf; 2],
    pub stages: Vec<StageTime>,
    pub evaluations: Evaluations,
}

/// The scores of every method.
#[derive(Debug, Clone, Serialize)]
pub struct Evaluations {
    /// On the paper's crop of the large frames.
    pub full_size: Evaluation,
    /// On the heads in motion.
    pub in_motion: Evaluation,
    /// On photographs, where some were given.
    pub photographs: Option<Evaluation>,
}

impl Report for DemoReport {}

impl fmt::Display for DemoReport {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        for stage in &self.stages {
            writeln!(f, "{:>6.1} s  {}", stage.seconds, stage.name)?;
        }
        let seconds = stage::seconds(&self.stages);
        writeln!(f, "{seconds:>6.1} s  total\n\nThe report: {}", address(&self.report))
    }
}

/// The requested photographs; problems with them are reported before any work.
fn photographs(job: &DemoJob) -> anyhow::Result<Option<FlowDataset>> {
    if let Some(dir) = &job.kitti {
        if job.pair.is_some() {
            wrong_settings!("give `kitti` or `pair`, not both");
        }
        let spec = DatasetSpec { kind: "kitti-2015".to_owned(), dir: dir.clone() };
        return Ok(Some(FlowDataset::open(&spec, None)?));
    }
    let Some(pair) = &job.pair else { return Ok(None) };
    let [frame1, frame2, flow] = pair.as_slice() else {
        wrong_settings!("`pair`: expected two frames and their flow, found {} files", pair.len());
    };
    let dataset = FlowDataset::of_pair(frame1.clone(), frame2.clone(), flow.clone());
    dataset.entries().iter().try_for_each(|entry| dataset.read(entry).map(drop))?;
    Ok(Some(dataset))
}

fn score(
    dataset: &FlowDataset,
    estimators: &[Box<dyn FlowEstimator>],
    crop: Option<Size>,
    pairs: usize,
    watch: &Watch,
) -> anyhow::Result<(Evaluation, Vec<Figure>)> {
    let settings = Settings { crop, limit: Some(pairs), ..Settings::default() };
    let methods: Vec<_> =
        estimators.iter().map(|estimator| srflow_eval::Method::Estimator(estimator.as_ref())).collect();
    let mut figures = Vec::new();
    let evaluation = scoring::score(dataset, &methods, settings, pairs.min(3), watch, &mut |pair, shown| {
        if shown {
            figures.extend(pair_figures(pair, 380, "")?);
        }
        Ok(())
    })?;
    Ok((evaluation, figures))
}

/// The file as an address that a terminal makes clickable.
fn address(path: &Path) -> String {
    let whole = std::fs::canonicalize(path).unwrap_or_else(|_| path.to_owned());
    let text = whole.display().to_string();
    let text = text.strip_prefix(r"\\?\").unwrap_or(&text).replace('\\', "/").replace(' ', "%20");
    if text.starts_with('/') { format!("file://{text}") } else { format!("file:///{text}") }
}

/// Opens the file in the default browser.
fn open(path: &Path) -> anyhow::Result<()> {
    let program = match std::env::consts::OS {
        "macos" => "open",
        "windows" => "explorer",
        _ => "xdg-open",
    };
    let started = Command::new(program).arg(path).spawn();
    started.map(drop).with_context(|| format!("starting `{program}`; open {} yourself", path.display()))
}
