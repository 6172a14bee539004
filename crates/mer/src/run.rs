//! A whole run: features of every clip for every flow method, then leave-one-subject-out training of classifiers.

use std::path::Path;
use std::sync::Arc;

use serde::{Deserialize, Serialize};
use srflow_core::{FlowEstimator, Shard};
use srflow_data::micro_expression::{Clip, ClipDataset};
use srflow_eval::MethodRecord;
use srflow_files::FileError;

use crate::apex::{ApexRule, fill_apexes};
use crate::cache::FeatureCache;
use crate::clap::ValueEnum;
use crate::classifier::ClassifierEntry;
use crate::extract::{Extracted, Method, Preparation, extract};
use crate::extract_error::{ExtractError, ExtractProblem};
use crate::loso::{FoldFolder, LeftOut, Loso, LosoError, LosoEvent, LosoWatch, leave_out};
use crate::outcome::Outcome;
use crate::predictions::Trial;
use crate::protocol::{Protocol, ProtocolError};
use crate::recognition_protocol::RecognitionProtocol;
use crate::sample::Sample;
use crate::summary::SummaryError;

/// Name of the set that combines all datasets.
const COMPOSITE: &str = "composite";

/// Before the name of a dataset that is held out as a whole.
const CROSS: &str = "cross-";

/// The settings that a run's results depend on, apart from clips and flow methods.
#[derive(Debug, Clone)]
pub struct RunSettings {
    /// The protocol that was named; what it stands for may be set otherwise below.
    pub recognition: RecognitionProtocol,
    pub classifier: ClassifierEntry,
    /// The sets of clips to evaluate.
    pub sets: Sets,
    /// How to spot the apex of clips without one; `None` makes such a clip an error.
    pub apex: Option<ApexRule>,
    pub preparation: Preparation,
    pub protocol: Protocol,
    pub classes: Arc<[String]>,
    /// Rows of the tables that were asked for and are not there, a sentence each.
    pub left_out: Vec<String>,
}

/// The sets of clips to evaluate.
#[derive(ValueEnum, Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Sets {
    /// Each dataset by itself.
    Each,
    /// All datasets as one.
    Composite,
    /// Each by itself, then all as one where there are several.
    #[default]
    Both,
    /// Each dataset, by what was learned from all others.
    Cross,
}

/// A set of clips that is evaluated.
struct ClipSet {
    name: String,
    /// The datasets whose clips are used.
    members: Vec<String>,
    /// The one of them that is held out as a whole; otherwise each subject is, one after the other.
    held_out: Option<String>,
}

impl ClipSet {
    fn folds(&self, data: &[DataRecord]) -> usize {
        if self.held_out.is_some() { 1 } else { sum(data, &self.members, |data| data.subjects) }
    }

    /// Clips that are trained on, over all folds.
    fn training_clips(&self, data: &[DataRecord]) -> usize {
        let clips = |datasets: &[String]| sum(data, datasets, |data| data.clips);
        match &self.held_out {
            None => clips(&self.members) * (self.folds(data) - 1),
            Some(held_out) => clips(&self.members) - clips(std::slice::from_ref(held_out)),
        }
    }
}

/// Over the data of these datasets.
fn sum(data: &[DataRecord], datasets: &[String], of: fn(&DataRecord) -> usize) -> usize {
    data.iter().filter(|data| datasets.contains(&data.dataset)).map(of).sum()
}

pub struct RunMethod<'a> {
    pub estimator: &'a dyn FlowEstimator,
    /// Its name in the results, and everything its flow depends on.
    pub record: MethodRecord,
}

/// Progress of a run, reported from any thread.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum RunEvent<'a> {
    /// Apexes are about to be spotted.
    Apexes {
        /// Number of clips without an apex.
        clips: usize,
    },
    /// Features are about to be computed.
    Features {
        method: &'a str,
        /// Number of clips in all datasets.
        clips: usize,
    },
    /// The apex or the features of one more clip are done.
    Clip,
    Training {
        /// Clips times epochs over all folds, sets and methods, to which training time is proportional.
        clip_epochs: u64,
    },
    /// Training on a set with the features of a flow method is about to start.
    Folds { set: &'a str, method: &'a str },
    /// A fold finished another epoch.
    Trained {
        /// Its share of [`RunEvent::Training`].
        clip_epochs: u64,
    },
    /// A fold of an earlier run was loaded.
    Resumed {
        /// Its share of [`RunEvent::Training`].
        clip_epochs: u64,
    },
}

/// Follows a run, and can stop it. Both functions are called from any thread.
#[derive(Clone, Copy)]
pub struct RunWatch<'a> {
    pub on_event: &'a (dyn Fn(RunEvent) + Sync),
    /// The run ends with [`RunError::Stopped`] soon after this is true; finished folds and features are kept.
    pub stop: &'a (dyn Fn() -> bool + Sync),
}

/// Folders with reusable results.
#[derive(Debug, Clone, Copy)]
pub struct RunFolders<'a> {
    /// Features, shared between runs.
    pub features: &'a Path,
    pub folds: &'a Path,
}

/// A part of the folds of a run, trained.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
pub struct TrainedPart {
    /// Folds of the part.
    pub folds: u64,
    /// Folds of all sets and flow methods.
    pub all_folds: u64,
}

/// The results of a run; [`ResultsFolder::write`](crate::ResultsFolder::write) writes them to files.
#[derive(Debug)]
pub struct RunResults {
    pub settings: RunSettings,
    /// The clips with their features.
    pub features: FeatureSet,
    /// The flow methods, in the order of the results.
    pub methods: Vec<MethodRecord>,
    /// Predictions, by set, then flow method.
    pub trials: Vec<Trial>,
    /// Scores of each trial, in the same order.
    pub outcomes: Vec<Outcome>,
}

/// A dataset in the results.
#[derive(Debug, Clone, Serialize)]
pub struct DataRecord {
    /// Its name, e.g. `casme2`.
    pub dataset: String,
    /// The published form of the dataset, e.g. cropped.
    pub form: &'static str,
    pub clips: usize,
    pub subjects: usize,
    pub dropped: usize,
    /// Clips with missing frames, as subject/clip.
    pub clips_with_missing_frames: Vec<String>,
    /// Number of clips whose apex was spotted.
    pub spotted_apexes: usize,
}

/// Why a run failed.
#[derive(Debug, thiserror::Error)]
pub enum RunError {
    /// It was asked to stop.
    #[error("stopped on request; the same run continues after the last finished fold")]
    Stopped,
    /// A value of the protocol is out of range.
    #[error(transparent)]
    Protocol(#[from] ProtocolError),
    #[error(
        "the sets composite and cross need several datasets, found {0}; give more, or take each by itself"
    )]
    SeveralDatasets(usize),
    #[error("{set}: leaving one subject out needs clips of at least 2 subjects; found {found}")]
    Subjects { set: String, found: usize },
    /// The features of a clip could not be computed.
    #[error(transparent)]
    Extract(ExtractError),
    /// A fold failed.
    #[error("{set}, {method}: {error}")]
    Training {
        set: String,
        method: String,
        #[source]
        error: LosoError,
    },
    /// The predictions cannot be scored.
    #[error(transparent)]
    Scores(#[from] SummaryError),
    /// A folder cannot be created.
    #[error(transparent)]
    File(#[from] FileError),
}

impl From<ExtractError> for RunError {
    fn from(error: ExtractError) -> Self {
        match error.problem {
            ExtractProblem::Stopped => Self::Stopped,
            _ => Self::Extract(error),
        }
    }
}

impl RunSettings {
    /// The first line of results: the protocol, the frames and the classifier.
    pub fn heading(&self) -> String {
        let Self { recognition, preparation, .. } = self;
        format!("Protocol {recognition}: {preparation}; classifier {}", self.training())
    }

    /// The classifier, and what its training does with clips, e.g. `linear, balance: weights`.
    pub(crate) fn training(&self) -> String {
        format!("{}{}", self.classifier, self.protocol.changed_clips())
    }

    /// Checks whether these datasets can be evaluated.
    ///
    /// # Errors
    /// When the protocol is out of range, or a set has fewer than two subjects.
    pub fn check(&self, datasets: &[ClipDataset]) -> Result<(), RunError> {
        self.classifier.check(&self.protocol)?;
        if datasets.len() < 2 && matches!(self.sets, Sets::Composite | Sets::Cross) {
            return Err(RunError::SeveralDatasets(datasets.len()));
        }
        for set in sets(datasets, self.sets) {
            let of_set = datasets.iter().filter(|dataset| set.members.contains(&dataset.name));
            let found: usize = of_set.map(|dataset| dataset.subjects().len()).sum();
            if found < 2 && set.held_out.is_none() {
                return Err(RunError::Subjects { set: set.name, found });
            }
        }
        Ok(())
    }
}

/// Trains and scores a classifier for each set and flow method. Results of an earlier run in `folders` are reused; the results
/// are bit-identical with and without them.
///
/// # Errors
/// Those of [`RunSettings::check`]; when a frame cannot be used, training diverges, or a folder cannot be written.
pub fn run(
    datasets: Vec<ClipDataset>,
    methods: Vec<RunMethod>,
    settings: RunSettings,
    folders: RunFolders,
    watch: RunWatch,
) -> Result<RunResults, RunError> {
    let (mut trials, mut outcomes) = (Vec::new(), Vec::new());
    let all = Shard::WHOLE;
    let (features, _) =
        train_folds(datasets, &methods, &settings, folders, all, watch, &mut |set, method, loso| {
            outcomes.push(Outcome::of(method, set, &loso)?);
            let Loso { classes, predictions, .. } = loso;
            trials.push(Trial { method: method.to_owned(), set: set.to_owned(), classes, predictions });
            Ok(())
        })?;
    let methods = methods.into_iter().map(|method| method.record).collect();
    Ok(RunResults { settings, features, methods, trials, outcomes })
}

/// Trains the folds of one part of a run, and stores them in `folders`, where [`run`] finds them.
///
/// # Errors
/// Those of [`run`].
pub fn run_part(
    datasets: Vec<ClipDataset>,
    methods: Vec<RunMethod>,
    settings: &RunSettings,
    folders: RunFolders,
    part: Shard,
    watch: RunWatch,
) -> Result<TrainedPart, RunError> {
    let (_, part) = train_folds(datasets, &methods, settings, folders, part, watch, &mut |_, _, _| Ok(()))?;
    Ok(part)
}

/// Trains the folds of a part, those of all sets and methods in order. `on_trained` takes those of a set and method.
fn train_folds(
    datasets: Vec<ClipDataset>,
    methods: &[RunMethod],
    settings: &RunSettings,
    folders: RunFolders,
    part: Shard,
    watch: RunWatch,
    on_trained: &mut dyn FnMut(&str, &str, Loso) -> Result<(), RunError>,
) -> Result<(FeatureSet, TrainedPart), RunError> {
    settings.check(&datasets)?;
    let on_event = watch.on_event;
    let RunSettings { classifier, preparation, protocol, classes, .. } = settings;
    let sets = sets(&datasets, settings.sets);
    let features =
        compute_features(datasets, methods, settings.apex, preparation, Some(folders.features), watch)?;
    let FeatureSet { data, samples, .. } = &features;

    let epochs = classifier.epochs(protocol) as u64;
    let all_folds = sets.iter().map(|set| set.folds(data)).sum::<usize>() * methods.len();
    let wanted = part.range(all_folds as u64);
    // Of a part, about its share.
    let clips = sets.iter().map(|set| set.training_clips(data)).sum::<usize>() * methods.len();
    let clip_epochs = (clips * protocol.seeds) as u64 * epochs;
    on_event(RunEvent::Training { clip_epochs: clip_epochs / u64::from(part.of) });
    let on_fold = |event| match event {
        LosoEvent::Epoch { clips } => on_event(RunEvent::Trained { clip_epochs: clips as u64 }),
        LosoEvent::Fold { clips, resumed: true } => {
            on_event(RunEvent::Resumed { clip_epochs: clips as u64 * epochs });
        }
        LosoEvent::Fold { resumed: false, .. } => {}
    };
    let mut before = 0;
    for set in &sets {
        for (method, samples) in samples {
            let first = before;
            before += set.folds(data) as u64;
            let within = |fold: u64| (fold.clamp(first, before) - first) as usize;
            let of_part = within(wanted.start)..within(wanted.end);
            if of_part.is_empty() {
                continue;
            }
            on_event(RunEvent::Folds { set: &set.name, method });
            let of_set = samples.iter().filter(|sample| set.members.contains(&sample.dataset));
            let of_set: Vec<Sample> = of_set.cloned().collect();
            let folder = Some(FoldFolder { path: folders.folds, part: of_part });
            let left_out = set.held_out.as_deref().map_or(LeftOut::EachSubject, LeftOut::Dataset);
            let watch = LosoWatch { on_event: &on_fold, stop: watch.stop };
            let loso = leave_out(left_out, classifier, &of_set, classes, protocol, folder, watch);
            let loso = loso.map_err(|error| match error {
                LosoError::Stopped => RunError::Stopped,
                error => RunError::Training { set: set.name.clone(), method: method.clone(), error },
            })?;
            on_trained(&set.name, method, loso)?;
        }
    }
    let trained = TrainedPart { folds: wanted.end - wanted.start, all_folds: all_folds as u64 };
    Ok((features, trained))
}

/// The training data and its provenance.
#[derive(Debug)]
pub struct FeatureSet {
    /// The data used, by dataset.
    pub data: Vec<DataRecord>,
    /// The clips of all datasets, each with its apex.
    pub clips: Vec<Clip>,
    /// For each clip whether its apex was spotted, not annotated.
    pub apex_spotted: Vec<bool>,
    /// Features of the clips, in order, by flow method.
    pub samples: Vec<(String, Vec<Sample>)>,
}

/// Computes the features of every clip for every flow method, except those in the folder `cache`. The apex of clips without one is
/// spotted by the rule, with the flow of the first method.
///
/// # Errors
/// When a frame cannot be used, a clip has no apex and there is no rule, or the folder cannot be written.
pub fn compute_features(
    mut datasets: Vec<ClipDataset>,
    methods: &[RunMethod],
    apex: Option<ApexRule>,
    preparation: &Preparation,
    cache: Option<&Path>,
    watch: RunWatch,
) -> Result<FeatureSet, RunError> {
    let RunWatch { on_event, stop } = watch;
    let cache = cache.map(FeatureCache::open).transpose()?;
    let unknown = |clip: &Clip| clip.annotation.apex.is_none();
    let (mut data, mut apex_spotted) = (Vec::new(), Vec::new());
    for dataset in &mut datasets {
        apex_spotted.extend(dataset.clips.iter().map(unknown));
        let spotted_apexes = match (apex, methods.first()) {
            (Some(rule), Some(method)) => {
                let without = dataset.clips.iter().filter(|clip| unknown(clip)).count();
                on_event(RunEvent::Apexes { clips: without });
                let on_clip = || on_event(RunEvent::Clip);
                fill_apexes(&mut dataset.clips, rule, preparation, method.estimator, &on_clip)?
            }
            _ => 0,
        };
        data.push(DataRecord::of(dataset, spotted_apexes));
    }
    let clips: Vec<Clip> = datasets.into_iter().flat_map(|dataset| dataset.clips).collect();
    let mut samples: Vec<(String, Vec<Sample>)> = Vec::new();
    for RunMethod { estimator, record } in methods {
        on_event(RunEvent::Features { method: &record.name, clips: clips.len() });
        let method = Method { estimator: *estimator, identity: record.identity.to_string() };
        let on_clip = |_: Extracted| on_event(RunEvent::Clip);
        let of_method = extract(&clips, &method, preparation, cache.as_ref(), &on_clip, stop)?;
        samples.push((record.name.clone(), of_method));
    }
    Ok(FeatureSet { data, clips, apex_spotted, samples })
}

/// The sets of a run, in the order of the results.
fn sets(datasets: &[ClipDataset], wanted: Sets) -> Vec<ClipSet> {
    let names: Vec<String> = datasets.iter().map(|dataset| dataset.name.clone()).collect();
    let mut sets: Vec<ClipSet> = Vec::new();
    if matches!(wanted, Sets::Each | Sets::Both) {
        let alone =
            |name: &String| ClipSet { name: name.clone(), members: vec![name.clone()], held_out: None };
        sets.extend(names.iter().map(alone));
    }
    if wanted == Sets::Cross {
        sets.extend(names.iter().map(|name| ClipSet {
            name: format!("{CROSS}{name}"),
            members: names.clone(),
            held_out: Some(name.clone()),
        }));
    }
    if matches!(wanted, Sets::Composite | Sets::Both) && names.len() > 1 {
        sets.push(ClipSet { name: COMPOSITE.to_owned(), members: names, held_out: None });
    }
    sets
}

impl DataRecord {
    fn of(dataset: &ClipDataset, spotted_apexes: usize) -> Self {
        let missing = dataset.missing.iter();
        Self {
            dataset: dataset.name.clone(),
            form: dataset.form,
            clips: dataset.clips.len(),
            subjects: dataset.subjects().len(),
            dropped: dataset.dropped.len(),
            clips_with_missing_frames: missing
                .map(|missing| format!("{}/{}", missing.subject, missing.clip))
                .collect(),
            spotted_apexes,
        }
    }
}
