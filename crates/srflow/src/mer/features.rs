//! Flow and strain of every clip as one NumPy archive.

use std::fmt;
use std::path::PathBuf;

use serde::{Deserialize, Serialize};
use srflow_data::micro_expression::ClipSource;
use srflow_eval::MethodRecord;
use srflow_mer::{
    DataRecord, FEATURE_SIDE, FeatureRecipe, Regions, RunMethod, RunWatch, compute_features, write_features,
};

use super::progress::RunProgress;
use super::{PreparationArgs, SourceArgs};
use crate::clap::Args;
use crate::methods::{self, MethodParameters, MethodSpec, default_methods};
use crate::output::{ensure_extension, ensure_free, write_line};
use crate::{Job, Report, Watch};

/// Write flow and strain of every clip as one NumPy archive, for your own classifiers
#[derive(Args, Debug, Clone, PartialEq, Serialize, Deserialize)]
#[command(after_help = format!("\
Examples:
  srflow mer features --data samm:/data/SAMM casme2:/data/CASME2 --method tvl1 --out features.npz
  srflow mer features --data casme2:/data/CASME2 --classes casme2-5 --method SRFlowNet:skflow=best.safetensors --out five.npz

In Python:
  f = numpy.load('features.npz')
  f['X'], f['y']           # (N, 3, 112, 112) float32: u, v, strain; numbers of classes
  f['subject'], f['clip'], f['dataset'], f['method'], f['names'], json.loads(f['parameters'].item())
  f['onset'], f['apex'], f['offset'], f['apex_spotted'], f['action_units'], f['head_motion']
  f['regions'], f['region_names'], f['region_map'], f['units'], f['unit_numbers']   # with --regions

With several methods the clips of the first come before those of the next.

{}", super::sources::kinds_help()))]
pub struct FeaturesJob {
    /// Datasets
    #[arg(long, required = true, num_args = 1.., value_name = "KIND:DIR")]
    pub data: Vec<ClipSource>,
    /// How to estimate the flow from onset to apex
    #[arg(
        long,
        value_name = "METHOD",
        default_values_t = default_methods(),
        num_args = 1..,
        value_delimiter = ',',
        help = methods::Method::help_of_several("How to estimate the flow from onset to apex")
    )]
    #[serde(default = "default_methods")]
    pub method: Vec<MethodSpec>,
    /// Archive to write
    #[arg(short, long, value_name = "FILE.npz")]
    pub out: PathBuf,
    /// Overwrite an existing archive
    #[arg(long)]
    #[serde(default)]
    pub force: bool,
    /// Also write how regions of the face and action units move: parts (brows, eyes, cheeks and so on) or mdmo (the 36 of MDMO)
    #[arg(long, value_name = "WHICH")]
    #[serde(default)]
    pub regions: Option<Regions>,
    /// Folder that caches each clip's features, shared with `srflow mer run` [default: none]
    #[arg(long, value_name = "DIR")]
    #[serde(default)]
    pub cache: Option<PathBuf>,
    #[command(flatten)]
    #[serde(flatten)]
    pub sources: SourceArgs,
    #[command(flatten)]
    #[serde(flatten)]
    pub preparation: PreparationArgs,
    #[command(flatten)]
    #[serde(flatten)]
    pub parameters: MethodParameters,
}

impl FeaturesJob {
    /// Writes the features of these datasets to the archive `out`.
    pub fn new(data: Vec<ClipSource>, out: impl Into<PathBuf>) -> Self {
        Self {
            data,
            method: default_methods(),
            out: out.into(),
            force: false,
            regions: None,
            cache: None,
            sources: SourceArgs::default(),
            preparation: PreparationArgs::default(),
            parameters: MethodParameters::default(),
        }
    }
}

impl Job for FeaturesJob {
    const NAME: &'static str = "mer features";

    type Report = FeaturesReport;

    fn work(&self, watch: &Watch) -> anyhow::Result<FeaturesReport> {
        ensure_extension(&self.out, "npz")?;
        ensure_free([&self.out], self.force)?;
        let classes = self.sources.classes()?;
        let estimators = methods::estimators(&self.method, &self.parameters, watch)?;
        let records = methods::records(&self.method, &self.parameters, watch)?;
        let methods = estimators.iter().zip(records.clone());
        let methods: Vec<RunMethod> =
            methods.map(|(estimator, record)| RunMethod { estimator: estimator.as_ref(), record }).collect();
        let (datasets, _frames) = self.sources.open(&self.data, self.preparation.apex.is_some(), watch)?;
        let landmarks = || self.out.with_extension("landmarks.csv");
        let protocol = self.preparation.protocol.unwrap_or_default();
        let preparation = self.preparation.preparation(protocol, &datasets, landmarks, self.force, watch)?;

        let progress = RunProgress::new(watch);
        let apex = self.preparation.apex;
        let cache = self.cache.as_deref();
        let run_watch = RunWatch { on_event: &|event| progress.show(event), stop: watch.stop };
        let set = compute_features(datasets, &methods, apex, &preparation, cache, run_watch)?;
        let recipe = FeatureRecipe {
            classes: classes.names(),
            methods: &records,
            preparation: &preparation,
            apex,
            regions: self.regions,
        };
        write_features(&self.out, &set, &recipe)?;
        let count = set.samples.iter().map(|(_, samples)| samples.len()).sum();
        Ok(FeaturesReport {
            output: self.out.clone(),
            shape: [count, 3, FEATURE_SIDE, FEATURE_SIDE],
            classes: classes.names().to_vec(),
            methods: records,
            data: set.data,
        })
    }
}

/// The archive that was written.
#[derive(Debug, Clone, Serialize)]
pub struct FeaturesReport {
    pub output: PathBuf,
    /// Of the array X: clips times methods, channels, height, width.
    pub shape: [usize; 4],
    pub classes: Vec<String>,
    pub methods: Vec<MethodRecord>,
    pub data: Vec<DataRecord>,
}

impl Report for FeaturesReport {}

impl fmt::Display for FeaturesReport {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        let Self { output, shape, classes, .. } = self;
        let names = classes.join(", ");
        write_line(f, format_args!("{}: X {shape:?}, {} classes: {names}", output.display(), classes.len()))?;
        for DataRecord { dataset, clips, subjects, dropped, .. } in &self.data {
            write_line(
                f,
                format_args!("  {dataset}: {clips} clips of {subjects} subjects, {dropped} rows left out"),
            )?;
        }
        Ok(())
    }
}
