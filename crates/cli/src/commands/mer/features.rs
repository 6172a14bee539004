use std::path::PathBuf;

use clap::Args;
use serde::Serialize;
use srflow_eval::MethodRecord;
use srflow_mer::{DataRecord, FEATURE_SIDE, FeatureRecipe, RunMethod, compute_features, write_features};
use srflow_read::micro_expression::ClipSource;

use super::preparation::PreparationArgs;
use super::progress::RunProgress;
use super::sources::{SourceArgs, kinds_help};
use crate::Context;
use crate::methods::{self, Method, MethodParameters, MethodSpec};
use crate::output::{ensure_extension, ensure_free};

/// Write flow and strain of every clip as one NumPy archive, for your own classifiers
#[derive(Args)]
#[command(after_help = format!("\
Examples:
  srflow mer features --data samm:/data/SAMM casme2:/data/CASME2 --method tvl1 --out features.npz
  srflow mer features --data casme2:/data/CASME2 --classes casme2-5 --method SRFlowNet:skflow=best.safetensors --out five.npz

In Python:
  f = numpy.load('features.npz')
  f['X'], f['y']           # (N, 3, 112, 112) float32: u, v, strain; numbers of classes
  f['subject'], f['clip'], f['dataset'], f['method'], f['names'], json.loads(f['parameters'].item())

With several methods the clips of the first come before those of the next.

{}", kinds_help()))]
pub struct Features {
    /// Datasets
    #[arg(long, required = true, num_args = 1.., value_name = "KIND:DIR")]
    data: Vec<ClipSource>,
    /// How to estimate the flow from onset to apex
    #[arg(long, value_name = "METHOD", default_value = Method::DEFAULT.name(), num_args = 1.., value_delimiter = ',', help = Method::help_of_several("How to estimate the flow from onset to apex"))]
    method: Vec<MethodSpec>,
    /// Archive to write
    #[arg(short, long, value_name = "FILE.npz")]
    out: PathBuf,
    /// Overwrite an existing archive
    #[arg(long)]
    force: bool,
    /// Folder that caches each clip's features, shared with `srflow mer run` [default: none]
    #[arg(long, value_name = "DIR")]
    cache: Option<PathBuf>,
    #[command(flatten)]
    sources: SourceArgs,
    #[command(flatten)]
    preparation: PreparationArgs,
    #[command(flatten)]
    parameters: MethodParameters,
}

#[derive(Serialize)]
struct Report {
    output: PathBuf,
    shape: [usize; 4],
    classes: Vec<String>,
    methods: Vec<MethodRecord>,
    data: Vec<DataRecord>,
}

pub fn run(args: Features, context: &Context) -> anyhow::Result<()> {
    ensure_extension(&args.out, "npz")?;
    ensure_free([&args.out], args.force)?;
    let classes = args.sources.classes()?;
    let estimators = methods::estimators(&args.method, &args.parameters, &crate::run::WATCH)?;
    let records = methods::records(&args.method, &args.parameters, &crate::run::WATCH)?;
    let of_run = estimators.iter().zip(records.clone());
    let of_run: Vec<RunMethod> =
        of_run.map(|(estimator, record)| RunMethod { estimator: estimator.as_ref(), record }).collect();
    let datasets = args.sources.open(args.data)?;
    let landmarks = || args.out.with_extension("landmarks.csv");
    let preparation = args.preparation.preparation(&datasets, landmarks, args.force)?;

    let progress = RunProgress::default();
    let apex = args.preparation.apex;
    let cache = args.cache.as_deref();
    let set = compute_features(datasets, &of_run, apex, &preparation, cache, &|event| progress.show(event))?;
    progress.finish();
    let recipe =
        FeatureRecipe { classes: classes.names(), methods: &records, preparation: &preparation, apex };
    write_features(&args.out, &set, &recipe)?;
    let count = set.samples.iter().map(|(_, samples)| samples.len()).sum();
    let report = Report {
        output: args.out,
        shape: [count, 3, FEATURE_SIDE, FEATURE_SIDE],
        classes: classes.names().to_vec(),
        methods: records,
        data: set.data,
    };
    if context.json {
        return crate::output::print_json(&report);
    }
    say!(
        "{}: X {:?}, {} classes: {}",
        report.output.display(),
        report.shape,
        classes.names().len(),
        classes.names().join(", ")
    )?;
    for data in &report.data {
        say!(
            "  {}: {} clips of {} subjects, {} rows left out",
            data.dataset,
            data.clips,
            data.subjects,
            data.dropped
        )?;
    }
    Ok(())
}
