use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use anyhow::{Context as _, ensure};
use clap::{Args, ValueEnum};
use serde::Serialize;
use srflow_field::create_folder;
use srflow_mer::{
    ApexRule, Classifier, FeatureCache, Loso, LosoError, OffApexNet, OffTaNet, Outcome, OutcomeRecord,
    Preparation, Protocol, ReportParts, ResizeOrder, Sample, StrainFormula, StstNet, Trial, by_set, extract,
    leave_one_subject_out, report, spot_apex, unseen_classes, write_predictions,
};
use srflow_read::micro_expression::{Clip, ClipDataset, ClipSource};

use super::face::FaceArgs;
use super::progress::{TrainingProgress, feature_progress};
use super::sources::{SourceArgs, kinds_help};
use super::tables::{TABLE_FILES, print_scores, write_tables};
use crate::methods::{self, Method, MethodParameters, MethodRecord, MethodSpec};
use crate::output::{ensure_free, write_text};
use crate::{Context, machine};

/// Recognize micro-expressions leaving one subject out, and write the paper's tables
#[derive(Args)]
#[command(after_help = format!("\
Examples:
  srflow mer run --data samm:/data/SAMM casme2:/data/CASME2 smic:/data/SMIC --method farneback tvl1 --out results
  srflow mer run --data clips:rendered --method tvl1 SRFlowNet:skflow=best.safetensors --out results
  srflow mer run --data clips:rendered --method tvl1 --epochs 21 --out first-look

Each dataset is divided into its subjects, and so are all of them together (`composite`). For each subject a classifier \
is trained on all others and tells the subject's clips. docs/mer.md says what every number is.

That takes its time: with the 201 epochs of the paper's protocol, SAMM, CASME II, SMIC-HS and the composite are about \
five hours of two CPU cores for each method. For a first look, --epochs 21 takes a tenth of that, --classifier ststnet \
much less, --sets each leaves out the composite. The bar shows when all will be done. A run may be killed at any time: \
the same command goes on after the folds that were finished, and features are never computed twice.

{}", kinds_help()))]
pub struct Run {
    /// Datasets
    #[arg(long, required = true, num_args = 1.., value_name = "KIND:DIR")]
    data: Vec<ClipSource>,
    /// How to estimate the flow from onset to apex
    #[arg(long, value_name = "METHOD", required = true, num_args = 1.., value_delimiter = ',', help = Method::help_of_several("How to estimate the flow from onset to apex"))]
    method: Vec<MethodSpec>,
    /// What tells a clip's class from its features
    #[arg(long, value_enum, default_value = "off-tanet")]
    classifier: ClassifierKind,
    /// Train on each dataset, on all together, or both
    #[arg(long, value_enum, default_value = "both")]
    sets: Sets,
    /// Folder for tables.{txt,csv,tex,md}, folds.csv, confusions.csv, predictions.csv, results.json and report.html
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// Overwrite these files
    #[arg(long)]
    force: bool,
    /// Folder where features are kept for other runs [default: features in --out]
    #[arg(long, value_name = "DIR")]
    cache: Option<PathBuf>,
    /// Spot the apex of clips that have none: ratio or strain
    #[arg(long, value_name = "RULE")]
    apex: Option<ApexRule>,
    /// Formula of the optical strain: literature or off-tanet
    #[arg(long, value_name = "FORMULA", default_value_t = StrainFormula::Literature)]
    strain: StrainFormula,
    /// Bring the frames to 112x112 before the flow is estimated, or the flow after
    #[arg(long, value_name = "ORDER", default_value_t = ResizeOrder::Before)]
    resize: ResizeOrder,
    /// Passes over the training clips
    #[arg(long, value_name = "N", default_value_t = Protocol::default().epochs)]
    epochs: usize,
    /// Epochs between two recordings of what is told
    #[arg(long, value_name = "N", default_value_t = Protocol::default().record_every)]
    record_every: usize,
    /// Clips in a training step
    #[arg(long, value_name = "N", default_value_t = Protocol::default().batch)]
    batch: usize,
    /// Learning rate of Adam at the start; it falls to 0.3 of itself every 60 epochs
    #[arg(long, value_name = "RATE", default_value_t = Protocol::default().learning_rate)]
    learning_rate: f64,
    /// Seed of the classifiers' parameters, the order of clips and dropout
    #[arg(long, value_name = "SEED", default_value_t = 0)]
    seed: u64,
    #[command(flatten)]
    sources: SourceArgs,
    #[command(flatten)]
    face: FaceArgs,
    #[command(flatten)]
    parameters: MethodParameters,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
enum ClassifierKind {
    /// Off-TANet: u, v and strain at 112x112
    #[value(name = "off-tanet")]
    OffTa,
    /// STSTNet: u, v and strain at 28x28
    #[value(name = "ststnet")]
    Stst,
    /// Off-ApexNet: u and v at 28x28
    #[value(name = "off-apexnet")]
    OffApex,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
enum Sets {
    /// Each dataset by itself
    Each,
    /// All datasets as one
    Composite,
    /// Each by itself, then all as one where there are several
    Both,
}

const COMPOSITE: &str = "composite";
/// The files that `--out` gets beside [`TABLE_FILES`]; the last is written when all others are.
const OUTPUTS: [&str; 3] = ["predictions.csv", "report.html", "results.json"];

#[derive(Serialize)]
struct Results {
    data: Vec<DataRecord>,
    methods: Vec<MethodRecord>,
    classifier: &'static str,
    preparation: String,
    apex: Option<&'static str>,
    protocol: Protocol,
    machine: String,
    outcomes: Vec<OutcomeRecord>,
}

#[derive(Serialize)]
struct DataRecord {
    dataset: String,
    form: &'static str,
    clips: usize,
    subjects: usize,
    dropped: usize,
    clips_with_missing_frames: Vec<String>,
    spotted_apexes: usize,
}

/// Runs the command.
pub fn run(args: Run, context: &Context) -> anyhow::Result<()> {
    ensure_free(TABLE_FILES.iter().chain(&OUTPUTS).map(|name| args.out.join(name)), args.force)?;
    let protocol = Protocol {
        epochs: args.epochs,
        record_every: args.record_every,
        batch: args.batch,
        learning_rate: args.learning_rate,
        seed: args.seed,
        ..Protocol::default()
    };
    protocol.check()?;
    let preparation = Preparation { face: args.face.crop()?, resize: args.resize, strain: args.strain };
    let estimators = methods::estimators(&args.method, &args.parameters)?;
    let methods = methods::records(&args.method, &args.parameters)?;
    let mut datasets = args.sources.open(args.data.clone())?;
    ensure!(
        datasets.len() > 1 || args.sets != Sets::Composite,
        "--sets composite needs several datasets; give more KIND:DIR, or --sets each"
    );
    let sets = sets(&datasets, args.sets);
    for (set, members) in &sets {
        let of_set = datasets.iter().filter(|dataset| members.contains(&dataset.name));
        let subjects: usize = of_set.map(|dataset| dataset.subjects().len()).sum();
        ensure!(
            subjects >= 2,
            "{set}: leaving one subject out needs clips of at least 2 subjects; found {subjects}"
        );
    }
    create_folder(&args.out)?; // before the long work, which must not be lost
    let cache = FeatureCache::open(&args.cache.clone().unwrap_or_else(|| args.out.join("features")))?;
    let spotted = match args.apex {
        Some(rule) => spot_missing(&mut datasets, rule, &preparation, estimators[0].as_ref())?,
        None => BTreeMap::new(),
    };
    let data: Vec<DataRecord> = datasets.iter().map(|dataset| data_record(dataset, &spotted)).collect();
    let clips: Vec<Clip> = datasets.iter().flat_map(|dataset| dataset.clips.iter().cloned()).collect();

    let (mut samples, mut trials, mut outcomes) = (Vec::new(), Vec::new(), Vec::new());
    for (estimator, record) in estimators.iter().zip(&methods) {
        let bar = feature_progress(clips.len(), &record.name)?;
        let method = srflow_mer::Method { estimator: estimator.as_ref(), identity: record.identity() };
        let of_method = extract(&clips, &method, &preparation, Some(&cache), &|_| bar.inc(1))?;
        samples.push((record.name.clone(), of_method));
        bar.finish_and_clear();
    }
    let progress = TrainingProgress::new(protocol.epochs)?;
    for (_, members) in &sets {
        for (_, samples) in &samples {
            progress.expect(samples.iter().filter(|sample| members.contains(&sample.dataset)));
        }
    }
    for (set, members) in &sets {
        for (method, samples) in &samples {
            let of_set = samples.iter().filter(|sample| members.contains(&sample.dataset));
            let of_set: Vec<Sample> = of_set.cloned().collect();
            progress.bar.set_message(format!("{set}, {method}"));
            let loso = train(args.classifier, &of_set, &protocol, &args.out.join("folds"), &progress)
                .with_context(|| format!("{set}, {method}"))?;
            outcomes.push(Outcome::of(method, set, &loso)?);
            trials.push(Trial { method: method.clone(), set: set.clone(), predictions: loso.predictions });
        }
    }
    progress.bar.finish_and_clear();

    let results = Results {
        data,
        methods,
        classifier: args.classifier.name(),
        preparation: preparation.to_string(),
        apex: args.apex.map(ApexRule::name),
        protocol,
        machine: machine::describe(),
        outcomes: outcomes.iter().map(Outcome::record).collect(),
    };
    let parts = ReportParts {
        outcomes: &outcomes,
        trials: &trials,
        samples: &samples,
        clips: &clips,
        face: &preparation.face,
        facts: facts(&results),
        machine: results.machine.clone(),
    };
    write(&args.out, &results, &parts)?;
    if context.json {
        return say!("{}", serde_json::to_string_pretty(&results)?);
    }
    print_scores(&outcomes)?;
    for of_set in by_set(&outcomes) {
        if let Some(note) = unseen_classes(of_set[0]) {
            say!("\n{note}")?;
        }
    }
    say!("\nReport: {}", args.out.join("report.html").display())
}

/// The named sets of datasets that are divided into subjects.
fn sets(datasets: &[ClipDataset], wanted: Sets) -> Vec<(String, Vec<String>)> {
    let names: Vec<String> = datasets.iter().map(|dataset| dataset.name.clone()).collect();
    let mut sets: Vec<(String, Vec<String>)> = Vec::new();
    if wanted != Sets::Composite {
        sets.extend(names.iter().map(|name| (name.clone(), vec![name.clone()])));
    }
    if wanted != Sets::Each && names.len() > 1 {
        sets.push((COMPOSITE.to_owned(), names));
    }
    sets
}

/// Gives an apex to clips that have none; how many by dataset.
fn spot_missing(
    datasets: &mut [ClipDataset],
    rule: ApexRule,
    preparation: &Preparation,
    estimator: &dyn srflow_field::FlowEstimator,
) -> anyhow::Result<BTreeMap<String, usize>> {
    let mut spotted = BTreeMap::new();
    for dataset in datasets {
        for clip in dataset.clips.iter_mut().filter(|clip| clip.annotation.apex.is_none()) {
            clip.annotation.apex = Some(spot_apex(clip, rule, &preparation.face, estimator)?.frame);
            *spotted.entry(dataset.name.clone()).or_default() += 1;
        }
    }
    Ok(spotted)
}

fn data_record(dataset: &ClipDataset, spotted: &BTreeMap<String, usize>) -> DataRecord {
    let missing = dataset.missing.iter();
    DataRecord {
        dataset: dataset.name.clone(),
        form: dataset.form,
        clips: dataset.clips.len(),
        subjects: dataset.subjects().len(),
        dropped: dataset.dropped.len(),
        clips_with_missing_frames: missing
            .map(|missing| format!("{}/{}", missing.subject, missing.clip))
            .collect(),
        spotted_apexes: spotted.get(&dataset.name).copied().unwrap_or(0),
    }
}

fn train(
    classifier: ClassifierKind,
    samples: &[Sample],
    protocol: &Protocol,
    folder: &Path,
    progress: &TrainingProgress,
) -> anyhow::Result<Loso> {
    let on_event = |event| progress.show(event);
    let loso: Result<Loso, LosoError> = match classifier {
        ClassifierKind::OffTa => {
            leave_one_subject_out::<OffTaNet>(samples, protocol, Some(folder), &on_event)
        }
        ClassifierKind::Stst => leave_one_subject_out::<StstNet>(samples, protocol, Some(folder), &on_event),
        ClassifierKind::OffApex => {
            leave_one_subject_out::<OffApexNet>(samples, protocol, Some(folder), &on_event)
        }
    };
    Ok(loso?)
}

impl ClassifierKind {
    fn name(self) -> &'static str {
        match self {
            Self::OffTa => OffTaNet::NAME,
            Self::Stst => StstNet::NAME,
            Self::OffApex => OffApexNet::NAME,
        }
    }
}

fn facts(results: &Results) -> Vec<(String, String)> {
    let mut facts: Vec<(String, String)> = Vec::new();
    for data in &results.data {
        let mut text =
            format!("{} clips of {} subjects, {} rows left out", data.clips, data.subjects, data.dropped);
        if data.spotted_apexes > 0 {
            text += &format!(", apex of {} clips spotted", data.spotted_apexes);
        }
        if !data.clips_with_missing_frames.is_empty() {
            text += &format!(", frames missing in {}", data.clips_with_missing_frames.join(", "));
        }
        facts.push((data.dataset.clone(), text));
    }
    let Protocol { epochs, record_every, batch, learning_rate, decay_every, decay, seed } = &results.protocol;
    facts.push(("Frames".to_owned(), results.preparation.clone()));
    facts.extend(results.methods.iter().map(|method| (method.name.clone(), method.description())));
    facts.push(("Classifier".to_owned(), results.classifier.to_owned()));
    facts.push((
        "Training".to_owned(),
        format!(
            "{epochs} epochs, recorded every {record_every}, batch {batch}, Adam {learning_rate}, times {decay} every \
             {decay_every} epochs, seed {seed}"
        ),
    ));
    facts
}

fn write(out: &Path, results: &Results, parts: &ReportParts) -> anyhow::Result<()> {
    write_tables(out, parts.outcomes)?;
    write_predictions(&out.join("predictions.csv"), parts.trials)?;
    write_text(&out.join("report.html"), &report(parts)?.html())?;
    write_text(&out.join("results.json"), &(serde_json::to_string_pretty(results)? + "\n"))
}
