//! Leave one subject out: each subject of every dataset is classified by a model trained on all other subjects. Or leave a dataset out:
//! its clips are classified by a model trained on the other datasets.

use std::collections::{BTreeMap, BTreeSet};
use std::io::Write;
use std::ops::Range;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::{Arc, Mutex};
use std::time::Instant;

use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};
use srflow_files::{
    FileError, FileKind, create_folder, parse_sealed_json, read_file, sealed_json, write_atomically,
};

use crate::classifier::ClassifierEntry;
use crate::fold::{Trained, train_fold};
use crate::learning::{Example, Lesson, Unfinished};
use crate::predictions::Prediction;
use crate::protocol::{Protocol, ProtocolError};
use crate::sample::Sample;

/// Incremented when the same protocol and features give other scores.
const VERSION: u32 = 1;

/// The predictions for every clip, and the training of each fold.
#[derive(Debug, Clone, PartialEq)]
pub struct Loso {
    /// The classes' names, by number.
    pub classes: Arc<[String]>,
    /// By fold, seed, clip, then epoch.
    pub predictions: Vec<Prediction>,
    /// By dataset and subject, then seed.
    pub folds: Vec<FoldRecord>,
}

/// The training of one fold.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct FoldRecord {
    /// The dataset of the held-out subject.
    pub dataset: String,
    /// `None` where the whole dataset is held out.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub subject: Option<String>,
    pub seed: u64,
    pub clips: usize,
    /// Classes that no training clip shows: the classifier cannot learn them.
    pub unseen_classes: Vec<String>,
    /// By recorded epoch: mean cross-entropy over the training clips during that epoch.
    pub training_losses: Vec<f64>,
    pub seconds: f64,
    /// Whether an earlier run computed it.
    pub resumed: bool,
}

impl FoldRecord {
    /// What is held out, e.g. `samm 006`.
    pub fn name(&self) -> String {
        joined(&self.dataset, self.subject.as_deref(), " ")
    }

    /// Whether clips of this subject are held out.
    pub(crate) fn tested(&self, dataset: &str, subject: &str) -> bool {
        self.dataset == dataset && self.subject.as_deref().is_none_or(|held_out| held_out == subject)
    }
}

fn joined(dataset: &str, subject: Option<&str>, between: &str) -> String {
    [Some(dataset), subject].into_iter().flatten().collect::<Vec<_>>().join(between)
}

/// A clip with its class. (dataset, subject, clip) identifies it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct LabelledClip<'a> {
    pub dataset: &'a str,
    pub subject: &'a str,
    pub clip: &'a str,
    /// Class number.
    pub class: usize,
}

impl<'a> From<&'a Sample> for LabelledClip<'a> {
    fn from(Sample { dataset, subject, clip, class, .. }: &'a Sample) -> Self {
        Self { dataset, subject, clip, class: *class }
    }
}

/// A held-out subject or dataset. The indices of clips are in order of dataset, subject and clip.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Fold {
    pub dataset: String,
    /// `None` where the whole dataset is held out.
    pub subject: Option<String>,
    /// The held-out clips.
    pub tested: Vec<usize>,
    /// All others.
    pub training: Vec<usize>,
}

impl Fold {
    /// What is held out, e.g. `samm subject 006`.
    fn name(&self) -> String {
        joined(&self.dataset, self.subject.as_deref(), " subject ")
    }

    /// What identifies its random numbers: `samm/006`.
    fn key(&self) -> String {
        joined(&self.dataset, self.subject.as_deref(), "/")
    }
}

/// What is held out, and classified by what the other clips teach.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum LeftOut<'a> {
    /// Each subject of every dataset, one after the other.
    EachSubject,
    /// A whole dataset.
    Dataset(&'a str),
}

/// Where finished folds are stored, and which are run.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct FoldFolder<'a> {
    pub path: &'a Path,
    /// Numbers of the folds, by dataset and subject, each with all seeds; those beyond the last are ignored.
    pub part: Range<usize>,
}

impl<'a> From<&'a Path> for FoldFolder<'a> {
    /// With all folds.
    fn from(path: &'a Path) -> Self {
        Self { path, part: 0..usize::MAX }
    }
}

/// Progress, reported from any thread.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum LosoEvent {
    /// A fold has finished another epoch.
    Epoch {
        /// Number of clips it was trained on.
        clips: usize,
    },
    /// A fold is finished; if resumed, none of its epochs was run.
    Fold {
        /// Number of clips per epoch.
        clips: usize,
        /// Whether an earlier run computed it.
        resumed: bool,
    },
}

/// Follows a run, and can stop it. Both functions are called from any thread.
#[derive(Clone, Copy)]
pub struct LosoWatch<'a> {
    pub on_event: &'a (dyn Fn(LosoEvent) + Sync),
    /// Asked after each epoch; a fold that has run its last epoch is still stored.
    pub stop: &'a (dyn Fn() -> bool + Sync),
}

/// Why a run failed.
#[derive(Debug, thiserror::Error)]
pub enum LosoError {
    /// A value of the protocol is out of range.
    #[error(transparent)]
    Protocol(#[from] ProtocolError),
    #[error("leaving one subject out needs clips of at least 2 subjects; found {}", listed(.0))]
    Subjects(Vec<String>),
    #[error("there is no clip of {dataset}, or of no other dataset: leaving a dataset out needs both")]
    Dataset { dataset: String },
    #[error("{dataset} subject {subject} has two clips called {clip}; give each its own name")]
    SameClip { dataset: String, subject: String, clip: String },
    #[error("training without {held_out} diverged in epoch {epoch}; try a smaller learning rate")]
    Diverged {
        /// Dataset and subject.
        held_out: String,
        epoch: usize,
    },
    #[error("{held_out}: expected the classes of {clips} clips, numbers from 0 to {}; found {found}", .classes.saturating_sub(1))]
    Predicted {
        /// Dataset and subject.
        held_out: String,
        clips: usize,
        classes: usize,
        /// What the classifier gave.
        found: String,
    },
    /// It was asked to stop.
    #[error("stopped on request")]
    Stopped,
    /// A finished fold could not be read or written.
    #[error(transparent)]
    File(#[from] FileError),
}

fn listed(subjects: &[String]) -> String {
    if subjects.is_empty() { "none".to_owned() } else { subjects.join(", ") }
}

/// The folds over these clips, by dataset, then subject.
///
/// # Errors
/// When there are fewer than two subjects, or two clips share a name.
pub fn folds(clips: &[LabelledClip]) -> Result<Vec<Fold>, LosoError> {
    let order = in_order(clips)?;
    let mut subjects: Vec<[&str; 2]> =
        order.iter().map(|&index| [clips[index].dataset, clips[index].subject]).collect();
    subjects.dedup();
    if subjects.len() < 2 {
        return Err(LosoError::Subjects(subjects.iter().map(|subject| subject.join(" ")).collect()));
    }
    let fold = |[dataset, subject]: [&str; 2]| {
        let held_out = |&index: &usize| clips[index].dataset == dataset && clips[index].subject == subject;
        let (tested, training) = order.iter().copied().partition(held_out);
        Fold { dataset: dataset.to_owned(), subject: Some(subject.to_owned()), tested, training }
    };
    Ok(subjects.into_iter().map(fold).collect())
}

/// The fold that holds a dataset out.
fn fold_without(dataset: &str, clips: &[LabelledClip]) -> Result<Fold, LosoError> {
    let held_out = |&index: &usize| clips[index].dataset == dataset;
    let (tested, training): (Vec<usize>, Vec<usize>) = in_order(clips)?.into_iter().partition(held_out);
    if tested.is_empty() || training.is_empty() {
        return Err(LosoError::Dataset { dataset: dataset.to_owned() });
    }
    Ok(Fold { dataset: dataset.to_owned(), subject: None, tested, training })
}

/// The clips' indices in order of dataset, subject and clip.
fn in_order(clips: &[LabelledClip]) -> Result<Vec<usize>, LosoError> {
    let name = |index: usize| [clips[index].dataset, clips[index].subject, clips[index].clip];
    let mut order: Vec<usize> = (0..clips.len()).collect();
    order.sort_by_key(|&index| name(index));
    if let Some(pair) = order.windows(2).find(|pair| name(pair[0]) == name(pair[1])) {
        let [dataset, subject, clip] = name(pair[0]).map(str::to_owned);
        return Err(LosoError::SameClip { dataset, subject, clip });
    }
    Ok(order)
}

/// Leaves one subject out with a classifier of another program: `classify` gets every fold in order, and gives the class of each of its
/// tested clips. What it predicts is recorded as epoch 0, with a score of 1 for the class and 0 for the others.
///
/// # Errors
/// Those of [`folds`]; [`LosoError::Predicted`]; and the errors of `classify`, of which the first ends the run.
pub fn leave_one_subject_out_by<E: From<LosoError>>(
    clips: &[LabelledClip],
    classes: &Arc<[String]>,
    mut classify: impl FnMut(&Fold) -> Result<Vec<usize>, E>,
) -> Result<Loso, E> {
    let folds = folds(clips)?;
    let mut finished = Vec::with_capacity(folds.len());
    for fold in &folds {
        let start = Instant::now();
        let predicted = classify(fold)?;
        if predicted.len() != fold.tested.len() || predicted.iter().any(|class| *class >= classes.len()) {
            return Err(LosoError::Predicted {
                held_out: fold.name(),
                clips: fold.tested.len(),
                classes: classes.len(),
                found: format!("{} numbers: {predicted:?}", predicted.len()),
            }
            .into());
        }
        let score =
            |class: usize| (0..classes.len()).map(|other| f32::from(u8::from(other == class))).collect();
        let scores = vec![predicted.into_iter().map(score).collect()];
        let trained = Trained { scores, losses: Vec::new(), seconds: start.elapsed().as_secs_f64() };
        finished.push(Finished { trained, resumed: false });
    }
    let folds: Vec<(&Fold, u64)> = folds.iter().map(|fold| (fold, 0)).collect();
    Ok(assembled(clips, classes, &[0], &folds, finished))
}

/// For each fold, trains a classifier on the samples that are not held out, with each seed of the protocol, and records its predictions
/// for those that are. `classes` are the classes' names; the samples' classes are indices into them.
///
/// Folds are distributed over the threads of the current pool. Each is computed by one thread with its own random numbers: the
/// result is bit-identical for any number of threads. Finished folds are stored in `folder`, under names that depend on
/// protocol, classifier and every sample, and are not run again; with a part of the folds, the result has those alone.
///
/// # Errors
/// When there are fewer than two subjects, or no clip in the dataset or outside of it; two clips share a name; training diverges; a fold
/// cannot be stored; or `watch` says so.
pub fn leave_out(
    left_out: LeftOut,
    classifier: &ClassifierEntry,
    samples: &[Sample],
    classes: &Arc<[String]>,
    protocol: &Protocol,
    folder: Option<FoldFolder>,
    watch: LosoWatch,
) -> Result<Loso, LosoError> {
    classifier.check(protocol)?;
    let LosoWatch { on_event, stop } = watch;
    let clips: Vec<LabelledClip> = samples.iter().map(LabelledClip::from).collect();
    let mut folds = match left_out {
        LeftOut::EachSubject => folds(&clips)?,
        LeftOut::Dataset(dataset) => vec![fold_without(dataset, &clips)?],
    };
    if let Some(FoldFolder { part, .. }) = &folder {
        folds.truncate(part.end);
        folds.drain(..part.start.min(folds.len()));
    }
    let sorted = sorted(samples);
    let of_seed = |protocol: Protocol| {
        let store =
            |FoldFolder { path, .. }: &FoldFolder| Store::open(path, classifier, classes, &protocol, &sorted);
        let store = folder.as_ref().map(store).transpose()?;
        Ok((protocol, store))
    };
    let seeds = protocol.of_each_seed().map(of_seed).collect::<Result<Vec<_>, LosoError>>()?;
    let examples = Example::of_samples(samples, classifier.input);
    let recorded = classifier.recorded(protocol);
    let run =
        |(fold, (protocol, store)): &(&Fold, &(Protocol, Option<Store>))| -> Result<Finished, LosoError> {
            let file = store.as_ref().map(|store| store.file(fold));
            let clips = fold.training.len();
            let shape = [recorded.len(), fold.tested.len(), classes.len()];
            if let Some(finished) = file.as_deref().map(|file| read_fold(file, shape)).transpose()?.flatten()
            {
                on_event(LosoEvent::Fold { clips, resumed: true });
                return Ok(finished);
            }
            let of = |indices: &[usize]| -> Vec<&Example> { indices.iter().map(|&i| &examples[i]).collect() };
            let name = fold.key();
            let lesson =
                Lesson { name: &name, classes: classes.len(), examples: &of(&fold.training), protocol };
            let trained = train_fold(classifier.train, &lesson, &of(&fold.tested), &recorded, &|| {
                on_event(LosoEvent::Epoch { clips });
                !stop()
            });
            let trained = trained.map_err(|unfinished| match unfinished {
                Unfinished::Diverged { epoch } => LosoError::Diverged { held_out: fold.name(), epoch },
                Unfinished::Stopped => LosoError::Stopped,
            })?;
            let finished = Finished { trained, resumed: false };
            if let Some(file) = &file {
                write_fold(file, &name, &finished.trained)?;
            }
            on_event(LosoEvent::Fold { clips, resumed: false });
            Ok(finished)
        };
    let units: Vec<_> = folds.iter().flat_map(|fold| seeds.iter().map(move |seed| (fold, seed))).collect();
    let finished = each_on_one_thread(&units, run)?;
    let units: Vec<_> = units.into_iter().map(|(fold, (protocol, _))| (fold, protocol.seed)).collect();
    Ok(assembled(&clips, classes, &recorded, &units, finished))
}

/// The results of all folds and seeds, with predictions at these `epochs`.
fn assembled(
    clips: &[LabelledClip],
    classes: &Arc<[String]>,
    epochs: &[usize],
    folds: &[(&Fold, u64)],
    finished: Vec<Finished>,
) -> Loso {
    let mut loso = Loso { classes: classes.clone(), predictions: Vec::new(), folds: Vec::new() };
    for (&(fold, seed), Finished { trained, resumed }) in folds.iter().zip(finished) {
        let seen: BTreeSet<usize> = fold.training.iter().map(|&index| clips[index].class).collect();
        let unseen = (0..classes.len()).filter(|class| !seen.contains(class));
        loso.folds.push(FoldRecord {
            dataset: fold.dataset.clone(),
            subject: fold.subject.clone(),
            seed,
            clips: fold.tested.len(),
            unseen_classes: unseen.map(|class| classes[class].clone()).collect(),
            training_losses: trained.losses,
            seconds: trained.seconds,
            resumed,
        });
        for (position, &index) in fold.tested.iter().enumerate() {
            let LabelledClip { dataset, subject, clip, class } = clips[index];
            for (&epoch, scores) in epochs.iter().zip(&trained.scores) {
                loso.predictions.push(Prediction {
                    dataset: dataset.to_owned(),
                    subject: subject.to_owned(),
                    clip: clip.to_owned(),
                    truth: class,
                    seed,
                    epoch,
                    predicted: Prediction::class_of(&scores[position]),
                    scores: scores[position].clone(),
                });
            }
        }
    }
    loso
}

/// By dataset, subject, clip: the result does not depend on the order of the samples.
fn sorted(samples: &[Sample]) -> Vec<&Sample> {
    let mut sorted: Vec<&Sample> = samples.iter().collect();
    sorted.sort_by(|a, b| (&a.dataset, &a.subject, &a.clip).cmp(&(&b.dataset, &b.subject, &b.clip)));
    sorted
}

struct Finished {
    trained: Trained,
    resumed: bool,
}

/// Applies `run` to every item on the threads of the current pool, and returns the results in order, or the first error. Parallel
/// work inside `run` stays on its thread.
fn each_on_one_thread<T: Sync, R: Send, E: Send>(
    items: &[T],
    run: impl Fn(&T) -> Result<R, E> + Sync,
) -> Result<Vec<R>, E> {
    let next = AtomicUsize::new(0);
    let stop = AtomicBool::new(false);
    let results: Mutex<BTreeMap<usize, Result<R, E>>> = Mutex::default();
    let work = || {
        // A pool with this thread alone: kernels that split their work run on it.
        let _pool = rayon::ThreadPoolBuilder::new().num_threads(1).use_current_thread().build();
        while !stop.load(Ordering::Relaxed) {
            let index = next.fetch_add(1, Ordering::Relaxed);
            let Some(item) = items.get(index) else { break };
            let result = run(item);
            stop.fetch_or(result.is_err(), Ordering::Relaxed);
            results.lock().unwrap_or_else(std::sync::PoisonError::into_inner).insert(index, result);
        }
    };
    std::thread::scope(|scope| {
        for _ in 0..rayon::current_num_threads().min(items.len()) {
            scope.spawn(work);
        }
    });
    results.into_inner().unwrap_or_else(std::sync::PoisonError::into_inner).into_values().collect()
}

/// Finished folds on disk.
struct Store {
    folder: PathBuf,
    /// Digest of protocol, classifier and samples.
    run: Vec<u8>,
}

/// A finished fold in its stored form. Scores are stored as f64, which JSON preserves exactly.
#[derive(Serialize, Deserialize)]
struct FoldFile {
    fold: String,
    seconds: f64,
    training_losses: Vec<f64>,
    scores: Vec<Vec<Vec<f64>>>,
}

impl Store {
    fn open(
        folder: &Path,
        classifier: &ClassifierEntry,
        classes: &[String],
        protocol: &Protocol,
        samples: &[&Sample],
    ) -> Result<Self, FileError> {
        create_folder(folder)?;
        let mut digest = Sha256::new();
        digest.update(format!("srflow fold {VERSION}\n{}\n", classifier.identity(protocol)));
        digest.update(format!("{classes:?}\n"));
        for sample in samples {
            let Sample { dataset, subject, clip, class, features, .. } = sample;
            digest.update(format!("{dataset:?} {subject:?} {clip:?} {}\n", classes[*class]));
            features.values().iter().for_each(|value| digest.update(value.to_le_bytes()));
        }
        Ok(Self { folder: folder.to_owned(), run: digest.finalize().to_vec() })
    }

    fn file(&self, Fold { dataset, subject, .. }: &Fold) -> PathBuf {
        let held_out = match subject {
            Some(subject) => format!("{dataset:?} {subject:?}"),
            None => format!("{dataset:?}"),
        };
        let digest = Sha256::new().chain_update(&self.run).chain_update(held_out);
        let name: String = digest.finalize().iter().take(16).map(|byte| format!("{byte:02x}")).collect();
        self.folder.join(format!("{name}.json"))
    }
}

/// A finished fold with these numbers of recorded epochs, clips and classes; `None` if the file is missing or incomplete.
fn read_fold(path: &Path, shape: [usize; 3]) -> Result<Option<Finished>, FileError> {
    let text = match read_file(path, FileKind::Json) {
        Ok(text) => text,
        Err(error) if error.is_not_found() => return Ok(None),
        Err(error) => return Err(error),
    };
    let file: Option<FoldFile> = match parse_sealed_json(&String::from_utf8_lossy(&text)) {
        Ok(file) => Some(file),
        Err(error) => {
            log::warn!("{}: {error}; the fold is trained again", path.display());
            None
        }
    };
    let fits = |file: &FoldFile| {
        let [epochs, clips, classes] = shape;
        file.training_losses.len() == epochs
            && file.scores.len() == epochs
            && file.scores.iter().all(|of_epoch| of_epoch.len() == clips)
            && file.scores.iter().flatten().all(|scores| scores.len() == classes)
    };
    Ok(file.filter(fits).map(|file| {
        let of_clip = |scores: Vec<f64>| scores.into_iter().map(|score| score as f32).collect();
        let scores = file.scores.into_iter().map(|clips| clips.into_iter().map(of_clip).collect());
        let trained =
            Trained { scores: scores.collect(), losses: file.training_losses, seconds: file.seconds };
        Finished { trained, resumed: true }
    }))
}

fn write_fold(path: &Path, name: &str, trained: &Trained) -> Result<(), FileError> {
    let of_clip = |scores: &Vec<f32>| scores.iter().map(|score| f64::from(*score)).collect();
    let file = FoldFile {
        fold: name.to_owned(),
        seconds: trained.seconds,
        training_losses: trained.losses.clone(),
        scores: trained.scores.iter().map(|clips| clips.iter().map(of_clip).collect()).collect(),
    };
    write_atomically(path, |writer| {
        writer.write_all(sealed_json(&file)?.as_bytes())?;
        writer.flush()
    })
}
