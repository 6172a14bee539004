use std::path::PathBuf;

use clap::Args;
use clap::builder::{ArgPredicate, PossibleValue, PossibleValuesParser, TypedValueParser};
use srflow_core::Shard;
use srflow_files::create_folder;
use srflow_mer::{
    CLASSIFIERS, ClassifierEntry, Preparation, Protocol, ResultsFolder, ResultsRecord, RunFolders, RunMethod,
    RunSettings, Sets, TrainedPart, by_set, unseen_classes,
};
use srflow_read::micro_expression::ClipSource;

use super::preparation::PreparationArgs;
use super::progress::RunProgress;
use super::sources::{SourceArgs, kinds_help};
use super::tables::print_scores;
use crate::interrupt::Continuable;
use crate::methods::{self, Method, MethodParameters, MethodSpec, Rows, RowsArgs};
use crate::rendering::{Rendered, ShardArgs};
use crate::{Context, machine};

/// Recognize micro-expressions with leave-one-subject-out cross-validation, and write the paper's tables
#[derive(Args)]
#[command(after_help = format!("\
Examples:
  srflow mer run --data samm:/data/SAMM casme2:/data/CASME2 smic:/data/SMIC --method farneback tvl1 --out results
  srflow mer run --data clips:rendered --method tvl1 SRFlowNet:skflow=best.safetensors --out results
  srflow mer run --data clips:rendered --method tvl1 --epochs 21 --out first-look

Each dataset, and all of them together (`composite`), is split by subject: for each held-out subject a classifier is \
trained on all others and predicts the classes of that subject's clips. docs/explanation/micro-expression-protocol.md defines every number.

This takes time: with the 201 epochs of the paper's protocol, SAMM, CASME II, SMIC-HS and the composite take about five \
hours on two CPU cores for each method. For a first look, --epochs 21 takes a tenth of that, --classifier ststnet much \
less, and --sets each skips the composite. A run can be killed at any time: run the same command again to continue after \
the last finished fold. Features are never computed twice. With --shard, several processes or machines train parts of the folds \
into one shared folder; run the command without it when they are done, which writes the results.

{}", kinds_help()))]
pub struct Run {
    /// Datasets
    #[arg(long, required = true, num_args = 1.., value_name = "KIND:DIR")]
    data: Vec<ClipSource>,
    /// How to estimate the flow from onset to apex
    #[arg(long, value_name = "METHOD", default_value = Method::DEFAULT.name(), default_value_if("rows", ArgPredicate::IsPresent, None), num_args = 1.., value_delimiter = ',', help = Method::help_of_several("How to estimate the flow from onset to apex"))]
    method: Vec<MethodSpec>,
    /// Classifier of the features
    #[arg(long, value_name = "CLASSIFIER", default_value = CLASSIFIERS[0].facts.name, value_parser = classifiers())]
    classifier: &'static ClassifierEntry,
    /// Train on each dataset, on all together, or both
    #[arg(long, value_name = "SETS", default_value = "both", value_parser = choice(SETS))]
    sets: Sets,
    /// Folder for tables.{txt,csv,tex,md}, folds.csv, confusions.csv, predictions.csv, results.json and report.html
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// Overwrite these files
    #[arg(long)]
    force: bool,
    /// Folder that caches features, for other runs too [default: features in --out]
    #[arg(long, value_name = "DIR")]
    cache: Option<PathBuf>,
    /// Epochs: passes over the training clips
    #[arg(long, value_name = "N", default_value_t = Protocol::default().epochs)]
    epochs: usize,
    /// Epochs between two recordings of the predictions
    #[arg(long, value_name = "N", default_value_t = Protocol::default().record_every)]
    record_every: usize,
    /// Batch size in clips
    #[arg(long, value_name = "N", default_value_t = Protocol::default().batch)]
    batch: usize,
    /// Initial learning rate of Adam; it is multiplied by 0.3 every 60 epochs
    #[arg(long, value_name = "RATE", default_value_t = Protocol::default().learning_rate)]
    learning_rate: f64,
    /// Seed of the initial parameters, the order of clips and dropout
    #[arg(long, value_name = "SEED", default_value_t = 0)]
    seed: u64,
    #[command(flatten)]
    shard: ShardArgs,
    #[command(flatten)]
    sources: SourceArgs,
    #[command(flatten)]
    preparation: PreparationArgs,
    #[command(flatten)]
    rows: RowsArgs,
    #[command(flatten)]
    parameters: MethodParameters,
}

const SETS: [(Sets, &str, &str); 3] = [
    (Sets::Each, "each", "Each dataset by itself"),
    (Sets::Composite, "composite", "All datasets as one"),
    (Sets::Both, "both", "Each by itself, then all as one where there are several"),
];

fn classifiers() -> impl TypedValueParser<Value = &'static ClassifierEntry> {
    let of = |entry: &'static ClassifierEntry| {
        let facts = &entry.facts;
        (entry, facts.name, format!("{}: {}", facts.title, facts.input))
    };
    choice(CLASSIFIERS.iter().map(of))
}

/// A parser for one of several values, each with its own help.
fn choice<T, Help>(
    choices: impl IntoIterator<Item = (T, &'static str, Help)>,
) -> impl TypedValueParser<Value = T>
where
    T: Copy + Send + Sync + 'static,
    Help: Into<clap::builder::StyledStr>,
{
    let (mut values, mut known) = (Vec::new(), Vec::new());
    for (value, name, help) in choices {
        known.push((name, value));
        values.push(PossibleValue::new(name).help(help));
    }
    PossibleValuesParser::new(values).map(move |chosen| {
        known.iter().find(|(name, _)| *name == chosen).expect("one of the possible values").1
    })
}

pub fn run(args: Run, context: &Context) -> anyhow::Result<()> {
    crate::output::ensure_folder(&args.out)?;
    let folder = ResultsFolder::open(&args.out, args.force)?;
    let protocol = Protocol {
        epochs: args.epochs,
        record_every: args.record_every,
        batch: args.batch,
        learning_rate: args.learning_rate,
        seed: args.seed,
        ..Protocol::default()
    };
    protocol.check()?;
    let Rows { methods: specs, left_out, .. } = args.rows.with(&args.method)?;
    let mut settings = RunSettings {
        classifier: args.classifier,
        sets: args.sets,
        apex: args.preparation.apex,
        preparation: Preparation::default(),
        protocol,
        classes: args.sources.classes()?.names().clone(),
        left_out,
    };
    let estimators = methods::estimators(&specs, &args.parameters)?;
    let records = methods::records(&specs, &args.parameters)?;
    let methods = estimators.iter().zip(records);
    let methods = methods.map(|(estimator, record)| RunMethod { estimator: estimator.as_ref(), record });
    let datasets = args.sources.open(args.data.clone())?;
    settings.check(&datasets)?;
    create_folder(&args.out)?; // before the long work, so that an error costs nothing
    let landmarks = || args.out.join("landmarks.csv");
    settings.preparation = args.preparation.preparation(&datasets, landmarks, args.force)?;
    let folders = RunFolders {
        features: &args.cache.clone().unwrap_or_else(|| args.out.join("features")),
        folds: &folder.folds(),
    };
    let progress = RunProgress::default();
    let shard = args.shard.taken()?;
    let _continuable = Continuable::keeping("finished folds and features are kept");
    if shard.shard != Shard::WHOLE {
        let (part, methods) = (shard.shard, methods.collect());
        let trained =
            srflow_mer::run_part(datasets, methods, &settings, folders, part, &|event| progress.show(event))?;
        progress.finish();
        let trained = Rendered { report: trained, shard };
        if context.json {
            return trained.print_json();
        }
        let TrainedPart { folds, all_folds } = trained.report;
        return say!(
            "Part {part} is complete: {folds} of {all_folds} folds. When all parts are, the same command without --shard writes the results."
        );
    }
    let results =
        srflow_mer::run(datasets, methods.collect(), settings, folders, &|event| progress.show(event))?;
    progress.finish();
    let machine = machine::describe();
    folder.write(&results, &machine)?;
    if context.json {
        return crate::output::print_json(&ResultsRecord::of(&results, &machine));
    }
    print_scores(&results.outcomes, &results.settings.left_out)?;
    for of_set in by_set(&results.outcomes) {
        if let Some(note) = unseen_classes(of_set[0]) {
            say!("\n{note}")?;
        }
    }
    say!("\nReport: {}", folder.report().display())
}
