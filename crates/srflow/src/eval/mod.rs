//! Scores of flow over a dataset.

mod kept;

use std::collections::{BTreeMap, BTreeSet};
use std::fmt;
use std::num::{NonZeroU32, NonZeroUsize};
use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};
use srflow_core::{SettingError, Shard, Size};
use srflow_data::flow::{DatasetSpec, FlowDataset, KINDS, Split};
use srflow_eval::{
    Evaluation, Method, MethodRecord, OnFailure, ScoredPair, Settings, Window, pair_figures, score_report,
    scored_pairs, window_about,
};
use srflow_face::FaceBox;
use srflow_files::{create_folder, write_file};
use srflow_report::figure::{Content, Pair, Plan, Scale, Scales, Source as Flow, Style};
use srflow_report::html::Figure;
use srflow_report::{TextStyle, joined, markdown_file};

use self::kept::Kept;
use crate::clap::Args;
use crate::error::{in_words, wrong_settings};
use crate::face::FaceArgs;
use crate::figure::{strain, write_panels};
use crate::methods::{self, MethodParameters, MethodSpec, Rows, RowsArgs, Source};
use crate::opening::open_dataset;
use crate::output::{ensure_folder, ensure_free, latex, write_page, write_tables};
use crate::rendering::{Rendered, ShardArgs};
use crate::scoring::{self, folder_name, save_flows};
use crate::{Job, Report, Watch, WhenStopped, machine};

fn method_help() -> String {
    let default = methods::Method::DEFAULT.name();
    format!("{} [default: {default}]", methods::Method::help_of_several("Methods to score"))
}

fn kinds_help() -> String {
    let lines: Vec<String> = KINDS.iter().map(|kind| format!("  {kind}\n      {}", kind.about)).collect();
    lines.join("\n")
}

/// Score estimators over a dataset and print the table
#[derive(Args, Debug, Clone, PartialEq, Serialize, Deserialize)]
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
  srflow eval --dataset clips:set --method farneback srflow --expression-error
  srflow eval --dataset sintel-clean:/data/Sintel --method skflow=skflow-things.ckpt raft=raft.pth raft=mine.pth --iters 12
  srflow eval --dataset sintel-clean:/data/Sintel --method tvl1 Theirs:files:out/theirs --save-flow flows

Kinds of dataset:
{}", kinds_help()))]
pub struct EvalJob {
    /// Kind of dataset and its folder, e.g. sintel-clean:/data/Sintel
    #[arg(long, value_name = "KIND:DIR")]
    pub dataset: DatasetSpec,
    /// Split: train, val, test or all [default: the one that results are usually reported on]
    #[arg(long)]
    #[serde(default)]
    pub split: Option<Split>,
    #[arg(long, value_name = "METHOD", num_args = 1.., value_delimiter = ',', value_parser = methods::scored_method, help = method_help())]
    #[serde(default, deserialize_with = "methods::scored_methods")]
    pub method: Vec<MethodSpec>,
    /// Crop that is estimated and scored, centred on the head (without a mask, on the frame)
    #[arg(long, value_name = "WIDTHxHEIGHT")]
    #[serde(default)]
    pub crop: Option<Size>,
    /// Score only N pairs, spread evenly over the dataset
    #[arg(long, value_name = "N")]
    #[serde(default)]
    pub limit: Option<NonZeroU32>,
    /// Pairs to estimate at once with a network, if they are consecutive and of one size; scores do not
    /// change, and each pair's time is an equal share of the batch's
    #[arg(long, value_name = "N", default_value_t = one())]
    #[serde(default = "one")]
    pub batch: u16,
    /// Also score the regions of `srflow render --regions`: skin, eyes, mouth, hair, neck, the rim of the
    /// head (3 px wide, in no other region) and the background
    #[arg(long)]
    #[serde(default)]
    pub regions: bool,
    /// Also score the pixels whose true flow is shorter than this, e.g. 0.5; with masks, only on the head
    #[arg(long, value_name = "PIXELS", allow_negative_numbers = true)]
    #[serde(default)]
    pub small_motion: Option<f32>,
    /// Also score the motion of the expression: subtract the head's motion, the best affine fit within the
    /// mask (or the frame), from estimated and true flow, and compare the rest by correlation and strength
    #[arg(long)]
    #[serde(default)]
    pub expression: bool,
    /// Also score the flow of the expression: subtract the motion that most of the face follows from the
    /// estimated flow, as `srflow mer` does, and compare the rest with the exact flow of datasets of
    /// `srflow render --decompose` and `srflow mer synth`
    #[arg(long)]
    #[serde(default)]
    pub expression_error: bool,
    /// Leave out pairs that cannot be scored, for every method, and continue; the exit code is still 1
    #[arg(long)]
    #[serde(default)]
    pub keep_going: bool,
    /// Also write scores.{txt,csv,json,tex,md}, pairs.csv and report.html into this folder
    #[arg(long, value_name = "DIR")]
    #[serde(default)]
    pub out: Option<PathBuf>,
    /// Also write the flow of each method and pair, as DIR/METHOD/SCENE/FRAME.flo
    #[arg(long, value_name = "DIR")]
    #[serde(default)]
    pub save_flow: Option<PathBuf>,
    /// Also write a figure for a paper into this folder: figure.svg, figure.pdf and every panel as PNG; see
    /// also `srflow figure`
    #[arg(long, value_name = "DIR")]
    #[serde(default)]
    pub figure: Option<PathBuf>,
    /// Pairs in the figure, by their names in pairs.csv [default: 4, spread evenly]
    #[arg(long, value_name = "PAIR", num_args = 1.., requires = "figure")]
    #[serde(default)]
    pub figure_pairs: Vec<String>,
    /// Overwrite these files
    #[arg(long)]
    #[serde(default)]
    pub force: bool,
    #[command(flatten)]
    #[serde(flatten)]
    pub shard: ShardArgs,
    #[command(flatten)]
    #[serde(flatten)]
    pub face: FaceArgs,
    #[command(flatten)]
    #[serde(flatten)]
    pub rows: RowsArgs,
    #[command(flatten)]
    #[serde(flatten)]
    pub parameters: MethodParameters,
    /// The command that the results record.
    #[arg(skip = command_line(std::env::args()))]
    #[serde(skip)]
    pub command: String,
}

fn one() -> u16 {
    1
}

/// The files of the results.
const OUTPUTS: [&str; 7] =
    ["scores.txt", "scores.csv", "scores.json", "scores.tex", "scores.md", "pairs.csv", "report.html"];

/// The files of a figure, beside its panels.
const FIGURES: [&str; 2] = ["figure.svg", "figure.pdf"];

/// Number of pairs shown as pictures in the report.
const SHOWN_PAIRS: usize = 4;

impl Job for EvalJob {
    const NAME: &'static str = "eval";
    const WHEN_STOPPED: WhenStopped = WhenStopped::UnitsKept;

    type Report = EvalReport;

    fn when_stopped(&self) -> WhenStopped {
        match kept::missing(self, &self.method) {
            None => WhenStopped::UnitsKept,
            Some(_) => WhenStopped::Lost,
        }
    }

    fn work(&self, watch: &Watch) -> anyhow::Result<EvalReport> {
        self.check()?;
        let mut parameters = self.parameters.clone();
        parameters.network.batch = self.batch.into();
        if let Some(out) = &self.out {
            ensure_folder(out)?;
            ensure_free(OUTPUTS.map(|name| out.join(name)), self.force)?;
        }
        let dataset = open_dataset(&self.dataset, self.split, watch)?;
        let limit = self.limit();
        let Rows { methods: specs, left_out, improvements } = self.rows.with(&self.methods(), watch)?;
        let sources = methods::sources(&specs, &parameters, &dataset, limit, watch)?;
        let scored: Vec<Method> = sources.iter().map(Source::method).collect();
        if let Some(dir) = &self.save_flow {
            ensure_folder(dir)?;
            let folders: Vec<PathBuf> =
                scored.iter().map(|method| dir.join(folder_name(method.name()))).collect();
            ensure_free(&folders, self.force)?;
        }
        if let Some(dir) = &self.figure {
            ensure_folder(dir)?;
            ensure_free(FIGURES.map(|name| dir.join(name)), self.force)?;
            let names = scored_pairs(&dataset, limit);
            if let Some(name) = self.figure_pairs.iter().find(|name| !names.contains(name)) {
                let some = names.iter().take(3).cloned().collect::<Vec<_>>().join(", ");
                wrong_settings!(
                    "`figure_pairs`: expected the name of a pair that is scored, such as {some}; found {name}"
                );
            }
            create_folder(dir)?;
        }
        let shard = self.shard.taken()?;
        // Before the long work, so that an error costs nothing.
        let lock = self.out.as_ref().map(|out| kept::lock(out, shard.shard)).transpose()?;
        let kept = Kept::open(self, &parameters, &dataset, &specs, shard.shard, watch)?;
        let windows = self.face_windows(&dataset, limit, watch)?;
        let settings = Settings {
            windows: windows.as_ref(),
            crop: self.crop,
            limit,
            on_failure: if self.keep_going { OnFailure::LeaveOut } else { OnFailure::Stop },
            batch: NonZeroUsize::new(self.batch.into()),
            read_ahead: !parameters.network.on_cpu(),
            regions: self.regions,
            small_motion: self.small_motion,
            expression: self.expression,
            expression_error: self.expression_error,
            iterations: methods::any_auto(&specs, &parameters),
            part: shard.shard,
            kept: None,
        };
        let (mut figures, mut shown_pairs) = (Vec::new(), Vec::new());
        let mut log = kept.as_ref().map(Kept::log).transpose()?;
        let scores = kept.as_ref().map(|kept| kept.scores_without(&self.pictured(&dataset)));
        let settings = Settings { kept: scores.as_ref(), ..settings };
        let evaluation =
            scoring::score(&dataset, &scored, settings, SHOWN_PAIRS, watch, &mut |pair, shown| {
                if let (Some(kept), Some(log)) = (&kept, &mut log) {
                    log.append(&kept.of(pair))?;
                }
                if let Some(dir) = &self.save_flow {
                    save_flows(pair, dir)?;
                }
                if shown && self.out.is_some() {
                    figures.extend(pair_figures(pair, 560, "")?);
                }
                let in_figure = match self.figure_pairs.as_slice() {
                    [] => shown,
                    names => names.iter().any(|name| name == pair.name),
                };
                if self.figure.is_some() && in_figure {
                    shown_pairs.push(pair_of(pair));
                }
                Ok(())
            })?;
        if shard.shard != Shard::WHOLE {
            return Ok(EvalReport::Part(Rendered { report: ScoredPart { pairs: evaluation.pairs }, shard }));
        }
        if let Some(dir) = &self.figure {
            write_figure(dir, &scored, &shown_pairs)?;
        }
        let evaluation = Evaluation { left_out, improvements, ..evaluation };
        let scores = Scores {
            version: env!("CARGO_PKG_VERSION"),
            command: self.command(),
            machine: machine::describe(),
            made_by: methods::records(&specs, &parameters, watch)?,
            evaluation,
            out: self.out.clone(),
        };
        if let Some(out) = &self.out {
            write(out, &scores, figures)?;
            drop(lock);
            kept::remove(out)?;
        }
        Ok(EvalReport::Scores(Box::new(scores)))
    }
}

impl EvalJob {
    /// Refuses numbers that are out of range.
    fn check(&self) -> Result<(), SettingError> {
        let wrong = |field, found: String, expected: &str| {
            Err(SettingError { field, found, expected: expected.to_owned() })
        };
        match self.small_motion {
            Some(length) if !(length > 0.0 && length.is_finite()) => {
                wrong("small_motion", length.to_string(), "a positive number of pixels, such as 0.5")
            }
            _ if !(1..=1024).contains(&self.batch) => wrong("batch", self.batch.to_string(), "1 to 1024"),
            _ => Ok(()),
        }
    }

    /// The methods to score beside those of rows.
    fn methods(&self) -> Vec<MethodSpec> {
        match self.method.is_empty() && self.rows.rows.is_none() {
            true => vec![methods::Method::DEFAULT.into()],
            false => self.method.clone(),
        }
    }

    fn limit(&self) -> Option<usize> {
        self.limit.map(|limit| limit.get() as usize)
    }

    /// The command that is recorded: the one that was given, or these settings.
    fn command(&self) -> String {
        match self.command.as_str() {
            "" => format!("eval {}", serde_json::to_string(self).unwrap_or_default()),
            given => given.to_owned(),
        }
    }

    /// The names of the pairs that pictures or flow are written of, so that kept scores are not enough.
    fn pictured(&self, dataset: &FlowDataset) -> BTreeSet<String> {
        let names = scored_pairs(dataset, self.limit());
        if self.save_flow.is_some() {
            return names.into_iter().collect();
        }
        let every = scoring::shown_every(names.len(), SHOWN_PAIRS);
        let shown =
            (0..).zip(&names).filter(|(index, _)| scoring::is_shown(*index, every)).map(|(_, name)| name);
        shown.chain(&self.figure_pairs).cloned().collect()
    }

    /// The window around the face in the first frame of each pair that is scored, by its name; `None` for whole frames. Detected
    /// landmarks are written into the folder of the results.
    fn face_windows(
        &self,
        dataset: &FlowDataset,
        limit: Option<usize>,
        watch: &Watch,
    ) -> anyhow::Result<Option<BTreeMap<String, Result<Window, String>>>> {
        let Some(mut boxes) = self.face.boxes()? else { return Ok(None) };
        let names: BTreeSet<String> = scored_pairs(dataset, limit).into_iter().collect();
        let faces = watch.count("faces", names.len() as u64);
        let mut windows = BTreeMap::new();
        for entry in dataset.entries().iter().filter(|entry| names.contains(&entry.id())) {
            let name = entry.id();
            let sample = dataset.read(entry);
            let window = sample.map_err(anyhow::Error::from).and_then(|sample| {
                let FaceBox { left, top, width, height } = boxes.of_pair(&name, &sample.frame1)?;
                let middle = |start: usize, len: usize| start as f64 + (len as f64 - 1.0) / 2.0;
                Ok(match self.crop {
                    None => Window { left, top, width, height },
                    Some(crop) => {
                        window_about(sample.frame1.size(), crop, (middle(left, width), middle(top, height)))?
                    }
                })
            });
            windows.insert(name, window.map_err(|error| in_words(&error)));
            faces.inc();
        }
        if let Some(out) = &self.out {
            create_folder(out)?;
            boxes.write(&out.join("landmarks.csv"), self.force)?;
        }
        Ok(Some(windows))
    }
}

/// What [`EvalJob`] has scored.
#[derive(Debug, Serialize)]
#[serde(untagged)]
pub enum EvalReport {
    Scores(Box<Scores>),
    /// One part of the pairs; the tables are written when all are complete.
    Part(Rendered<ScoredPart>),
}

/// A part of the pairs.
#[derive(Debug, Clone, Serialize)]
pub struct ScoredPart {
    /// Pairs that were scored, now or before.
    pub pairs: usize,
}

/// The contents of `scores.json`.
#[derive(Debug, Serialize)]
pub struct Scores {
    pub version: &'static str,
    pub command: String,
    pub machine: String,
    /// Each method with everything its flow depends on; no entry for the baseline.
    pub made_by: Vec<MethodRecord>,
    #[serde(flatten)]
    pub evaluation: Evaluation,
    /// The folder that the results were written into.
    #[serde(skip)]
    out: Option<PathBuf>,
}

impl Report for EvalReport {
    fn failure(&self) -> Option<String> {
        let Self::Scores(scores) = self else { return None };
        let Evaluation { pairs, failures, .. } = &scores.evaluation;
        let failed = failures.len();
        (failed > 0).then(|| {
            format!("{failed} of {} pairs could not be scored and were left out of every row", pairs + failed)
        })
    }
}

impl fmt::Display for EvalReport {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        match self {
            Self::Part(Rendered { report: ScoredPart { pairs }, shard }) => writeln!(
                f,
                "Part {} is complete: {pairs} pairs are scored. When all parts are, the same command without --shard writes the tables.",
                shard.shard
            ),
            Self::Scores(scores) => {
                write_tables(f, &scores.evaluation.tables())?;
                match &scores.out {
                    Some(out) => write_page(f, &out.join("report.html")),
                    None => Ok(()),
                }
            }
        }
    }
}

impl Scores {
    /// For the report.
    fn settings(&self) -> Vec<(String, String)> {
        let Evaluation { split, folder, crop, limit, pairs, .. } = &self.evaluation;
        let limit =
            limit.map_or("all pairs".to_owned(), |limit| format!("at most {limit} pairs, spread evenly"));
        let place = if self.evaluation.at_faces { "face" } else { "head" };
        let crop = match crop {
            Some([width, height]) => format!("{width}x{height} around the {place}"),
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
    let below = |method| vec![Content::Flow(Flow::Method(method)), Content::Error(method)];
    let first = vec![Content::Flow(Flow::Truth), Content::Frame1];
    let plan = Plan {
        methods: methods.iter().map(|method| method.name().to_owned()).collect(),
        columns: std::iter::once(first).chain((0..methods.len()).map(below)).collect(),
        most_columns: COLUMNS,
        scales: Scales { flow: Scale::Pair, error: Scale::Pair, strain: Scale::Pair },
        strain,
        arrows: None,
        scores: true,
        letters: false,
        titles: None,
        labels: None,
        captions: None,
    };
    let figure = plan.compose(pairs)?.figure;
    write_panels(dir, &figure)?;
    let drawing = figure.drawing(&Style::default())?;
    let contents = [drawing.svg()?.into_bytes(), drawing.pdf()?];
    for (name, content) in FIGURES.iter().zip(contents) {
        write_file(&dir.join(name), content)?;
    }
    Ok(())
}

fn write(out: &Path, scores: &Scores, figures: Vec<Figure>) -> anyhow::Result<()> {
    let evaluation = &scores.evaluation;
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
