//! Scores that are kept until all pairs have theirs, in the folder `scored` of the results.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};
use std::time::UNIX_EPOCH;

use anyhow::Context as _;
use serde_json::json;
use srflow_core::Shard;
use srflow_data::flow::{Entry, EntryFile, FlowDataset};
use srflow_eval::{KeptPair, KeptScores, ScoredPair};
use srflow_files::{JsonLines, RunLock, create_folder, read_json_lines};

use super::EvalJob;
use crate::Watch;
use crate::error::wrong_settings;
use crate::methods::{self, MethodParameters, MethodSpec};

/// Name of the folder in that of the results.
const FOLDER: &str = "scored";

/// Keeps other processes from evaluating a part into the same folder of results.
pub fn lock(out: &Path, part: Shard) -> anyhow::Result<Vec<RunLock>> {
    let folder = out.join(FOLDER);
    create_folder(&folder)?;
    Ok(match part {
        Shard::WHOLE => RunLock::take_all(&folder)?,
        Shard { number, of } => vec![RunLock::take_part(&folder, &format!("{number}-of-{of}"))?],
    })
}

/// Removes the kept scores and the locks, once the tables are written.
pub fn remove(out: &Path) -> anyhow::Result<()> {
    let folder = out.join(FOLDER);
    std::fs::remove_dir_all(&folder).with_context(|| format!("removing {}", folder.display()))
}

/// Scores that are kept until all pairs are scored.
pub struct Kept {
    folder: PathBuf,
    file: PathBuf,
    /// What scores depend on besides pairs, as JSON.
    evaluation: String,
    /// Stamps of the files of pairs, by their names.
    stamps: BTreeMap<String, String>,
    found: Vec<KeptPair>,
}

/// What scores are not kept without: none without a folder for them, or for methods whose flow depends on other pairs or on files,
/// which may change.
pub fn missing(job: &EvalJob, specs: &[MethodSpec]) -> Option<String> {
    let remembers =
        |spec: &MethodSpec| spec.method.network().is_some_and(|network| network.facts().remembers);
    let is_alone = |spec: &MethodSpec| spec.method != methods::Method::Files && !remembers(spec);
    match (&job.out, specs.iter().find(|spec| !is_alone(spec)), job.face.is_whole()) {
        (None, ..) => Some("`out` DIR too, into which the parts write their scores".to_owned()),
        (_, Some(spec), _) => {
            Some(format!("methods that estimate each pair by itself; leave out {}", spec.method.name()))
        }
        (.., false) => {
            Some("whole frames or `crop`; leave out `face`, `face_box` and `landmarks`".to_owned())
        }
        (Some(_), None, true) => None,
    }
}

impl Kept {
    /// `None` where scores are not kept; see [`missing`].
    pub fn open(
        job: &EvalJob,
        parameters: &MethodParameters,
        dataset: &FlowDataset,
        specs: &[MethodSpec],
        shard: Shard,
        watch: &Watch,
    ) -> anyhow::Result<Option<Self>> {
        match (missing(job, specs), &job.out) {
            (None, Some(out)) => {
                let records = methods::records(specs, parameters, watch)?;
                let methods: Vec<_> = records.iter().map(|record| (&record.name, &record.identity)).collect();
                let evaluation = json!({
                    "version": 1,
                    "srflow": env!("CARGO_PKG_VERSION"),
                    "dataset": dataset.name(),
                    "folder": std::path::absolute(dataset.dir())?.display().to_string(),
                    "crop": job.crop,
                    "regions": job.regions,
                    "small_motion": job.small_motion,
                    "expression": job.expression,
                    "expression_error": job.expression_error,
                    "methods": methods,
                })
                .to_string();
                let folder = out.join(FOLDER);
                let stamps = dataset.entries().iter().map(|entry| (entry.id(), stamp(entry))).collect();
                let file = folder.join(format!("{}-of-{}.jsonl", shard.number, shard.of));
                let mut kept = Self { file, folder, evaluation, stamps, found: Vec::new() };
                kept.read()?;
                Ok(Some(kept))
            }
            (Some(missing), _) if shard != Shard::WHOLE => wrong_settings!("`shard` needs {missing}"),
            _ => Ok(None),
        }
    }

    /// Reads the scores of all parts.
    fn read(&mut self) -> anyhow::Result<()> {
        for entry in std::fs::read_dir(&self.folder).into_iter().flatten().flatten() {
            let path = entry.path();
            if path.extension().is_some_and(|extension| extension == "jsonl") {
                let pairs: Vec<KeptPair> = read_json_lines(&path)?;
                if pairs.iter().any(|pair| !pair.evaluation.starts_with('{')) {
                    let path = path.display();
                    log::warn!(
                        "{path}: an earlier version of srflow kept these scores; the pairs are scored again"
                    );
                }
                let current: Vec<KeptPair> = pairs.into_iter().filter(|pair| self.is_current(pair)).collect();
                self.found.extend(current);
            }
        }
        Ok(())
    }

    fn is_current(&self, pair: &KeptPair) -> bool {
        pair.evaluation == self.evaluation && self.stamps.get(&pair.pair) == Some(&pair.files)
    }

    /// The log of this process, without scores that are of no use any more.
    pub fn log(&self) -> anyhow::Result<JsonLines> {
        Ok(JsonLines::open(&self.file, |pair: &KeptPair| self.is_current(pair))?)
    }

    pub fn scores_without(&self, names: &BTreeSet<String>) -> BTreeMap<String, Vec<KeptScores>> {
        let others = self.found.iter().filter(|pair| !names.contains(&pair.pair));
        others.map(|pair| (pair.pair.clone(), pair.methods.clone())).collect()
    }

    pub fn of(&self, pair: &ScoredPair) -> KeptPair {
        KeptPair::new(pair, &self.evaluation, self.stamps.get(pair.name).cloned().unwrap_or_default())
    }
}

/// Sizes and times of a pair's files, or of the tars they are in; those on the web have none.
fn stamp(entry: &Entry) -> String {
    let stamp = |file: &EntryFile| {
        let place = file.on_disk().or_else(|| Some(file.path().parent()?.to_owned()))?;
        let metadata = std::fs::metadata(place).ok()?;
        let modified = metadata.modified().ok()?.duration_since(UNIX_EPOCH).ok()?;
        Some(format!("{} {}", metadata.len(), modified.as_nanos()))
    };
    let stamps: Vec<String> = entry.files().map(|file| stamp(file).unwrap_or_default()).collect();
    stamps.join(", ")
}
