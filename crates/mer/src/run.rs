//! A whole run: features of every clip by every flow method, then classifiers trained leaving one subject out.

use std::path::Path;
use std::sync::Arc;

use serde::Serialize;
use srflow_eval::MethodRecord;
use srflow_field::{FileError, FlowEstimator};
use srflow_read::micro_expression::{Clip, ClipDataset};

use crate::apex::{ApexRule, fill_apexes};
use crate::cache::FeatureCache;
use crate::classifier::ClassifierEntry;
use crate::extract::{ExtractError, Method, Preparation, extract};
use crate::features::Sample;
use crate::loso::{Loso, LosoError, LosoEvent};
use crate::predictions::Trial;
use crate::protocol::{Protocol, ProtocolError};
use crate::results::Outcome;
use crate::summary::SummaryError;

/// Name of the set of all datasets.
const COMPOSITE: &str = "composite";

/// Everything that decides the numbers of a run beside its clips and flow methods.
#[derive(Debug, Clone)]
pub struct RunSettings {
    /// Which classifier is trained.
    pub classifier: &'static ClassifierEntry,
    /// Which sets of clips are divided into subjects.
    pub sets: Sets,
    /// How the apex is spotted of clips that have none; without a rule, such a clip is an error.
    pub apex: Option<ApexRule>,
    /// From frames to features.
    pub preparation: Preparation,
    /// How classifiers are trained.
    pub protocol: Protocol,
    /// Names of the classes that the clips of the datasets are divided into.
    pub classes: Arc<[String]>,
}

/// Which sets of clips are divided into subjects.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Sets {
    /// Each dataset by itself.
    Each,
    /// All datasets as one, called `composite`.
    Composite,
    /// Each by itself, then all as one where there are several.
    Both,
}

/// A flow method of a run.
pub struct RunMethod<'a> {
    pub estimator: &'a dyn FlowEstimator,
    /// Its name in the results, and what its flow depends on.
    pub record: MethodRecord,
}

/// Progress of a run, from any thread.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum RunEvent<'a> {
    /// The apex of this many clips is going to be spotted.
    Apexes {
        /// Clips without an apex.
        clips: usize,
    },
    /// Features are going to be computed.
    Features {
        method: &'a str,
        /// Clips of all datasets.
        clips: usize,
    },
    /// The apex or the features of one more clip are computed.
    Clip,
    Training {
        /// Clips that all folds of all sets and methods are trained on, times the epochs. Time follows this number.
        clip_epochs: u64,
    },
    /// The folds of a set are going to be trained on the features of a flow method.
    Folds { set: &'a str, method: &'a str },
    /// A fold was trained for another epoch.
    Trained {
        /// As many of the [`RunEvent::Training`].
        clip_epochs: u64,
    },
    /// A fold that an earlier run has finished was read.
    Resumed {
        /// As many of the [`RunEvent::Training`].
        clip_epochs: u64,
    },
}

/// Folders of results that are reused.
#[derive(Debug, Clone, Copy)]
pub struct RunFolders<'a> {
    /// Of features, for any run.
    pub features: &'a Path,
    /// Of finished folds.
    pub folds: &'a Path,
}

/// What a run gives; [`ResultsFolder::write`](crate::ResultsFolder::write) makes files of it.
#[derive(Debug)]
pub struct RunResults {
    pub settings: RunSettings,
    /// By dataset, what was used of it.
    pub data: Vec<DataRecord>,
    /// The flow methods, in the order of their results.
    pub methods: Vec<MethodRecord>,
    /// The clips, each with its apex.
    pub clips: Vec<Clip>,
    /// By flow method, the features of the clips.
    pub samples: Vec<(String, Vec<Sample>)>,
    /// By set, then flow method: predictions.
    pub trials: Vec<Trial>,
    /// Of each trial, in the same order: scores.
    pub outcomes: Vec<Outcome>,
}

/// A dataset in the results.
#[derive(Debug, Clone, Serialize)]
pub struct DataRecord {
    /// Its name, e.g. `casme2`.
    pub dataset: String,
    /// Which form of the dataset it is, e.g. cropped.
    pub form: &'static str,
    pub clips: usize,
    pub subjects: usize,
    /// Rows of the annotations that are no clips of the classes.
    pub dropped: usize,
    /// Clips that lack frames, as subject/clip.
    pub clips_with_missing_frames: Vec<String>,
    /// Clips whose apex was spotted.
    pub spotted_apexes: usize,
}

/// Why a run gives no results.
#[derive(Debug, thiserror::Error)]
pub enum RunError {
    /// A value of the protocol cannot be used.
    #[error(transparent)]
    Protocol(#[from] ProtocolError),
    /// One dataset is no composite.
    #[error("the composite set needs several datasets, found {0}; give more, or take each by itself")]
    Composite(usize),
    /// A set has fewer than two subjects.
    #[error("{set}: leaving one subject out needs clips of at least 2 subjects; found {found}")]
    Subjects { set: String, found: usize },
    /// A clip has no features.
    #[error(transparent)]
    Extract(#[from] ExtractError),
    /// A fold gave no predictions.
    #[error("{set}, {method}: {error}")]
    Training { set: String, method: String, error: LosoError },
    /// Predictions cannot be scored.
    #[error(transparent)]
    Scores(#[from] SummaryError),
    /// A folder cannot be made.
    #[error(transparent)]
    File(#[from] FileError),
}

impl RunSettings {
    /// Whether there can be results from these datasets.
    ///
    /// # Errors
    /// When the protocol cannot be used, or a set has fewer than two subjects.
    pub fn check(&self, datasets: &[ClipDataset]) -> Result<(), RunError> {
        self.protocol.check()?;
        if datasets.len() < 2 && self.sets == Sets::Composite {
            return Err(RunError::Composite(datasets.len()));
        }
        for (set, members) in sets(datasets, self.sets) {
            let of_set = datasets.iter().filter(|dataset| members.contains(&dataset.name));
            let found: usize = of_set.map(|dataset| dataset.subjects().len()).sum();
            if found < 2 {
                return Err(RunError::Subjects { set, found });
            }
        }
        Ok(())
    }
}

/// Trains and scores a classifier for each set and flow method. What `folders` hold of an earlier run is not computed again;
/// the results are the same bytes with it and without.
///
/// # Errors
/// Those of [`RunSettings::check`]; when a frame cannot be used, training diverges, or a folder cannot be written.
pub fn run(
    datasets: Vec<ClipDataset>,
    methods: Vec<RunMethod>,
    settings: RunSettings,
    folders: RunFolders,
    on_event: &(dyn Fn(RunEvent) + Sync),
) -> Result<RunResults, RunError> {
    settings.check(&datasets)?;
    let RunSettings { classifier, preparation, protocol, classes, .. } = &settings;
    let sets = sets(&datasets, settings.sets);
    let features =
        compute_features(datasets, &methods, settings.apex, preparation, Some(folders.features), on_event)?;
    let FeatureSet { data, clips, samples } = features;

    let epochs = protocol.epochs as u64;
    let subjects = |members: &[String]| -> usize {
        data.iter().filter(|data| members.contains(&data.dataset)).map(|data| data.subjects).sum()
    };
    let clips_of = |members: &[String]| -> usize {
        data.iter().filter(|data| members.contains(&data.dataset)).map(|data| data.clips).sum()
    };
    // Each clip is learned from once for each subject but its own.
    let in_set = |members: &[String]| (clips_of(members) * (subjects(members) - 1)) as u64 * epochs;
    let of_all_sets: u64 = sets.iter().map(|(_, members)| in_set(members)).sum();
    on_event(RunEvent::Training { clip_epochs: of_all_sets * methods.len() as u64 });
    let on_fold = |event| match event {
        LosoEvent::Epoch { clips } => on_event(RunEvent::Trained { clip_epochs: clips as u64 }),
        LosoEvent::Fold { clips, resumed: true } => {
            on_event(RunEvent::Resumed { clip_epochs: clips as u64 * epochs });
        }
        LosoEvent::Fold { resumed: false, .. } => {}
    };
    let (mut trials, mut outcomes) = (Vec::new(), Vec::new());
    for (set, members) in &sets {
        for (method, samples) in &samples {
            on_event(RunEvent::Folds { set, method });
            let of_set = samples.iter().filter(|sample| members.contains(&sample.dataset));
            let of_set: Vec<Sample> = of_set.cloned().collect();
            let loso =
                classifier.leave_one_subject_out(&of_set, classes, protocol, Some(folders.folds), &on_fold);
            let loso =
                loso.map_err(|error| RunError::Training { set: set.clone(), method: method.clone(), error })?;
            outcomes.push(Outcome::of(method, set, &loso)?);
            let Loso { classes, predictions, .. } = loso;
            trials.push(Trial { method: method.clone(), set: set.clone(), classes, predictions });
        }
    }
    let methods = methods.into_iter().map(|method| method.record).collect();
    Ok(RunResults { settings, data, methods, clips, samples, trials, outcomes })
}

/// What classifiers learn from, and where it comes from.
#[derive(Debug)]
pub struct FeatureSet {
    /// By dataset, what was used of it.
    pub data: Vec<DataRecord>,
    /// The clips of all datasets, each with its apex.
    pub clips: Vec<Clip>,
    /// By flow method, the features of the clips, in their order.
    pub samples: Vec<(String, Vec<Sample>)>,
}

/// Features of every clip by every flow method; those that the folder `cache` holds are not computed again. The apex of clips
/// that have none is spotted by the rule, with the flow of the first method.
///
/// # Errors
/// When a frame cannot be used, a clip has no apex and there is no rule, or the folder cannot be written.
pub fn compute_features(
    mut datasets: Vec<ClipDataset>,
    methods: &[RunMethod],
    apex: Option<ApexRule>,
    preparation: &Preparation,
    cache: Option<&Path>,
    on_event: &(dyn Fn(RunEvent) + Sync),
) -> Result<FeatureSet, RunError> {
    let cache = cache.map(FeatureCache::open).transpose()?;
    let mut data = Vec::new();
    for dataset in &mut datasets {
        let spotted_apexes = match (apex, methods.first()) {
            (Some(rule), Some(method)) => {
                let without = dataset.clips.iter().filter(|clip| clip.annotation.apex.is_none()).count();
                on_event(RunEvent::Apexes { clips: without });
                let on_clip = || on_event(RunEvent::Clip);
                fill_apexes(&mut dataset.clips, rule, &preparation.face, method.estimator, &on_clip)?
            }
            _ => 0,
        };
        data.push(DataRecord::of(dataset, spotted_apexes));
    }
    let clips: Vec<Clip> = datasets.into_iter().flat_map(|dataset| dataset.clips).collect();
    let mut samples: Vec<(String, Vec<Sample>)> = Vec::new();
    for RunMethod { estimator, record } in methods {
        on_event(RunEvent::Features { method: &record.name, clips: clips.len() });
        let method = Method { estimator: *estimator, identity: record.identity() };
        let of_method = extract(&clips, &method, preparation, cache.as_ref(), &|_| on_event(RunEvent::Clip))?;
        samples.push((record.name.clone(), of_method));
    }
    Ok(FeatureSet { data, clips, samples })
}

/// The sets by name, each with the names of its datasets.
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
