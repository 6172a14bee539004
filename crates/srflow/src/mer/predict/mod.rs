//! Micro-expressions by a trained model.

mod classified;
mod clips;
mod events;
mod files;
mod page;

use std::collections::BTreeSet;
use std::fmt;
use std::path::{Path, PathBuf};

use anyhow::{Context as _, ensure};
use serde::{Deserialize, Serialize};
use srflow_core::{FlowEstimator, Shard};
use srflow_data::micro_expression::{CLIP_KINDS, ClipSource};
use srflow_files::create_folder;
use srflow_mer::{ApexRule, LEAST_PROBABILITY, ModelFlow, RecognitionModel};

pub use classified::Classified;

use self::classified::{Classifier, Seen};
use self::clips::{ClipSettings, classify_clips, whole_clip};
use self::events::classify_events;
use super::SourceArgs;
use super::sources::folder_for_frames;
use super::spot::{SpottedVideos, SpottingArgs, spot_videos};
use crate::clap::Args;
use crate::error::wrong_settings;
use crate::methods::{self, MethodParameters, MethodSpec};
use crate::output::{ensure_folder, write_line, write_page};
use crate::{Job, Report, Watch, WhenStopped};

const TABLE_NAME: &str = "predictions.csv";
const PAGE_NAME: &str = "report.html";

/// Name of the model that comes with srflow.
pub const RENDERED: &str = "rendered";

/// Classify micro-expressions in videos or clips with a trained model
#[derive(Args, Debug, Clone, PartialEq, Serialize, Deserialize)]
#[command(after_help = "\
Examples:
  srflow mer predict rendered interview.mp4 --face detect --out predicted
  srflow mer predict rendered anna.mp4 ben/ --clips --fps 60 --face detect --out predicted
  srflow mer run --data casme2:/data/CASME2 --save-model model --out results
  srflow mer predict model samm:/data/SAMM --out predicted

In a video, expressions are spotted first. With --clips, each input is one clip, from its first to its last frame. The \
folder has predictions.csv (a row for each expression, with the probability of each class) and report.html. Where no class is \
probable enough, or the face is unlike those that the model was trained on, the model does not know, and the row says why.")]
pub struct PredictJob {
    /// Folder of a model that `srflow mer run` saved, or rendered: a small one that comes with srflow, from rendered clips alone
    #[arg(value_name = "MODEL")]
    pub model: PathBuf,
    /// Videos, folders of frames, or datasets
    #[arg(required = true, value_name = "VIDEO|FRAMES|KIND:DIR")]
    pub inputs: Vec<String>,
    /// Folder of the results
    #[arg(short, long, value_name = "DIR")]
    pub out: PathBuf,
    /// Take each video or folder as one clip, from its first to its last frame
    #[arg(long)]
    #[serde(default)]
    pub clips: bool,
    /// Name a class only if it is at least so probable
    #[arg(long, value_name = "SHARE", default_value_t = LEAST_PROBABILITY)]
    #[serde(default = "least_probability")]
    pub least_probability: f64,
    /// The model's flow method, if its weights are elsewhere now
    #[arg(long, value_name = "METHOD")]
    #[serde(default)]
    pub model_method: Option<MethodSpec>,
    /// How to spot the apex of clips without one: course, strain or ratio
    #[arg(long, value_name = "RULE", default_value_t = ApexRule::Course)]
    #[serde(default = "apex")]
    pub apex: ApexRule,
    /// Start over where the folder has results of other settings
    #[arg(long)]
    #[serde(default)]
    pub force: bool,
    #[command(flatten)]
    #[serde(flatten)]
    pub spotting: SpottingArgs,
    #[command(flatten)]
    #[serde(flatten)]
    pub sources: SourceArgs,
}

fn least_probability() -> f64 {
    LEAST_PROBABILITY
}

fn apex() -> ApexRule {
    ApexRule::Course
}

impl Job for PredictJob {
    const NAME: &'static str = "mer predict";
    const WHEN_STOPPED: WhenStopped = WhenStopped::UnitsKept;

    type Report = PredictReport;

    fn work(&self, watch: &Watch) -> anyhow::Result<PredictReport> {
        if !(0.0..=1.0).contains(&self.least_probability) {
            wrong_settings!("`least_probability` must be 0 to 1, found {}", self.least_probability);
        }
        ensure_folder(&self.out)?;
        let model = open_model(&self.model)?;
        let estimator = self.estimator(&model, watch)?;
        let (mut datasets, mut videos) = (Vec::new(), Vec::new());
        for input in &self.inputs {
            match input.split_once(':') {
                Some((kind, _)) if CLIP_KINDS.iter().any(|known| known.name == kind) => {
                    datasets.push(input.parse::<ClipSource>().map_err(anyhow::Error::msg)?);
                }
                _ => videos.push(PathBuf::from(input)),
            }
        }
        let classifier = Classifier {
            model: &model,
            estimator: estimator.as_ref(),
            least_probability: self.least_probability,
        };
        let mut classified = Vec::new();
        let whole_clips = if self.clips { std::mem::take(&mut videos) } else { Vec::new() };
        for (datasets, whole_clips) in [(&datasets[..], &[][..]), (&[], &whole_clips)] {
            if datasets.is_empty() && whole_clips.is_empty() {
                continue;
            }
            create_folder(&self.out)?;
            match self.of_clips(&classifier, datasets, whole_clips, watch)? {
                Some(of_clips) => classified.extend(of_clips),
                None => return Ok(PredictReport::stopped(self.out.clone())),
            }
        }
        if !videos.is_empty() {
            let SpottedVideos { videos: spotted, stopped, .. } =
                spot_videos(&self.spotting, &videos, &self.out, self.force, Shard::WHOLE, watch)?;
            if stopped {
                return Ok(PredictReport::stopped(self.out.clone()));
            }
            for video in &spotted {
                classified.extend(classify_events(&classifier, &self.spotting.face, video, watch)?);
            }
        }
        files::write(&self.out.join(TABLE_NAME), &model.card.classes, &classified)?;
        page::write(&self.out.join(PAGE_NAME), &model.card, &classified)?;
        let card = &model.card;
        let expressions = classified.into_iter().map(|(classified, _)| classified).collect();
        Ok(PredictReport {
            out: self.out.clone(),
            note: card.note.clone(),
            classes: card.classes.clone(),
            expressions,
            stopped: false,
        })
    }
}

impl PredictJob {
    /// The expressions of datasets, or of videos and folders that are one clip each; `None` if it was stopped.
    fn of_clips(
        &self,
        classifier: &Classifier,
        datasets: &[ClipSource],
        whole_clips: &[PathBuf],
        watch: &Watch,
    ) -> anyhow::Result<Option<Vec<Seen>>> {
        let names = self.sources.classes()?.names().clone();
        let model = &classifier.model.card.classes;
        let mut settings = ClipSettings {
            face: &self.spotting.face,
            apex: self.apex,
            landmarks: self.out.join("landmarks.csv"),
            force: self.force,
            classes: if names[..] == model[..] { &names } else { &[] },
        };
        if datasets.is_empty() {
            let frames = folder_for_frames()?;
            let clips = whole_clips.iter().map(|path| whole_clip(path, frames.path()));
            let clips = clips.collect::<anyhow::Result<Vec<_>>>()?;
            let mut names = BTreeSet::new();
            if let Some(clip) = clips.iter().find(|clip| !names.insert(&clip.annotation.clip)) {
                wrong_settings!(
                    "{}: another clip is called `{}`, too; rename one",
                    clip.folder.display(),
                    clip.annotation.clip
                );
            }
            settings.classes = &[];
            settings.landmarks = self.out.join("clips.landmarks.csv");
            return classify_clips(classifier, settings, clips, watch);
        }
        let (datasets, _frames) = self.sources.open(datasets, true, watch)?;
        let clips = datasets.into_iter().flat_map(|dataset| dataset.clips).collect();
        classify_clips(classifier, settings, clips, watch)
    }

    /// The flow method of the model's features.
    fn estimator(&self, model: &RecognitionModel, watch: &Watch) -> anyhow::Result<Box<dyn FlowEstimator>> {
        let ModelFlow { method, sha256, parameters } = &model.card.flow;
        let spec = match &self.model_method {
            Some(spec) => spec.clone(),
            None => method.parse().map_err(anyhow::Error::msg).context("the model's flow method")?,
        };
        let settings = MethodParameters::default();
        let record = methods::records(std::slice::from_ref(&spec), &settings, watch)?.remove(0);
        ensure!(
            record.sha256 == *sha256 && record.parameters == *parameters,
            "the model's features are from flow of {method} ({parameters}{}), and this is {}: give its method and weights with \
             `model_method`",
            sha256.as_ref().map(|hash| format!(", weights with SHA-256 {hash}")).unwrap_or_default(),
            record.description()
        );
        methods::estimator(&spec, &settings, watch)
    }
}

/// The model in this folder, or [`RENDERED`].
///
/// # Errors
/// When there is no model.
pub fn open_model(path: &Path) -> anyhow::Result<RecognitionModel> {
    if path == Path::new(RENDERED) && !path.exists() {
        return Ok(RecognitionModel::rendered());
    }
    ensure!(
        path.is_dir(),
        "{}: expected the folder of a model, as `srflow mer run` writes it with `save_model`, or {RENDERED}; found {}",
        path.display(),
        if path.exists() { "a file" } else { "nothing" }
    );
    Ok(RecognitionModel::open(path)?)
}

/// What a model says about expressions.
#[derive(Debug, Clone, Serialize)]
pub struct PredictReport {
    #[serde(skip)]
    out: PathBuf,
    /// What a user of the model should know first.
    pub note: String,
    pub classes: Vec<String>,
    pub expressions: Vec<Classified>,
    #[serde(skip)]
    stopped: bool,
}

impl PredictReport {
    fn stopped(out: PathBuf) -> Self {
        Self { out, note: String::new(), classes: Vec::new(), expressions: Vec::new(), stopped: true }
    }
}

impl Report for PredictReport {
    fn stopped(&self) -> bool {
        self.stopped
    }
}

impl fmt::Display for PredictReport {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        if self.stopped {
            return writeln!(f, "Stopped; the same command continues after the last finished video");
        }
        if !self.note.is_empty() {
            write_line(f, format_args!("{}", self.note))?;
        }
        for expression in &self.expressions {
            write_line(f, format_args!("{expression}"))?;
        }
        let known = self.expressions.iter().filter(|expression| expression.class.is_some()).count();
        let count = self.expressions.len();
        write_line(f, format_args!("{count} expressions, {known} of them classified"))?;
        let truths = || {
            let known = self.expressions.iter().filter(|expression| expression.class.is_some());
            known.filter_map(|expression| Some(expression.truth.as_ref()? == expression.class.as_ref()?))
        };
        if truths().next().is_some() {
            let right = truths().filter(|right| *right).count();
            write_line(f, format_args!("{right} of {} with a known class are right", truths().count()))?;
        }
        write_line(f, format_args!("Table: {}", self.out.join(TABLE_NAME).display()))?;
        write_page(f, &self.out.join(PAGE_NAME))
    }
}
