use std::num::NonZeroUsize;
use std::path::{Path, PathBuf};

use anyhow::bail;
use clap::Args;
use srflow_eval::report::{Figure, score_report};
use srflow_eval::{Evaluation, OnFailure, Settings, TextStyle, joined, markdown_file};
use srflow_field::create_folder;
use srflow_read::flow::{DatasetSpec, FlowDataset, Split};

use crate::methods::{self, Method, MethodParameters, MethodSpec};
use crate::output::{ensure_free, latex, print_tables, write_text};
use crate::scoring::{self, Pictures};
use crate::size::Size;
use crate::{Context, machine};

/// Score estimators over a dataset and print the table
#[derive(Args)]
#[command(after_help = "\
Scores are those of the SRFlow paper's Table II: computed per pair over the pixels whose true flow is known, then \
averaged over pairs; also inside the head's mask and outside occlusions where the dataset has them. The baseline `zero` \
says that nothing moves.

Examples:
  srflow eval --dataset srflow:srflow --method farneback tvl1 --crop 1200x1600 --out scores
  srflow eval --dataset sintel-clean:/data/Sintel --method skflow=skflow-things.ckpt raft=raft.pth raft=mine.pth --iters 12")]
pub struct Eval {
    /// Kind of dataset and its folder, e.g. sintel-clean:/data/Sintel; an unknown kind lists all
    #[arg(long, value_name = "KIND:DIR")]
    dataset: DatasetSpec,
    /// Part of the dataset: train, val, test or all [default: the one that results are reported on]
    #[arg(long)]
    split: Option<Split>,
    /// Methods to score
    #[arg(long, value_name = "METHOD", required = true, num_args = 1.., value_delimiter = ',', help = Method::help_of_several("Methods to score"))]
    method: Vec<MethodSpec>,
    /// Window that is estimated and scored, centred on the head (without a mask, on the frame)
    #[arg(long, value_name = "WIDTHxHEIGHT")]
    crop: Option<Size>,
    /// Score only N pairs, spread evenly over the dataset
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..))]
    limit: Option<u32>,
    /// Pairs that a network estimates at once, where neighbours in the dataset are of one size; the scores are the same, the
    /// time of a pair is its share
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = clap::value_parser!(u16).range(1..=1024))]
    batch: u16,
    /// Leave out a pair that cannot be scored, for every method, and go on; the exit code is still 1
    #[arg(long)]
    keep_going: bool,
    /// Also write scores.{txt,csv,json,tex,md}, pairs.csv and report.html into this folder
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
    /// Overwrite these files
    #[arg(long)]
    force: bool,
    #[command(flatten)]
    parameters: MethodParameters,
}

/// The files that `--out` gets.
const OUTPUTS: [&str; 7] =
    ["scores.txt", "scores.csv", "scores.json", "scores.tex", "scores.md", "pairs.csv", "report.html"];

/// How many pairs the report shows as pictures.
const SHOWN_PAIRS: usize = 4;

/// Runs the command.
pub fn run(mut args: Eval, context: &Context) -> anyhow::Result<()> {
    args.parameters.network.batch = args.batch.into();
    if let Some(out) = &args.out {
        ensure_free(OUTPUTS.map(|name| out.join(name)), args.force)?;
    }
    let dataset = FlowDataset::open(&args.dataset, args.split)?;
    let estimators = methods::estimators(&args.method, &args.parameters)?;
    let settings = Settings {
        crop: args.crop.map(|size| (size.width, size.height)),
        limit: args.limit.map(|limit| limit as usize),
        on_failure: if args.keep_going { OnFailure::LeaveOut } else { OnFailure::Stop },
        batch: NonZeroUsize::new(args.batch.into()),
    };
    if let Some(out) = &args.out {
        create_folder(out)?; // before the long work, which must not be lost
    }
    let pictures = Pictures { pairs: if args.out.is_some() { SHOWN_PAIRS } else { 0 }, width: 560 };
    let (evaluation, figures) = scoring::score(&dataset, &estimators, settings, pictures)?;

    print(&evaluation, context)?;
    if let Some(out) = &args.out {
        write(out, &evaluation, figures)?;
        if !context.json {
            say!("\nReport: {}", out.join("report.html").display())?;
        }
    }
    match evaluation.failures.len() {
        0 => Ok(()),
        count => bail!("{count} of {} pairs could not be scored and are in no row", evaluation.pairs + count),
    }
}

fn print(evaluation: &Evaluation, context: &Context) -> anyhow::Result<()> {
    if context.json {
        say!("{}", serde_json::to_string_pretty(evaluation)?)?;
        return Ok(());
    }
    print_tables(&evaluation.tables())
}

fn write(out: &Path, evaluation: &Evaluation, figures: Vec<Figure>) -> anyhow::Result<()> {
    let tables = evaluation.tables();
    let contents: [String; 7] = [
        joined(&tables, |table| table.text(TextStyle::Plain)),
        evaluation.csv(),
        serde_json::to_string_pretty(evaluation)? + "\n",
        latex(&tables),
        markdown_file(&tables),
        evaluation.pairs_csv(),
        score_report(evaluation, &machine::describe(), figures).html(),
    ];
    for (name, text) in OUTPUTS.iter().zip(contents) {
        write_text(&out.join(name), &text)?;
    }
    Ok(())
}
