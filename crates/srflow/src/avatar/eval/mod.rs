//! Scores of avatars: their pictures, and how exact their flow is.

mod panels;

use std::fmt;
use std::path::{Path, PathBuf};
use std::str::FromStr;

use anyhow::Context as _;
use serde::{Deserialize, Serialize};
use srflow_avatar::capture::{Capture, CaptureSplit, CaptureView};
use srflow_avatar::train::{Scorer, SplitScore, TrainConfig, ViewScore, read_run, run_of_avatar};
use srflow_avatar::{Avatar, HeadSource};
use srflow_core::Color;
use srflow_core::random::Key;
use srflow_files::{create_folder, write_file};
use srflow_head::HeadPose;
use srflow_render::RenderError;
use srflow_render::capture::TrueCapture;
use srflow_render::label_error::{FlowPair, LabelError, PartError, TestedAvatar, flow_pairs};
use srflow_render::mesh_error::{MeshError, mesh_error};
use srflow_report::{Column, Row, Table};

use self::panels::{FlowPanels, Panels, PicturePanels};
use super::scores::{camera_table, mesh_table, split_table, split_words};
use crate::clap::Args;
use crate::error::wrong_settings;
use crate::output::{ensure_folder, ensure_free, write_page, write_tables};
use crate::{Job, Report, Watch};

/// Score a trained avatar on its capture: its pictures, and how exact its flow is
///
/// Pictures are compared with those of the capture: PSNR of the whole picture, as in GaussianAvatars' metrics.py; PSNR as the mean over
/// the channels, as in its train.py and its paper; SSIM.
///
/// With --flow, the flow that `srflow render` would write for the avatar is compared with that of the true head, and its mesh with the
/// true one, for captures of `srflow avatar capture`, whose heads can be made again.
#[derive(Args, Debug, Clone, PartialEq, Serialize, Deserialize)]
#[command(after_help = "\
Examples:
  srflow avatar eval runs/first capture
  srflow avatar eval runs/first capture --flow --step 1 2 5 --out scores
  srflow avatar eval runs/fitted fitted --flow --truth capture
  srflow avatar eval avatar@flame:flame2023.pkl person --split test --json

docs/explanation/avatars.md defines the scores.")]
pub struct EvalJob {
    /// Folder of the avatar or of its training; DIR@HEAD if it has no head.json
    #[arg(value_name = "AVATAR")]
    pub avatar: AvatarSource,
    /// Folder of the avatar's training capture
    #[arg(value_name = "CAPTURE")]
    pub capture: PathBuf,
    /// Pictures to score: val (held-out camera), test (held-out timesteps), train
    #[arg(long, value_name = "SPLIT", num_args = 1.., value_delimiter = ',', default_values_t = default_splits())]
    #[serde(default = "default_splits")]
    pub split: Vec<CaptureSplit>,
    /// Also compare the avatar's flow and mesh with the true ones
    #[arg(long)]
    #[serde(default)]
    pub flow: bool,
    /// Timesteps between the two pictures of a pair
    #[arg(long, value_name = "N", requires = "flow", num_args = 1.., value_delimiter = ',', default_values_t = default_steps(), value_parser = clap::value_parser!(u32).range(1..))]
    #[serde(default = "default_steps")]
    pub step: Vec<u32>,
    /// Original capture with the true head, if CAPTURE is a fit of it [default: CAPTURE]
    #[arg(long, value_name = "DIR", requires = "flow")]
    #[serde(default)]
    pub truth: Option<PathBuf>,
    /// Score N random pictures of each split and N random pairs of each split and step, the same in every run
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..))]
    #[serde(default)]
    pub limit: Option<u32>,
    /// Colour behind the head in the pictures: white, black, #rrggbb or R,G,B (0 to 255 each) [default: that of the training, if
    /// AVATAR is one, else white]
    #[arg(long, value_name = "COLOUR")]
    #[serde(default)]
    pub background: Option<Color>,
    /// Ignore principal points and use one focal length, as GaussianAvatars does; on if the training did
    #[arg(long)]
    #[serde(default)]
    pub faithful: bool,
    /// Sort the Gaussians at each pixel; on if the training did
    #[arg(long)]
    #[serde(default)]
    pub sort_per_pixel: bool,
    /// Also write eval.json, report.html and pictures into this folder
    #[arg(short, long, value_name = "DIR")]
    #[serde(default)]
    pub out: Option<PathBuf>,
    /// Overwrite these files
    #[arg(long)]
    #[serde(default)]
    pub force: bool,
}

fn default_splits() -> Vec<CaptureSplit> {
    vec![CaptureSplit::Val, CaptureSplit::Test]
}

fn default_steps() -> Vec<u32> {
    vec![1]
}

/// An avatar in a folder, written `DIR` or `DIR@HEAD`, with or without `avatar:` in front.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct AvatarSource(HeadSource);

impl FromStr for AvatarSource {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let source =
            if text.starts_with("avatar:") { text.parse() } else { format!("avatar:{text}").parse() };
        source.map(Self).map_err(|_| "expected the folder of an avatar".to_owned())
    }
}

impl fmt::Display for AvatarSource {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        self.0.fmt(f)
    }
}

srflow_core::serialize_as_text!(AvatarSource);

/// The scores of an avatar, as in `eval.json`.
#[derive(Debug, Clone, Serialize)]
pub struct EvalReport {
    pub version: &'static str,
    pub avatar: String,
    pub capture: PathBuf,
    pub gaussians: usize,
    pub pictures: Vec<SplitScore>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub flow: Option<FlowScores>,
    #[serde(skip)]
    out: Option<PathBuf>,
}

/// Errors of the flow, by split and step.
#[derive(Debug, Clone, Serialize)]
pub struct FlowScores {
    /// The capture whose head is the true one.
    pub truth: PathBuf,
    /// `None` where the true head has another mesh.
    pub mesh: Option<MeshError>,
    pub results: Vec<FlowResult>,
}

/// Errors of the flow of the pairs of one split that are as many timesteps apart.
#[derive(Debug, Clone, Serialize)]
pub struct FlowResult {
    pub split: CaptureSplit,
    /// Timesteps between the two pictures of a pair.
    pub step: u32,
    #[serde(flatten)]
    pub error: LabelError,
}

const JSON_NAME: &str = "eval.json";
const REPORT_NAME: &str = "report.html";
const PANELS_FOLDER: &str = "panels";

/// Pairs of each split and step that are shown as pictures.
const SHOWN_PAIRS: usize = 3;

impl Job for EvalJob {
    const NAME: &'static str = "avatar eval";

    type Report = EvalReport;

    fn work(&self, watch: &Watch) -> anyhow::Result<EvalReport> {
        if let Some(out) = &self.out {
            ensure_folder(out)?;
            ensure_free([JSON_NAME, REPORT_NAME, PANELS_FOLDER].map(|name| out.join(name)), self.force)?;
        }
        if self.step.contains(&0) {
            wrong_settings!("`step` 0: expected 1 timestep or more");
        }
        let mut job = self.clone();
        job.split.sort_unstable();
        job.split.dedup();
        job.step.sort_unstable();
        job.step.dedup();
        job.evaluate(watch)
    }
}

impl EvalJob {
    /// Scores the avatar; splits and steps are sorted.
    fn evaluate(&self, watch: &Watch) -> anyhow::Result<EvalReport> {
        let capture = Capture::read(&self.capture)?;
        let truth_dir = self.truth.as_ref().unwrap_or(&self.capture);
        let truth = self.flow.then(|| TrueCapture::read(truth_dir)).transpose()?;
        let pair_sets = if self.flow { self.pair_sets(&capture)? } else { Vec::new() };
        let avatar = self.avatar.0.avatar(0).with_context(|| format!("reading {}", self.avatar))?;
        let poses = capture.poses_of(&avatar)?;

        let config = self.configuration()?;
        let mut panels = Panels::default();
        let pictures = self.picture_scores(&config, &capture, &avatar, &poses, &mut panels, watch)?;
        let flow = match &truth {
            None => None,
            Some(truth) => {
                let (options, faithful) = (config.rendering(), config.faithful);
                let tested = TestedAvatar {
                    avatar: &avatar,
                    poses: &poses,
                    capture: &capture,
                    truth,
                    options,
                    faithful,
                };
                Some(FlowScores {
                    truth: truth_dir.clone(),
                    mesh: mesh_error(truth, &capture, avatar.model(), avatar.shaped(), &poses),
                    results: self.flow_errors(&pair_sets, &tested, &mut panels, watch)?,
                })
            }
        };
        let report = EvalReport {
            version: env!("CARGO_PKG_VERSION"),
            avatar: self.avatar.to_string(),
            capture: self.capture.clone(),
            gaussians: avatar.bound().len(),
            pictures,
            flow,
            out: self.out.clone(),
        };
        if let Some(out) = &self.out {
            write(out, &report, &panels)?;
        }
        Ok(report)
    }

    /// How the avatar is rendered and pictures are read: as in its training, if it is in the folder of one.
    fn configuration(&self) -> anyhow::Result<TrainConfig> {
        let files = self.avatar.0.paths();
        let folder = files.first().and_then(|file| file.parent());
        let mut config = match folder.and_then(run_of_avatar) {
            Some(run) => read_run(run)?.1,
            None => TrainConfig::default(),
        };
        if let Some(Color(background)) = self.background {
            config.background = background.map(|channel| f32::from(channel) / 255.0);
        }
        config.faithful |= self.faithful;
        config.sort_per_pixel |= self.sort_per_pixel;
        Ok(config)
    }

    fn picture_scores(
        &self,
        config: &TrainConfig,
        capture: &Capture,
        avatar: &Avatar,
        poses: &[HeadPose],
        panels: &mut Panels,
        watch: &Watch,
    ) -> anyhow::Result<Vec<SplitScore>> {
        let mut scorer = Scorer::new(*config);
        let timesteps = capture.timesteps();
        let pose = |view: &CaptureView| &poses[view.timestep_place(&timesteps)];
        let views: Vec<(CaptureSplit, Vec<&CaptureView>)> =
            self.split.iter().map(|&split| (split, drawn(capture.of(split).collect(), self.limit))).collect();
        let all: usize = views.iter().map(|(_, views)| views.len()).sum();
        let count = watch.count("pictures", all as u64);
        let mut splits = Vec::new();
        for (split, views) in views {
            let mut scores = Vec::new();
            for view in &views {
                scores.push(ViewScore::new(view, scorer.score(avatar, pose(view), capture, view)?));
                count.inc();
            }
            let Some(split) = SplitScore::of(split, &scores) else { continue };
            if self.out.is_some() {
                for (word, shown) in [("worst", &split.worst), ("best", &split.best)] {
                    let is_shown = |view: &&&CaptureView| {
                        (view.timestep, view.camera_index) == (shown.timestep, shown.camera)
                    };
                    let Some(view) = views.iter().find(is_shown) else { continue };
                    scorer.score(avatar, pose(view), capture, view)?;
                    let size = view.camera.size();
                    panels.pictures.push(PicturePanels::new(split.split, word, shown, size, &scorer));
                }
            }
            splits.push(split);
        }
        if splits.is_empty() {
            wrong_settings!(
                "`split` {}: the capture has no such pictures, but {} for training",
                self.split.iter().map(ToString::to_string).collect::<Vec<_>>().join(","),
                capture.of(CaptureSplit::Train).count()
            );
        }
        Ok(splits)
    }

    /// The pairs to compare.
    fn pair_sets(&self, capture: &Capture) -> anyhow::Result<Vec<PairSet>> {
        let mut sets: Vec<PairSet> = Vec::new();
        for &split in &self.split {
            for &step in &self.step {
                let pairs = drawn(flow_pairs(capture, split, step), self.limit);
                sets.extend((!pairs.is_empty()).then_some(PairSet { split, step, pairs }));
            }
        }
        if sets.is_empty() {
            wrong_settings!(
                "`step` {:?}: one camera has no two pictures of a split so many timesteps apart; the capture has {} timesteps",
                self.step,
                capture.timesteps().len()
            );
        }
        Ok(sets)
    }

    fn flow_errors(
        &self,
        sets: &[PairSet],
        tested: &TestedAvatar,
        panels: &mut Panels,
        watch: &Watch,
    ) -> anyhow::Result<Vec<FlowResult>> {
        let all: usize = sets.iter().map(|set| set.pairs.len()).sum();
        let count = watch.count("pairs", all as u64);
        let mut results = Vec::new();
        for &PairSet { split, step, ref pairs } in sets {
            let shown: Vec<usize> =
                (0..SHOWN_PAIRS).map(|part| (2 * part + 1) * pairs.len() / (2 * SHOWN_PAIRS)).collect();
            let mut place = 0;
            let error = tested.label_error(pairs, |pair, flows| {
                if self.out.is_some() && shown.contains(&place) {
                    panels.flows.push(FlowPanels::new(split, step, *pair, flows));
                }
                place += 1;
                count.inc();
            });
            let error = error.map_err(|error| match error {
                RenderError::NoTruth { .. } if self.truth.is_some() => {
                    anyhow::Error::new(error).context("`truth`")
                }
                error => error.into(),
            })?;
            results.push(FlowResult { split, step, error });
        }
        Ok(results)
    }
}

/// `limit` of the items at random, in their order.
fn drawn<T>(mut items: Vec<T>, limit: Option<u32>) -> Vec<T> {
    let limit = limit.map_or(items.len(), |limit| limit as usize).min(items.len());
    let mut places: Vec<usize> = (0..items.len()).collect();
    Key::new(0).stream("drawn for scores").shuffle(&mut places);
    let mut is_drawn = vec![false; items.len()];
    places[..limit].iter().for_each(|&place| is_drawn[place] = true);
    let mut is_drawn = is_drawn.into_iter();
    items.retain(|_| is_drawn.next().unwrap_or(false));
    items
}

/// Pairs of one split that are as many timesteps apart.
struct PairSet {
    split: CaptureSplit,
    step: u32,
    pairs: Vec<FlowPair>,
}

fn write(out: &Path, report: &EvalReport, panels: &Panels) -> anyhow::Result<()> {
    let folder = out.join(PANELS_FOLDER);
    create_folder(&folder)?;
    panels.write(&folder)?;
    write_file(&out.join(JSON_NAME), serde_json::to_string_pretty(report)? + "\n")?;
    write_file(
        &out.join(REPORT_NAME),
        panels.page(&picture_tables(report), &flow_tables(report), &lead(report))?.html(),
    )?;
    Ok(())
}

fn lead(report: &EvalReport) -> String {
    format!("{} ({} Gaussians) on the capture {}.", report.avatar, report.gaussians, report.capture.display())
}

impl Report for EvalReport {}

impl fmt::Display for EvalReport {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        writeln!(f, "{}\n", lead(self))?;
        write_tables(f, &picture_tables(self))?;
        for split in &self.pictures {
            let view = |view: &ViewScore| {
                format!("timestep {} of camera {} ({:.2} dB)", view.timestep, view.camera, view.score.psnr)
            };
            writeln!(f, "{}: best {}, worst {}", split.split, view(&split.best), view(&split.worst))?;
        }
        let flow = flow_tables(self);
        if !flow.is_empty() {
            writeln!(f)?;
            write_tables(f, &flow)?;
        }
        if let Some(out) = &self.out {
            write_page(f, &out.join(REPORT_NAME))?;
        }
        Ok(())
    }
}

/// A table of all splits, and one for each split of several cameras.
fn picture_tables(report: &EvalReport) -> Vec<Table> {
    let several = report.pictures.iter().filter(|split| split.cameras.len() > 1);
    std::iter::once(split_table(&report.pictures)).chain(several.map(camera_table)).collect()
}

/// A table for each split and step, and one of the mesh.
fn flow_tables(report: &EvalReport) -> Vec<Table> {
    let results = report.flow.iter().flat_map(|flow| &flow.results);
    let mut tables: Vec<Table> = results.map(flow_table).collect();
    if let Some(last) = tables.last_mut() {
        last.notes = vec![
            "Pixels of the true head's mask, without those that the avatar misses: its alpha is not above one half.".to_owned(),
            "The error of zero flow is the mean length of the true flow.".to_owned(),
            "Seen through: the avatar is more than 10 mm behind the true surface.".to_owned(),
        ];
    }
    tables.extend(report.flow.iter().filter_map(|flow| flow.mesh.as_ref()).map(mesh_table));
    tables
}

fn flow_table(result: &FlowResult) -> Table {
    let FlowResult { split, step, error } = result;
    let row = |(name, part): (&str, &PartError)| {
        let of_errors = part.errors.as_ref().map(|errors| {
            [errors.mean, errors.median, errors.percentile_95, 100.0 * errors.over_1_px, errors.true_length]
        });
        let errors = of_errors.map_or([None; 5], |errors| errors.map(Some));
        let of_pixels = |count: u64| (part.pixels > 0).then(|| 100.0 * count as f64 / part.pixels as f64);
        let share = 100.0 * part.pixels as f64 / error.head.pixels.max(1) as f64;
        let counts = [of_pixels(part.missing), of_pixels(part.seen_through)];
        let values = [Some(share)].into_iter().chain(errors).chain(counts).collect();
        Row { name: name.to_owned(), values, baseline: false }
    };
    let timesteps = if *step == 1 { "1 timestep".to_owned() } else { format!("{step} timesteps") };
    Table {
        title: format!(
            "End-point error of the flow over {timesteps}, {} ({split}), pairs: {}",
            split_words(*split),
            error.pairs
        ),
        columns: vec![
            Column::plain("share", "% of head", 1),
            Column::plain("mean", "mean, px", 3),
            Column::plain("median", "median", 3),
            Column::plain("percentile_95", "95 %", 3),
            Column::plain("over_1_px", "% over 1 px", 2),
            Column::plain("true_length", "zero flow", 3),
            Column::plain("missing", "% missing", 2),
            Column::plain("seen_through", "% seen through", 2),
        ],
        rows: error.parts().into_iter().map(row).collect(),
        ..Table::default()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn as_many_as_asked_for_are_drawn_in_order() {
        let all: Vec<u32> = (0..50).collect();
        assert_eq!(drawn(all.clone(), None), all);
        assert_eq!(drawn(all.clone(), Some(90)), all);
        let some = drawn(all, Some(7));
        assert!(
            some.len() == 7 && some.is_sorted() && some.windows(2).any(|two| two[1] - two[0] != 7),
            "{some:?}"
        );
    }

    #[test]
    fn an_avatar_is_named_by_its_folder_or_as_a_head() {
        for text in ["runs/a", "avatar:runs/a", "runs/a@builtin"] {
            assert_eq!(
                text.parse::<AvatarSource>().unwrap().to_string().trim_start_matches("avatar:"),
                text.trim_start_matches("avatar:")
            );
        }
        assert!("".parse::<AvatarSource>().is_err() && "avatar:".parse::<AvatarSource>().is_err());
    }
}
