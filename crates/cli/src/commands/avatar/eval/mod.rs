mod panels;

use std::path::{Path, PathBuf};

use anyhow::Context as _;
use clap::Args;
use serde::Serialize;
use srflow_avatar::capture::{Capture, CaptureSplit, CaptureView};
use srflow_avatar::train::{Scorer, SplitScore, TrainConfig, ViewScore, read_run, run_of_avatar};
use srflow_avatar::{Avatar, HeadPose, HeadSource};
use srflow_core::parse_color;
use srflow_core::random::Key;
use srflow_eval::{Column, Row, Table};
use srflow_files::{create_folder, write_file};
use srflow_render::RenderError;
use srflow_render::capture::TrueCapture;
use srflow_render::label_error::{FlowPair, LabelError, PartError, TestedAvatar, flow_pairs};
use srflow_render::mesh_error::{MeshError, mesh_error};

use super::scores::{camera_table, mesh_table, split_table, split_words};
use crate::Context;
use crate::output::{ensure_folder, ensure_free, print_json, print_tables};
use crate::progress::bar;
use crate::usage::wrong_usage;
use panels::{FlowPanels, Panels, PicturePanels};

/// Score a trained avatar on its capture: its pictures, and how exact its flow is
///
/// Pictures are compared with those of the capture: PSNR of the whole picture, as in GaussianAvatars' metrics.py; PSNR as the mean over
/// the channels, as in its train.py and its paper; SSIM.
///
/// With --flow, the flow that `srflow render` would write for the avatar is compared with that of the true head, and its mesh with the
/// true one, for captures of `srflow avatar capture`, whose heads can be made again.
#[derive(Args)]
#[command(after_help = "\
Examples:
  srflow avatar eval runs/first capture
  srflow avatar eval runs/first capture --flow --step 1 2 5 --out scores
  srflow avatar eval runs/fitted fitted --flow --truth capture
  srflow avatar eval avatar@flame:flame2023.pkl person --split test --json

docs/explanation/avatars.md defines the scores.")]
pub struct Eval {
    /// Folder of the avatar, or of its training; DIR@HEAD where no head.json names its head model
    #[arg(value_name = "AVATAR", value_parser = avatar_source)]
    avatar: HeadSource,
    /// Folder of the capture that it was trained on
    #[arg(value_name = "CAPTURE")]
    capture: PathBuf,
    /// Pictures to score: val (held-out camera), test (held-out timesteps), train
    #[arg(long, value_name = "SPLIT", num_args = 1.., value_delimiter = ',', default_values = ["val", "test"])]
    split: Vec<CaptureSplit>,
    /// Also compare the avatar's flow and mesh with the true ones
    #[arg(long)]
    flow: bool,
    /// Timesteps between the two pictures of a pair
    #[arg(long, value_name = "N", requires = "flow", num_args = 1.., value_delimiter = ',', default_values = ["1"], value_parser = clap::value_parser!(u32).range(1..))]
    step: Vec<u32>,
    /// The capture whose head is the true one, if CAPTURE was fitted to its pictures [default: CAPTURE]
    #[arg(long, value_name = "DIR", requires = "flow")]
    truth: Option<PathBuf>,
    /// Score N pictures of each split and N pairs of each split and step, drawn at random, the same in every run
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..))]
    limit: Option<u32>,
    /// Colour behind the head in the pictures: white, black, #rrggbb or R,G,B (0 to 255 each) [default: that of the training, if
    /// AVATAR is one, else white]
    #[arg(long, value_name = "COLOUR", value_parser = parse_color)]
    background: Option<[u8; 3]>,
    /// Cameras without a principal point and with one focal length, as GaussianAvatars takes them; known of a training
    #[arg(long)]
    faithful: bool,
    /// The Gaussians are sorted at each pixel; known of a training
    #[arg(long)]
    sort_per_pixel: bool,
    /// Also write eval.json, report.html and pictures into this folder
    #[arg(short, long, value_name = "DIR")]
    out: Option<PathBuf>,
    /// Overwrite these files
    #[arg(long)]
    force: bool,
}

fn avatar_source(text: &str) -> Result<HeadSource, String> {
    let source = if text.starts_with("avatar:") { text.parse() } else { format!("avatar:{text}").parse() };
    source.map_err(|_| "expected the folder of an avatar".to_owned())
}

/// What `eval.json` and `--json` hold.
#[derive(Serialize)]
struct Summary {
    version: &'static str,
    avatar: String,
    capture: PathBuf,
    gaussians: usize,
    pictures: Vec<SplitScore>,
    #[serde(skip_serializing_if = "Option::is_none")]
    flow: Option<FlowSummary>,
}

/// Errors of the flow, by split and step.
#[derive(Serialize)]
struct FlowSummary {
    /// The capture whose head is the true one.
    truth: PathBuf,
    /// `None` where the true head has another mesh.
    mesh: Option<MeshError>,
    results: Vec<FlowResult>,
}

#[derive(Serialize)]
struct FlowResult {
    split: CaptureSplit,
    /// Timesteps between the two pictures of a pair.
    step: u32,
    #[serde(flatten)]
    error: LabelError,
}

const JSON_NAME: &str = "eval.json";
const REPORT_NAME: &str = "report.html";
const PANELS_FOLDER: &str = "panels";

/// Pairs of each split and step that are shown as pictures.
const SHOWN_PAIRS: usize = 3;

pub fn run(mut args: Eval, context: &Context) -> anyhow::Result<()> {
    if let Some(out) = &args.out {
        ensure_folder(out)?;
        ensure_free([JSON_NAME, REPORT_NAME, PANELS_FOLDER].map(|name| out.join(name)), args.force)?;
    }
    args.split.sort_unstable();
    args.split.dedup();
    args.step.sort_unstable();
    args.step.dedup();
    let capture = Capture::read(&args.capture)?;
    let truth_dir = args.truth.as_ref().unwrap_or(&args.capture);
    let truth = args.flow.then(|| TrueCapture::read(truth_dir)).transpose()?;
    let pair_sets = if args.flow { pair_sets(&args, &capture)? } else { Vec::new() };
    let avatar = args.avatar.avatar(0).with_context(|| format!("reading {}", args.avatar))?;
    let poses = capture.poses_of(&avatar)?;

    let config = configuration(&args)?;
    let mut panels = Panels::default();
    let pictures = picture_scores(&args, &config, &capture, &avatar, &poses, &mut panels)?;
    let flow = match &truth {
        None => None,
        Some(truth) => {
            let (options, faithful) = (config.rendering(), config.faithful);
            let tested =
                TestedAvatar { avatar: &avatar, poses: &poses, capture: &capture, truth, options, faithful };
            Some(FlowSummary {
                truth: truth_dir.clone(),
                mesh: mesh_error(truth, &capture, avatar.model(), avatar.shaped(), &poses),
                results: flow_errors(&args, &pair_sets, &tested, &mut panels)?,
            })
        }
    };
    let summary = Summary {
        version: env!("CARGO_PKG_VERSION"),
        avatar: args.avatar.to_string(),
        capture: args.capture,
        gaussians: avatar.bound().len(),
        pictures,
        flow,
    };
    if let Some(out) = &args.out {
        write(out, &summary, &panels)?;
    }
    if context.json { print_json(&summary) } else { print_summary(&summary, args.out.as_deref()) }
}

/// How the avatar is rendered and pictures are read: as in its training, if it is in the folder of one.
fn configuration(args: &Eval) -> anyhow::Result<TrainConfig> {
    let files = args.avatar.paths();
    let folder = files.first().and_then(|file| file.parent());
    let mut config = match folder.and_then(run_of_avatar) {
        Some(run) => read_run(run)?.1,
        None => TrainConfig::default(),
    };
    if let Some(background) = args.background {
        config.background = background.map(|channel| f32::from(channel) / 255.0);
    }
    config.faithful |= args.faithful;
    config.sort_per_pixel |= args.sort_per_pixel;
    Ok(config)
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

fn picture_scores(
    args: &Eval,
    config: &TrainConfig,
    capture: &Capture,
    avatar: &Avatar,
    poses: &[HeadPose],
    panels: &mut Panels,
) -> anyhow::Result<Vec<SplitScore>> {
    let mut scorer = Scorer::new(*config);
    let timesteps = capture.timesteps();
    let pose = |view: &CaptureView| &poses[view.timestep_place(&timesteps)];
    let views: Vec<(CaptureSplit, Vec<&CaptureView>)> =
        args.split.iter().map(|&split| (split, drawn(capture.of(split).collect(), args.limit))).collect();
    let progress = bar(
        views.iter().map(|(_, views)| views.len() as u64).sum::<u64>(),
        "pictures {bar:30} {pos}/{len}, {eta}",
    );
    let mut splits = Vec::new();
    for (split, views) in views {
        let mut scores = Vec::new();
        for view in &views {
            scores.push(ViewScore::new(view, scorer.score(avatar, pose(view), capture, view)?));
            progress.inc(1);
        }
        let Some(split) = SplitScore::of(split, &scores) else { continue };
        if args.out.is_some() {
            for (word, shown) in [("worst", &split.worst), ("best", &split.best)] {
                let of_score = |view: &&&CaptureView| {
                    (view.timestep, view.camera_index) == (shown.timestep, shown.camera)
                };
                let Some(view) = views.iter().find(of_score) else { continue };
                scorer.score(avatar, pose(view), capture, view)?;
                let size = (view.camera.width, view.camera.height);
                panels.pictures.push(PicturePanels::new(split.split, word, shown, size, &scorer));
            }
        }
        splits.push(split);
    }
    progress.finish_and_clear();
    if splits.is_empty() {
        wrong_usage!(
            "--split {}: the capture has no such pictures, but {} for training",
            args.split.iter().map(ToString::to_string).collect::<Vec<_>>().join(","),
            capture.of(CaptureSplit::Train).count()
        );
    }
    Ok(splits)
}

/// Pairs of one split that are as many timesteps apart.
struct PairSet {
    split: CaptureSplit,
    step: u32,
    pairs: Vec<FlowPair>,
}

/// The pairs to compare.
fn pair_sets(args: &Eval, capture: &Capture) -> anyhow::Result<Vec<PairSet>> {
    let mut sets: Vec<PairSet> = Vec::new();
    for &split in &args.split {
        for &step in &args.step {
            let pairs = drawn(flow_pairs(capture, split, step), args.limit);
            sets.extend((!pairs.is_empty()).then_some(PairSet { split, step, pairs }));
        }
    }
    if sets.is_empty() {
        wrong_usage!(
            "--step {:?}: one camera has no two pictures of a split so many timesteps apart; the capture has {} timesteps",
            args.step,
            capture.timesteps().len()
        );
    }
    Ok(sets)
}

fn flow_errors(
    args: &Eval,
    sets: &[PairSet],
    tested: &TestedAvatar,
    panels: &mut Panels,
) -> anyhow::Result<Vec<FlowResult>> {
    let progress =
        bar(sets.iter().map(|set| set.pairs.len() as u64).sum::<u64>(), "flow {bar:30} {pos}/{len}, {eta}");
    let mut results = Vec::new();
    for &PairSet { split, step, ref pairs } in sets {
        let shown: Vec<usize> =
            (0..SHOWN_PAIRS).map(|part| (2 * part + 1) * pairs.len() / (2 * SHOWN_PAIRS)).collect();
        let mut place = 0;
        let error = tested.label_error(pairs, |pair, flows| {
            if args.out.is_some() && shown.contains(&place) {
                panels.flows.push(FlowPanels::new(split, step, *pair, flows));
            }
            place += 1;
            progress.inc(1);
        });
        let error = error.map_err(|error| match error {
            RenderError::NoTruth { .. } if args.truth.is_some() => {
                anyhow::Error::new(error).context("--truth")
            }
            error => error.into(),
        })?;
        results.push(FlowResult { split, step, error });
    }
    progress.finish_and_clear();
    Ok(results)
}

fn write(out: &Path, summary: &Summary, panels: &Panels) -> anyhow::Result<()> {
    let folder = out.join(PANELS_FOLDER);
    create_folder(&folder)?;
    panels.write(&folder)?;
    write_file(&out.join(JSON_NAME), serde_json::to_string_pretty(summary)? + "\n")?;
    write_file(
        &out.join(REPORT_NAME),
        panels.page(&picture_tables(summary), &flow_tables(summary), &lead(summary))?.html(),
    )?;
    Ok(())
}

fn lead(summary: &Summary) -> String {
    format!(
        "{} ({} Gaussians) on the capture {}.",
        summary.avatar,
        summary.gaussians,
        summary.capture.display()
    )
}

fn print_summary(summary: &Summary, out: Option<&Path>) -> anyhow::Result<()> {
    say!("{}\n", lead(summary))?;
    print_tables(&picture_tables(summary))?;
    for split in &summary.pictures {
        let view = |view: &ViewScore| {
            format!("timestep {} of camera {} ({:.2} dB)", view.timestep, view.camera, view.score.psnr)
        };
        say!("{}: best {}, worst {}", split.split, view(&split.best), view(&split.worst))?;
    }
    let flow = flow_tables(summary);
    if !flow.is_empty() {
        say!("")?;
        print_tables(&flow)?;
    }
    if let Some(out) = out {
        say!("\nReport: {}", out.join(REPORT_NAME).display())?;
    }
    Ok(())
}

/// A table of all splits, and one for each split of several cameras.
fn picture_tables(summary: &Summary) -> Vec<Table> {
    let several = summary.pictures.iter().filter(|split| split.cameras.len() > 1);
    std::iter::once(split_table(&summary.pictures)).chain(several.map(camera_table)).collect()
}

/// A table for each split and step, and one of the mesh.
fn flow_tables(summary: &Summary) -> Vec<Table> {
    let results = summary.flow.iter().flat_map(|flow| &flow.results);
    let mut tables: Vec<Table> = results.map(flow_table).collect();
    if let Some(last) = tables.last_mut() {
        last.notes = vec![
            "Pixels of the true head's mask, without those that the avatar misses: its alpha is not above one half.".to_owned(),
            "The error of zero flow is the mean length of the true flow.".to_owned(),
            "Seen through: the avatar is more than 10 mm behind the true surface.".to_owned(),
        ];
    }
    tables.extend(summary.flow.iter().filter_map(|flow| flow.mesh.as_ref()).map(mesh_table));
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
        notes: Vec::new(),
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
                avatar_source(text).unwrap().to_string().trim_start_matches("avatar:"),
                text.trim_start_matches("avatar:")
            );
        }
        assert!(avatar_source("").is_err() && avatar_source("avatar:").is_err());
    }
}
