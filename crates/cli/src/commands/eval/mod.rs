mod kept;

use std::collections::{BTreeMap, BTreeSet};
use std::num::NonZeroUsize;
use std::path::{Path, PathBuf};

use anyhow::bail;
use clap::Args;
use clap::builder::ArgPredicate;
use serde::Serialize;
use srflow_core::{Shard, Size};
use srflow_eval::report::{Figure, pair_figures, score_report};
use srflow_eval::{
    Evaluation, Method, MethodRecord, OnFailure, ScoredPair, Settings, TextStyle, Window, joined,
    markdown_file, scored_pairs, window_about,
};
use srflow_face::FaceBox;
use srflow_figure::{Content, Pair, Plan, Scale, Scales, Source as Flow, Style};
use srflow_files::{create_folder, write_file};
use srflow_read::flow::{DatasetSpec, FlowDataset, KINDS, Split};

use self::kept::Kept;
use crate::face::FaceArgs;
use crate::interrupt::Continuable;
use crate::methods::{self, MethodParameters, MethodSpec, Rows, RowsArgs, Source};
use crate::opening::open_dataset;
use crate::output::{ensure_folder, ensure_free, latex, print_tables};
use crate::progress::bar;
use crate::rendering::{Rendered, ShardArgs};
use crate::scoring::{self, folder_name, save_flows};
use crate::usage::wrong_usage;
use crate::{Context, in_words, machine};

fn kinds_help() -> String {
    let lines: Vec<String> = KINDS.iter().map(|kind| format!("  {kind}\n      {}", kind.about)).collect();
    lines.join("\n")
}

/// Score estimators over a dataset and print the table
#[derive(Args)]
#[command(after_help = format!("\
Scores are those of the SRFlow paper's Table II: computed per pair over the pixels with ground truth, then averaged over \
pairs; also inside the head's mask and outside occlusions where the dataset has them. The baseline `zero` is zero flow.

files:DIR scores flow files of another program: one file per pair, DIR/SCENE/FRAME.EXT (DIR/FRAME.EXT where pairs have no \
scene), in any flow format; docs/reference/datasets.md lists the names for each dataset. --save-flow DIR writes the flow of each method in \
this layout, into DIR/METHOD.

With --out, scores are kept until all are there: the same command continues a run that was ended, and with --shard several processes \
score parts into one shared folder, after which the command without it writes the tables.

Examples:
  srflow eval --dataset srflow:srflow --method farneback tvl1 --crop 1200x1600 --out scores
  srflow eval --dataset srflow:srflow --method farneback tvl1 --regions --small-motion 0.5
  srflow eval --dataset sintel-clean:/data/Sintel --method skflow=skflow-things.ckpt raft=raft.pth raft=mine.pth --iters 12
  srflow eval --dataset sintel-clean:/data/Sintel --method tvl1 Theirs:files:out/theirs --save-flow flows

Kinds of dataset:
{}", kinds_help()))]
pub struct Eval {
    /// Kind of dataset and its folder, e.g. sintel-clean:/data/Sintel
    #[arg(long, value_name = "KIND:DIR")]
    dataset: DatasetSpec,
    /// Split: train, val, test or all [default: the one that results are usually reported on]
    #[arg(long)]
    split: Option<Split>,
    /// Methods to score
    #[arg(long, value_name = "METHOD", default_value = methods::Method::DEFAULT.name(), default_value_if("rows", ArgPredicate::IsPresent, None), num_args = 1.., value_delimiter = ',', value_parser = methods::scored_method, help = methods::Method::help_of_several("Methods to score"))]
    method: Vec<MethodSpec>,
    /// Crop that is estimated and scored, centred on the head (without a mask, on the frame)
    #[arg(long, value_name = "WIDTHxHEIGHT")]
    crop: Option<Size>,
    /// Score only N pairs, spread evenly over the dataset
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..))]
    limit: Option<u32>,
    /// Pairs that a network estimates at once, if they follow each other and have one size; scores do not change, and each
    /// pair's time is an equal share of the batch's
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = clap::value_parser!(u16).range(1..=1024))]
    batch: u16,
    /// Also score skin, eyes, mouth, hair, neck, the rim of the head (the 3 px beside the background; no other region contains
    /// them) and the background, by the region maps of `srflow render --regions`
    #[arg(long)]
    regions: bool,
    /// Also score the pixels whose true flow is shorter than this, e.g. 0.5; of the head, where there are masks
    #[arg(long, value_name = "PIXELS", allow_negative_numbers = true, value_parser = super::convert::positive)]
    small_motion: Option<f32>,
    /// Also score the motion that remains inside the head (without a mask, in the frame) when that of the head, its best affine
    /// fit, is taken away from the estimated and the true flow: the correlation of the two, and how strong the estimated one is
    #[arg(long)]
    expression: bool,
    /// Leave out pairs that cannot be scored, for every method, and continue; the exit code is still 1
    #[arg(long)]
    keep_going: bool,
    /// Also write scores.{txt,csv,json,tex,md}, pairs.csv and report.html into this folder
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
    /// Also write the flow of each method and pair, as DIR/METHOD/SCENE/FRAME.flo
    #[arg(long, value_name = "DIR")]
    save_flow: Option<PathBuf>,
    /// Also write a figure for a paper into this folder: figure.svg, figure.pdf, and its panels as PNGs of full size; `srflow figure`
    /// makes others
    #[arg(long, value_name = "DIR")]
    figure: Option<PathBuf>,
    /// Pairs in the figure, by their names in pairs.csv [default: 4, spread evenly]
    #[arg(long, value_name = "PAIR", num_args = 1.., requires = "figure")]
    figure_pairs: Vec<String>,
    /// Overwrite these files
    #[arg(long)]
    force: bool,
    #[command(flatten)]
    shard: ShardArgs,
    #[command(flatten)]
    face: FaceArgs,
    #[command(flatten)]
    rows: RowsArgs,
    #[command(flatten)]
    parameters: MethodParameters,
}

/// What `--json` prints of a part.
#[derive(Serialize)]
struct ScoredPart {
    /// Pairs that were scored, now or before.
    pairs: usize,
}

/// The files that `--out` writes.
const OUTPUTS: [&str; 7] =
    ["scores.txt", "scores.csv", "scores.json", "scores.tex", "scores.md", "pairs.csv", "report.html"];

/// The files that `--figure` gets, beside its panels.
const FIGURES: [&str; 2] = ["figure.svg", "figure.pdf"];

/// Number of pairs shown as pictures in the report.
const SHOWN_PAIRS: usize = 4;

pub fn run(mut args: Eval, context: &Context) -> anyhow::Result<()> {
    args.parameters.network.batch = args.batch.into();
    if let Some(out) = &args.out {
        ensure_folder(out)?;
        ensure_free(OUTPUTS.map(|name| out.join(name)), args.force)?;
    }
    let dataset = open_dataset(&args.dataset, args.split)?;
    let limit = args.limit.map(|limit| limit as usize);
    let Rows { methods: specs, left_out, improvements } = args.rows.with(&args.method)?;
    let sources = methods::sources(&specs, &args.parameters, &dataset, limit)?;
    let scored: Vec<Method> = sources.iter().map(Source::method).collect();
    if let Some(dir) = &args.save_flow {
        ensure_folder(dir)?;
        let folders: Vec<PathBuf> =
            scored.iter().map(|method| dir.join(folder_name(method.name()))).collect();
        ensure_free(&folders, args.force)?;
    }
    if let Some(dir) = &args.figure {
        ensure_folder(dir)?;
        ensure_free(FIGURES.map(|name| dir.join(name)), args.force)?;
        let names = scored_pairs(&dataset, limit);
        if let Some(name) = args.figure_pairs.iter().find(|name| !names.contains(name)) {
            let some = names.iter().take(3).cloned().collect::<Vec<_>>().join(", ");
            wrong_usage!(
                "--figure-pairs: expected the name of a pair that is scored, such as {some}; found {name}"
            );
        }
        create_folder(dir)?;
    }
    let shard = args.shard.taken()?;
    let kept = Kept::open(&args, &dataset, &specs, shard.shard)?;
    let windows = face_windows(&args, &dataset, limit)?;
    let settings = Settings {
        windows: windows.as_ref(),
        crop: args.crop.map(|size| (size.width, size.height)),
        limit,
        on_failure: if args.keep_going { OnFailure::LeaveOut } else { OnFailure::Stop },
        batch: NonZeroUsize::new(args.batch.into()),
        read_ahead: !args.parameters.network.on_cpu(),
        regions: args.regions,
        small_motion: args.small_motion,
        expression: args.expression,
        iterations: methods::any_auto(&specs, &args.parameters),
        part: shard.shard,
        kept: None,
    };
    if let Some(out) = &args.out {
        create_folder(out)?; // before the long work, so that an error costs nothing
    }
    let (mut figures, mut shown_pairs) = (Vec::new(), Vec::new());
    let mut log = kept.as_ref().map(Kept::log).transpose()?;
    let scores = kept.as_ref().map(|kept| kept.scores_without(&pictured(&args, &dataset)));
    let settings = Settings { kept: scores.as_ref(), ..settings };
    let continuable = kept.as_ref().map(|_| Continuable::keeping("the scores so far are kept"));
    let evaluation = scoring::score(&dataset, &scored, settings, SHOWN_PAIRS, &mut |pair, shown| {
        if let (Some(kept), Some(log)) = (&kept, &mut log) {
            log.append(&kept.of(pair))?;
        }
        if let Some(dir) = &args.save_flow {
            save_flows(pair, dir)?;
        }
        if shown && args.out.is_some() {
            figures.extend(pair_figures(pair, 560, "")?);
        }
        let in_figure = match args.figure_pairs.as_slice() {
            [] => shown,
            names => names.iter().any(|name| name == pair.name),
        };
        if args.figure.is_some() && in_figure {
            shown_pairs.push(pair_of(pair));
        }
        Ok(())
    })?;
    if shard.shard != Shard::WHOLE {
        let scored = Rendered { report: ScoredPart { pairs: evaluation.pairs }, shard };
        if context.json {
            return scored.print_json();
        }
        let (part, pairs) = (scored.shard.shard, scored.report.pairs);
        return say!(
            "Part {part} is complete: {pairs} pairs are scored. When all parts are, the same command without --shard writes the tables."
        );
    }
    if let Some(dir) = &args.figure {
        write_figure(dir, &scored, &shown_pairs)?;
    }
    let evaluation = Evaluation { left_out, improvements, ..evaluation };
    let scores = Scores {
        version: env!("CARGO_PKG_VERSION"),
        command: command_line(std::env::args()),
        machine: machine::describe(),
        made_by: methods::records(&specs, &args.parameters)?,
        evaluation: &evaluation,
    };

    if context.json {
        crate::output::print_json(&scores)?;
    } else {
        print_tables(&evaluation.tables())?;
    }
    if let Some(out) = &args.out {
        write(out, &scores, figures)?;
        drop(continuable);
        if let Some(kept) = kept {
            kept.remove()?;
        }
        if !context.json {
            say!("\nReport: {}", out.join("report.html").display())?;
        }
    }
    match evaluation.failures.len() {
        0 => Ok(()),
        count => bail!(
            "{count} of {} pairs could not be scored and were left out of every row",
            evaluation.pairs + count
        ),
    }
}

/// The names of the pairs that pictures or flow are written of, so that kept scores are not enough.
fn pictured(args: &Eval, dataset: &FlowDataset) -> BTreeSet<String> {
    let names = scored_pairs(dataset, args.limit.map(|limit| limit as usize));
    if args.save_flow.is_some() {
        return names.into_iter().collect();
    }
    let every = scoring::shown_every(names.len(), SHOWN_PAIRS);
    let shown = (0..).zip(&names).filter(|(index, _)| scoring::is_shown(*index, every)).map(|(_, name)| name);
    shown.chain(&args.figure_pairs).cloned().collect()
}

/// The window about the face in the first frame of each pair that is scored, by its name; `None` if faces are not asked for.
/// Landmarks that are found are written into `--out`.
fn face_windows(
    args: &Eval,
    dataset: &FlowDataset,
    limit: Option<usize>,
) -> anyhow::Result<Option<BTreeMap<String, Result<Window, String>>>> {
    let Some(mut boxes) = args.face.boxes()? else { return Ok(None) };
    let names: BTreeSet<String> = scored_pairs(dataset, limit).into_iter().collect();
    let bar = bar(names.len() as u64, "{bar:30} {pos}/{len} faces, {eta} left");
    let mut windows = BTreeMap::new();
    for entry in dataset.entries().iter().filter(|entry| names.contains(&entry.id())) {
        let name = entry.id();
        let sample = dataset.read(entry);
        let window = sample.map_err(anyhow::Error::from).and_then(|sample| {
            let FaceBox { left, top, width, height } = boxes.of_pair(&name, &sample.frame1)?;
            let middle = |start: usize, len: usize| start as f64 + (len as f64 - 1.0) / 2.0;
            Ok(match args.crop {
                None => Window { left, top, width, height },
                Some(crop) => window_about(
                    sample.frame1.size(),
                    (crop.width, crop.height),
                    (middle(left, width), middle(top, height)),
                )?,
            })
        });
        windows.insert(name, window.map_err(|error| in_words(&error)));
        bar.inc(1);
    }
    bar.finish_and_clear();
    if let Some(out) = &args.out {
        create_folder(out)?;
        boxes.write(&out.join("landmarks.csv"), args.force)?;
    }
    Ok(Some(windows))
}

/// The contents of `scores.json` and the output of `--json`.
#[derive(Serialize)]
struct Scores<'a> {
    version: &'static str,
    command: String,
    machine: String,
    /// Each method with everything its flow depends on; no entry for the baseline.
    made_by: Vec<MethodRecord>,
    #[serde(flatten)]
    evaluation: &'a Evaluation,
}

impl Scores<'_> {
    /// For the report.
    fn settings(&self) -> Vec<(String, String)> {
        let Evaluation { split, folder, crop, limit, pairs, .. } = self.evaluation;
        let limit =
            limit.map_or("all pairs".to_owned(), |limit| format!("at most {limit} pairs, spread evenly"));
        let place = if self.evaluation.at_faces { "face" } else { "head" };
        let crop = match crop {
            Some((width, height)) => format!("{width}x{height} around the {place}"),
            None if self.evaluation.at_faces => "the face".to_owned(),
            None => "whole frames".to_owned(),
        };
        let mut settings = vec![
            ("Dataset".to_owned(), format!("{} in {folder}", self.evaluation.dataset)),
            ("Split".to_owned(), split.to_string()),
            ("Pairs".to_owned(), format!("{pairs} scored ({limit})")),
            ("Crop".to_owned(), crop),
        ];
        settings.extend(self.made_by.iter().map(|method| (method.name.clone(), method.description())));
        settings.push(("Command".to_owned(), self.command.clone()));
        settings.push(("Version".to_owned(), format!("srflow {}", self.version)));
        settings.push(("Machine".to_owned(), self.machine.clone()));
        settings
    }
}

/// Quoted for a POSIX shell.
fn command_line(arguments: impl Iterator<Item = String>) -> String {
    let plain = |c: char| c.is_ascii_alphanumeric() || "-_./:=,@%+".contains(c);
    let quoted = |argument: String| match !argument.is_empty() && argument.chars().all(plain) {
        true => argument,
        false => format!("'{}'", argument.replace('\'', "'\\''")),
    };
    let program = std::iter::once("srflow".to_owned());
    program.chain(arguments.skip(1).map(quoted)).collect::<Vec<_>>().join(" ")
}

/// A scored pair, for a figure.
fn pair_of(pair: &ScoredPair) -> Pair {
    let methods = pair.estimates.iter().filter(|estimate| !estimate.baseline);
    Pair {
        name: pair.name.to_owned(),
        frames: [pair.sample.frame1.clone(), pair.sample.frame2.clone()],
        truth: Some(pair.truth.clone()),
        flows: methods.map(|estimate| Some(estimate.flow.clone())).collect(),
    }
}

/// The qualitative figure of a paper: the frame and the true flow, then for each method its flow above its error, each pair with its
/// own scales.
fn write_figure(dir: &Path, methods: &[Method], pairs: &[Pair]) -> anyhow::Result<()> {
    const COLUMNS: usize = 8;
    let of_method = |method| vec![Content::Flow(Flow::Method(method)), Content::Error(method)];
    let first = vec![Content::Flow(Flow::Truth), Content::Frame1];
    let plan = Plan {
        methods: methods.iter().map(|method| method.name().to_owned()).collect(),
        columns: std::iter::once(first).chain((0..methods.len()).map(of_method)).collect(),
        most_columns: COLUMNS,
        scales: Scales { flow: Scale::Pair, error: Scale::Pair, strain: Scale::Pair },
        arrows: None,
        scores: true,
        letters: false,
        titles: None,
        labels: None,
        captions: None,
    };
    let figure = plan.compose(pairs)?.figure;
    super::figure::write_panels(dir, &figure)?;
    let drawing = figure.drawing(&Style::default())?;
    let contents = [drawing.svg()?.into_bytes(), drawing.pdf()?];
    for (name, content) in FIGURES.iter().zip(contents) {
        write_file(&dir.join(name), content)?;
    }
    Ok(())
}

fn write(out: &Path, scores: &Scores, figures: Vec<Figure>) -> anyhow::Result<()> {
    let evaluation = scores.evaluation;
    let tables = evaluation.tables();
    let contents: [String; 7] = [
        joined(&tables, |table| table.text(TextStyle::Plain)),
        evaluation.csv(),
        serde_json::to_string_pretty(scores)? + "\n",
        latex(&tables),
        markdown_file(&tables),
        evaluation.pairs_csv(),
        score_report(evaluation, &scores.machine, figures, &scores.settings()).html(),
    ];
    for (name, text) in OUTPUTS.iter().zip(contents) {
        write_file(&out.join(name), text)?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_command_line_is_quoted_for_a_shell() {
        let words = ["/path/srflow", "eval", "--method", "Ours: 3:skflow=a b.ckpt", "it's", "", "srflow:out"];
        assert_eq!(
            command_line(words.map(str::to_owned).into_iter()),
            r"srflow eval --method 'Ours: 3:skflow=a b.ckpt' 'it'\''s' '' srflow:out"
        );
    }
}
