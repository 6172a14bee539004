//! Micro-expression recognition with leave-one-subject-out cross-validation.

use std::fmt;
use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize, Serializer};
use srflow_core::Shard;
use srflow_data::micro_expression::ClipSource;
use srflow_files::create_folder;
use srflow_mer::{
    ClassifierEntry, Origin, Preparation, Protocol, RecognitionModel, RecognitionProtocol, ResultsFolder,
    ResultsRecord, RunError, RunFolders, RunMethod, RunResults, RunSettings, RunWatch, Sets, TrainedPart,
    all_score_tables, by_set, unseen_classes,
};

use super::model::train_model;
use super::progress::RunProgress;
use super::{PreparationArgs, SourceArgs};
use crate::clap::Args;
use crate::error::wrong_settings;
use crate::methods::{self, MethodParameters, MethodSpec, Rows, RowsArgs, default_methods};
use crate::output::{ensure_folder, ensure_free, write_line, write_page, write_tables};
use crate::rendering::{Rendered, ShardArgs};
use crate::{Job, Report, Watch, WhenStopped, machine};

/// Recognize micro-expressions with leave-one-subject-out cross-validation, and write the paper's tables
#[derive(Args, Debug, Clone, PartialEq, Serialize, Deserialize)]
#[command(after_help = format!("\
Examples:
  srflow mer run --data samm:/data/SAMM casme2:/data/CASME2 smic:/data/SMIC --method farneback tvl1 --out results
  srflow mer run --data clips:rendered --method tvl1 SRFlowNet:skflow=best.safetensors --out results
  srflow mer run --data casme2:/data/CASME2 --rows paper-tables-7-to-10 --out paper

Each dataset, and all of them together (`composite`), is split by subject: for each held-out subject a classifier is \
trained on all others and predicts the classes of that subject's clips. docs/explanation/micro-expression-protocol.md defines every number.

The protocol srflow subtracts the motion of the head from the flow and takes a linear classifier, which trains in seconds. The protocol \
paper takes Off-TANet: with its 201 epochs SAMM, CASME II, SMIC-HS and the composite take about five hours on two CPU cores for each \
method; --epochs 21 takes a tenth of that. A run can be killed at any time: run the same command again to continue after \
the last finished fold. Features are never computed twice. With --shard, several processes or machines train parts of the folds \
into one shared folder; run the command without it when they are done, which writes the results.

{}", super::sources::kinds_help()))]
pub struct RunJob {
    /// Datasets
    #[arg(long, required = true, num_args = 1.., value_name = "KIND:DIR")]
    pub data: Vec<ClipSource>,
    /// How to estimate the flow from onset to apex; by default the built-in network, unless `rows` names methods
    #[arg(
        long,
        value_name = "METHOD",
        default_values_t = default_methods(),
        default_value_if("rows", ::clap::builder::ArgPredicate::IsPresent, None),
        num_args = 1..,
        value_delimiter = ',',
        help = methods::Method::help_of_several("How to estimate the flow from onset to apex")
    )]
    #[serde(default)]
    pub method: Vec<MethodSpec>,
    /// Classifier of the features [default: the protocol's, linear or off-tanet]
    #[arg(long, value_name = "CLASSIFIER", value_enum)]
    #[serde(default)]
    pub classifier: Option<ClassifierEntry>,
    /// Evaluate each dataset by itself, all together (composite), both, or each by what was learned from the others (cross)
    #[arg(long, value_name = "SETS", value_enum, default_value_t)]
    #[serde(default)]
    pub sets: Sets,
    /// Folder for tables.{txt,csv,tex,md}, folds.csv, confusions.csv, comparisons.csv, predictions.csv, results.json and report.html
    #[arg(long, value_name = "DIR")]
    pub out: PathBuf,
    /// Overwrite these files
    #[arg(long)]
    #[serde(default)]
    pub force: bool,
    /// Also train a classifier on all clips, and save it in this folder for `srflow mer predict`
    #[arg(long, value_name = "DIR", conflicts_with = "shard")]
    #[serde(default)]
    pub save_model: Option<PathBuf>,
    /// Folder that caches features, for other runs too [default: features in --out]
    #[arg(long, value_name = "DIR")]
    #[serde(default)]
    pub cache: Option<PathBuf>,
    #[command(flatten)]
    #[serde(flatten)]
    pub protocol: Protocol,
    #[command(flatten)]
    #[serde(flatten)]
    pub shard: ShardArgs,
    #[command(flatten)]
    #[serde(flatten)]
    pub sources: SourceArgs,
    #[command(flatten)]
    #[serde(flatten)]
    pub preparation: PreparationArgs,
    #[command(flatten)]
    #[serde(flatten)]
    pub rows: RowsArgs,
    #[command(flatten)]
    #[serde(flatten)]
    pub parameters: MethodParameters,
}

impl RunJob {
    /// A run on these datasets with the built-in network and the default protocol, with results in the folder `out`.
    pub fn new(data: Vec<ClipSource>, out: impl Into<PathBuf>) -> Self {
        Self {
            data,
            method: default_methods(),
            classifier: None,
            sets: Sets::default(),
            out: out.into(),
            force: false,
            save_model: None,
            cache: None,
            protocol: Protocol::default(),
            shard: ShardArgs::default(),
            sources: SourceArgs::default(),
            preparation: PreparationArgs::default(),
            rows: RowsArgs::default(),
            parameters: MethodParameters::default(),
        }
    }
}

impl RunJob {
    /// The protocol that was named; otherwise the paper's for the rows of its tables.
    fn recognition(&self) -> RecognitionProtocol {
        self.preparation.protocol.unwrap_or_else(|| match self.rows.rows.as_deref() {
            Some("paper-tables-7-to-10") => RecognitionProtocol::Paper,
            _ => RecognitionProtocol::default(),
        })
    }
}

impl RunJob {
    /// Whether a model can be made of this run.
    fn check_model(&self, folder: &Path, methods: &[MethodSpec], datasets: usize) -> anyhow::Result<()> {
        if methods.len() != 1 {
            wrong_settings!("`save_model` saves one model: give one `method`, not {}", methods.len());
        }
        if matches!(self.sets, Sets::Each | Sets::Cross) && datasets > 1 {
            wrong_settings!("`save_model` takes all datasets together: give `sets` composite or both");
        }
        ensure_free([RecognitionModel::card_path(folder)], self.force)
    }
}

impl Job for RunJob {
    const NAME: &'static str = "mer run";
    const WHEN_STOPPED: WhenStopped = WhenStopped::UnitsKept;

    type Report = RunReport;

    fn work(&self, watch: &Watch) -> anyhow::Result<RunReport> {
        ensure_folder(&self.out)?;
        let folder = ResultsFolder::open(&self.out, self.force)?;
        let recognition = self.recognition();
        let classifier = self.classifier.unwrap_or_else(|| recognition.classifier());
        classifier.check(&self.protocol)?;
        let given = match self.method.is_empty() && self.rows.rows.is_none() {
            true => default_methods(),
            false => self.method.clone(),
        };
        let Rows { methods: specs, left_out, .. } = self.rows.with(&given, watch)?;
        let mut settings = RunSettings {
            recognition,
            classifier,
            sets: self.sets,
            apex: self.preparation.apex,
            preparation: Preparation::default(),
            protocol: self.protocol.clone(),
            classes: self.sources.classes()?.names().clone(),
            left_out,
        };
        let estimators = methods::estimators(&specs, &self.parameters, watch)?;
        let records = methods::records(&specs, &self.parameters, watch)?;
        let methods = estimators.iter().zip(records);
        let methods = methods.map(|(estimator, record)| RunMethod { estimator: estimator.as_ref(), record });
        let (datasets, _frames) = self.sources.open(&self.data, self.preparation.apex.is_some(), watch)?;
        settings.check(&datasets)?;
        if let Some(folder) = &self.save_model {
            self.check_model(folder, &specs, datasets.len())?;
        }
        create_folder(&self.out)?; // before the long work, so that an error costs nothing
        let landmarks = || self.out.join("landmarks.csv");
        settings.preparation =
            self.preparation.preparation(recognition, &datasets, landmarks, self.force, watch)?;
        let folders = RunFolders {
            features: &self.cache.clone().unwrap_or_else(|| self.out.join("features")),
            folds: &folder.folds(),
        };
        let progress = RunProgress::new(watch);
        let run_watch = RunWatch { on_event: &|event| progress.show(event), stop: watch.stop };
        let shard = self.shard.taken()?;
        if shard.shard != Shard::WHOLE {
            let (part, methods) = (shard.shard, methods.collect());
            let trained = srflow_mer::run_part(datasets, methods, &settings, folders, part, run_watch);
            return Ok(match trained {
                Ok(trained) => RunReport::Part(Rendered { report: trained, shard }),
                Err(RunError::Stopped) => RunReport::Stopped { complete: false },
                Err(error) => return Err(error.into()),
            });
        }
        let results = match srflow_mer::run(datasets, methods.collect(), settings, folders, run_watch) {
            Ok(results) => Box::new(results),
            Err(RunError::Stopped) => return Ok(RunReport::Stopped { complete: false }),
            Err(error) => return Err(error.into()),
        };
        let origin = Origin {
            date: chrono::Utc::now().to_rfc3339_opts(chrono::SecondsFormat::Secs, true),
            machine: machine::describe(),
            job: serde_json::to_value(self)?,
        };
        folder.write(&results, &origin)?;
        if let Some(model) = &self.save_model {
            train_model(&results, specs[0].to_string(), &origin.date)?.write(model)?;
        }
        Ok(RunReport::Results(Results { results, origin, page: folder.report() }))
    }
}

/// What a [`RunJob`] has done.
#[derive(Debug, Serialize)]
#[serde(untagged)]
pub enum RunReport {
    /// The results of all folds.
    Results(Results),
    /// A part of the folds is trained.
    Part(Rendered<TrainedPart>),
    /// The run was stopped before its last fold; `complete` is `false`.
    Stopped { complete: bool },
}

/// The results of a run, as its folder holds them.
#[derive(Debug)]
pub struct Results {
    pub results: Box<RunResults>,
    pub origin: Origin,
    /// The report for a browser.
    pub page: PathBuf,
}

impl Serialize for Results {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        ResultsRecord::of(&self.results, &self.origin).serialize(serializer)
    }
}

impl Report for RunReport {
    fn stopped(&self) -> bool {
        matches!(self, Self::Stopped { .. })
    }
}

impl fmt::Display for RunReport {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        match self {
            Self::Results(results) => results.fmt(f),
            Self::Part(Rendered { report: TrainedPart { folds, all_folds }, shard }) => writeln!(
                f,
                "Part {} is complete: {folds} of {all_folds} folds. When all parts are, the same command without --shard writes the results.",
                shard.shard
            ),
            Self::Stopped { .. } => {
                writeln!(f, "Stopped; the same run continues after the last finished fold")
            }
        }
    }
}

impl fmt::Display for Results {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        let RunResults { outcomes, settings, .. } = &*self.results;
        write_line(f, format_args!("{}", settings.heading()))?;
        writeln!(f)?;
        write_tables(f, &all_score_tables(outcomes, &settings.left_out))?;
        for of_set in by_set(outcomes) {
            if let Some(note) = unseen_classes(of_set[0]) {
                writeln!(f)?;
                write_line(f, format_args!("{note}"))?;
            }
        }
        write_page(f, &self.page)
    }
}
