//! A classifier that is kept and used: trained on all clips of a run, with probabilities from the clips that were held out.

mod calibration;
mod card;
mod patterns;
mod recognition;

use std::path::{Path, PathBuf};
use std::sync::{Mutex, MutexGuard, PoisonError};

use burn::tensor::TensorData;
use srflow_files::{FileError, FileKind, FileProblem, create_folder, read_text, write_file};
use srflow_nn::{
    ParameterInfo, Parameters, ParametersError, StoredAs, WeightsError, compare, infos_of,
    parameters_of_safetensors, read_parameters, write_parameters,
};

pub use calibration::{probabilities, temperature};
pub use card::{HeldOut, ModelCard, ModelData, ModelFlow, TrainingRange};
pub use recognition::{Doubt, Recognition};

use self::patterns::{Patterns, limit};
use crate::classifier::{ClassifierEntry, linear_input_len};
use crate::features::{Channel, Features};
use crate::learning::{Example, Learned, Lesson, Unfinished};
use crate::predictions::{Prediction, Trial};
use crate::protocol::Protocol;
use crate::sample::Sample;

/// Names of the files in a model's folder.
const CARD_NAME: &str = "model.json";
const WEIGHTS_NAME: &str = "classifier.safetensors";
const PATTERNS_NAME: &str = "patterns.safetensors";
/// Name of the tensor in the file of patterns.
const PATTERNS: &str = "patterns";

/// Faces and motion may differ from those of the training clips by these factors.
const LESS_MOTION: f64 = 0.5;
const MORE_MOTION: f64 = 1.5;
const SMALLER_FACE: f64 = 0.75;

/// A class is given where it is at least so probable, unless asked otherwise: where it is rather right than wrong.
pub const LEAST_PROBABILITY: f64 = 0.5;

/// A trained classifier, with what is known about it.
pub struct RecognitionModel {
    pub card: ModelCard,
    /// Networks may be used by one thread at a time.
    learned: Mutex<Box<dyn Learned>>,
    patterns: Patterns,
}

/// Why a model cannot be read or made.
#[derive(Debug, thiserror::Error)]
pub enum ModelError {
    #[error(transparent)]
    File(#[from] FileError),
    #[error(transparent)]
    Weights(#[from] WeightsError),
    #[error("{}: {problem}; train the model again", .path.display())]
    Parameters { path: PathBuf, problem: ParametersError },
    #[error("training on all clips diverged in epoch {epoch}; try a smaller learning rate")]
    Diverged { epoch: usize },
}

/// What a model learns from: the clips of a set with the predictions about them when they were held out.
pub struct ModelLesson<'a> {
    pub samples: &'a [&'a Sample],
    pub trial: &'a Trial,
    pub protocol: &'a Protocol,
}

impl ModelLesson<'_> {
    /// The predictions after the last epoch of the seed that the model is trained with.
    fn held_out(&self) -> impl Iterator<Item = &Prediction> + Clone {
        let last = self.trial.predictions.iter().map(|prediction| prediction.epoch).max();
        let seed = self.protocol.seed;
        let counts =
            move |prediction: &&Prediction| Some(prediction.epoch) == last && prediction.seed == seed;
        self.trial.predictions.iter().filter(counts)
    }

    /// The temperature, and how right the predictions about held-out clips are.
    pub fn calibrated(&self) -> (f64, HeldOut) {
        let scored = self.held_out().map(|prediction| (prediction.scores.as_slice(), prediction.truth));
        let temperature = temperature(scored);
        let mut counts = HeldOut { clips: 0, right: 0, sure: 0, sure_and_right: 0 };
        for Prediction { scores, truth, predicted, .. } in self.held_out() {
            let (right, sure) =
                (predicted == truth, probabilities(scores, temperature)[*predicted] >= LEAST_PROBABILITY);
            counts.clips += 1;
            counts.right += usize::from(right);
            counts.sure += usize::from(sure);
            counts.sure_and_right += usize::from(sure && right);
        }
        (temperature, counts)
    }

    /// The part of a clip's motion up to which it is like these clips.
    pub fn unexplained(&self) -> f64 {
        let subject = |sample: &Sample| [sample.dataset.clone(), sample.subject.clone()];
        let mut subjects: Vec<[String; 2]> = self.samples.iter().map(|sample| subject(sample)).collect();
        subjects.sort();
        subjects.dedup();
        let number = |sample: &Sample| subjects.partition_point(|known| *known < subject(sample));
        let clips: Vec<(usize, Vec<f32>)> =
            self.samples.iter().map(|sample| (number(sample), pattern_input(&sample.features))).collect();
        limit(&clips)
    }

    /// The extremes of the motion in the clips.
    pub fn motion_px(&self) -> [f64; 2] {
        let motions = self.samples.iter().map(|sample| motion_px(&sample.features));
        let extremes = |[low, high]: [f64; 2], motion: f64| [low.min(motion), high.max(motion)];
        motions.fold([f64::INFINITY, 0.0], extremes)
    }
}

/// Root mean square of the flow, in pixels of the feature map.
pub fn motion_px(features: &Features) -> f64 {
    let flow = || [Channel::U, Channel::V].into_iter().flat_map(|channel| features.channel(channel));
    let squares: f64 = flow().map(|value| f64::from(*value).powi(2)).sum();
    (squares / flow().count() as f64 * 2.0).sqrt()
}

impl RecognitionModel {
    /// Trains a classifier on all clips.
    ///
    /// # Errors
    /// When training diverges.
    pub fn train(card: ModelCard, lesson: &ModelLesson) -> Result<Self, ModelError> {
        let samples: Vec<Sample> = lesson.samples.iter().map(|sample| (*sample).clone()).collect();
        let examples = Example::of_samples(&samples, card.classifier.input);
        let learned = (card.classifier.train)(
            &Lesson {
                name: "all",
                classes: card.classes.len(),
                examples: &examples.iter().collect::<Vec<_>>(),
                protocol: lesson.protocol,
            },
            &mut |_| true,
        );
        let learned = learned.map_err(|unfinished| match unfinished {
            Unfinished::Diverged { epoch } => ModelError::Diverged { epoch },
            Unfinished::Stopped => unreachable!("it was never asked to stop"),
        })?;
        let inputs: Vec<Vec<f32>> =
            lesson.samples.iter().map(|sample| pattern_input(&sample.features)).collect();
        Ok(Self { card, learned: Mutex::new(learned), patterns: Patterns::of(&inputs) })
    }

    /// The first file of a model's folder.
    pub fn card_path(folder: &Path) -> PathBuf {
        folder.join(CARD_NAME)
    }

    /// Reads a model's folder.
    ///
    /// # Errors
    /// When a file is missing, is no model, or the parameters are not those of its classifier.
    pub fn open(folder: &Path) -> Result<Self, ModelError> {
        let path = Self::card_path(folder);
        let card = parsed(&read_text(&path, FileKind::Json)?).map_err(|problem| problem.in_file(&path))?;
        let path = folder.join(WEIGHTS_NAME);
        let learned = (card.classifier.restore)(read_parameters(&path)?, card.classes.len());
        let learned = learned.map_err(|problem| ModelError::Parameters { path, problem })?;
        let path = folder.join(PATTERNS_NAME);
        let patterns = patterns_of(&read_parameters(&path)?);
        let patterns = patterns.map_err(|problem| ModelError::Parameters { path, problem })?;
        Ok(Self { card, learned: Mutex::new(learned), patterns })
    }

    fn learned(&self) -> MutexGuard<'_, Box<dyn Learned>> {
        self.learned.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Writes a model's folder.
    ///
    /// # Errors
    /// When a file cannot be written.
    pub fn write(&self, folder: &Path) -> Result<(), ModelError> {
        create_folder(folder)?;
        let write = |parameters: &Parameters, name: &str| {
            write_parameters(parameters, StoredAs::F32, None, &folder.join(name))
        };
        write(&self.learned().parameters(), WEIGHTS_NAME)?;
        let rows = &self.patterns.0;
        let values: Vec<f32> = rows.iter().flatten().map(|value| *value as f32).collect();
        let shape = [rows.len(), rows.first().map_or(0, Vec::len)];
        let patterns = Parameters::from([(PATTERNS.to_owned(), TensorData::new(values, shape))]);
        write(&patterns, PATTERNS_NAME)?;
        let card = serde_json::to_string_pretty(&self.card).expect("a card is plain data");
        Ok(write_file(&Self::card_path(folder), card + "\n")?)
    }

    /// The model that comes with srflow: it has learned from rendered clips alone.
    pub fn rendered() -> Self {
        const CARD: &str = include_str!("../../models/rendered/model.json");
        const WEIGHTS: &[u8] = include_bytes!("../../models/rendered/classifier.safetensors");
        const PATTERNS: &[u8] = include_bytes!("../../models/rendered/patterns.safetensors");
        let card = parsed(CARD).unwrap_or_else(|problem| panic!("the card in the repository: {problem:?}"));
        let [weights, patterns] = [WEIGHTS, PATTERNS]
            .map(|file| parameters_of_safetensors(file).expect("the file in the repository is whole"));
        let learned = (card.classifier.restore)(weights, card.classes.len());
        Self {
            learned: Mutex::new(learned.expect("parameters of this classifier")),
            patterns: patterns_of(&patterns).expect("patterns of motion"),
            card,
        }
    }

    /// What the model says about a clip whose face is so many pixels wide.
    pub fn recognize(&self, features: &Features, face_px: usize, least_probability: f64) -> Recognition {
        let input = (self.card.classifier.input)(features);
        let scores = self.learned().scores(&[&input]).remove(0);
        let class = Prediction::class_of(&scores);
        let probabilities = probabilities(&scores, self.card.temperature);
        let TrainingRange { motion_px: [least, most], face_px: [smallest, _], unexplained } = self.card.range;
        let unlike = self.patterns.unexplained(&pattern_input(features));
        let motion_px = motion_px(features);
        let doubt = if (face_px as f64) < SMALLER_FACE * smallest as f64 {
            Some(Doubt::Small { face_px, least_px: smallest })
        } else if motion_px < LESS_MOTION * least {
            Some(Doubt::Still { motion_px, least_px: least })
        } else if motion_px > MORE_MOTION * most {
            Some(Doubt::Far { motion_px, most_px: most })
        } else if unlike > unexplained {
            Some(Doubt::Unlike { unexplained: unlike, most: unexplained })
        } else {
            (probabilities[class] < least_probability).then_some(Doubt::Improbable)
        };
        Recognition { probabilities, class, doubt }
    }
}

/// A clip as patterns explain it: the flow at 14x14.
fn pattern_input(features: &Features) -> Vec<f32> {
    (ClassifierEntry::LINEAR.input)(features)
}

fn patterns_of(parameters: &Parameters) -> Result<Patterns, ParametersError> {
    let length = linear_input_len();
    let info = |shape: &[usize]| ParameterInfo { name: PATTERNS.to_owned(), shape: shape.to_vec() };
    let found = infos_of(parameters);
    let rows = found.first().and_then(|info| info.shape.first()).copied().unwrap_or(0);
    compare(&[info(&[rows, length])], &found)?;
    let values = parameters[PATTERNS].as_slice::<f32>().expect("parameters are f32");
    let row = |row: &[f32]| row.iter().copied().map(f64::from).collect();
    Ok(Patterns(values.chunks_exact(length).map(row).collect()))
}

/// The card of a model.
fn parsed(text: &str) -> Result<ModelCard, FileProblem> {
    let problem = |found: String| FileProblem::field("card", "the card of a model of `mer run`", found);
    let card: ModelCard = serde_json::from_str(text).map_err(|error| problem(error.to_string()))?;
    let positive = |value: f64| value > 0.0 && value.is_finite();
    if !positive(card.temperature) {
        return Err(problem(format!("a temperature of {}", card.temperature)));
    }
    if card.classes.len() < 2 || card.classes.len() > MOST_CLASSES {
        return Err(problem(format!("{} classes", card.classes.len())));
    }
    if let Some(twice) = card.classes.iter().enumerate().find(|(n, class)| card.classes[..*n].contains(class))
    {
        return Err(problem(format!("the class `{}` twice", twice.1)));
    }
    Ok(card)
}

/// More classes are taken for an error.
const MOST_CLASSES: usize = 1000;
