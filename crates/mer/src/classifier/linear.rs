//! Multinomial logistic regression on the means of 8x8 pixels of the flow: the classifier for a few hundred clips. Reference:
//! `LogisticRegression` of scikit-learn. Parity: `PARITY.md`.

use std::collections::BTreeSet;

use burn::tensor::TensorData;
use rayon::prelude::*;
use srflow_core::dense::dot;
use srflow_nn::{ParameterInfo, Parameters, ParametersError, compare, infos_of};

use super::{ClassifierFacts, reduced};
use crate::features::{FEATURE_SIDE, Features};
use crate::learning::{Epoch, Learned, Lesson, Unfinished};

pub(super) const FACTS: ClassifierFacts = ClassifierFacts {
    name: "linear",
    title: "Logistic regression",
    paper: "multinomial, its strength chosen within the training clips",
    reference: "https://scikit-learn.org/stable/modules/generated/sklearn.linear_model.LogisticRegression.html",
    parameters: 1_179,
    input: "u and v at 14x14",
};

/// The inverse strengths of regularization to choose from (`C` of scikit-learn), from the strongest.
pub const INVERSE_STRENGTHS: [f64; 9] = [1e-4, 3e-4, 1e-3, 3e-3, 1e-2, 3e-2, 1e-1, 3e-1, 1.0];

/// The inverse strength where it cannot be chosen, since all training clips are of one subject.
const DEFAULT_INVERSE_STRENGTH: f64 = 1e-2;

/// The most parts that the training subjects are divided into to choose the strength.
const PARTS: usize = 10;

/// Newton's method ends where no derivative of the mean loss is larger.
const GRADIENT: f64 = 1e-7;
const NEWTON_STEPS: usize = 100;
const CONJUGATE_STEPS: usize = 200;

/// So many pixels on a side are averaged.
const FACTOR: usize = 8;

/// The input for a clip: `[2, 14, 14]`, row-major.
pub(super) fn input(features: &Features) -> Vec<f32> {
    reduced::<FACTOR>(features, 2)
}

/// A clip as logistic regression sees it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Observation<'a> {
    pub input: &'a [f32],
    /// Class number.
    pub class: usize,
    /// Number of its subject.
    pub subject: usize,
    /// How much it counts.
    pub weight: f64,
    /// Whether it is a changed copy of another: it is learned from, but the strength is not chosen by it.
    pub copy: bool,
}

/// One score per class that is linear in the inputs.
#[derive(Debug, Clone, PartialEq)]
pub struct LogisticRegression {
    /// `[classes, inputs + 1]`, row-major, for inputs divided by `unit`; the last of a row is its intercept.
    weights: Vec<f64>,
    classes: usize,
    /// Root mean square of the training inputs.
    unit: f64,
}

impl LogisticRegression {
    /// Minimizes `inverse_strength` times the summed cross-entropy, each clip's by its weight, plus half the sum of squared parameters;
    /// intercepts are free. Inputs are divided by their root mean square, so that the strength means the same for small and large
    /// motion. `start` has the parameters for a similar problem.
    ///
    /// # Panics
    /// If inputs differ in length, there are none, or a class is not below `classes`.
    pub fn fit(clips: &[Observation], classes: usize, inverse_strength: f64, start: Option<&Self>) -> Self {
        let problem = Problem::of(clips, classes, inverse_strength);
        let mut weights = match start {
            Some(start) => start.weights.clone(),
            None => vec![0.0; classes * problem.row],
        };
        problem.minimize(&mut weights);
        Self { weights, classes, unit: problem.unit }
    }

    /// One score per class, before any softmax.
    pub fn scores(&self, input: &[f32]) -> Vec<f32> {
        let row = row_of(input, self.unit);
        self.weights.chunks_exact(self.weights.len() / self.classes).map(|w| dot(w, &row) as f32).collect()
    }
}

/// Inputs in their unit, then the 1 of the intercept.
fn row_of(input: &[f32], unit: f64) -> Vec<f64> {
    input.iter().map(|value| f64::from(*value) / unit).chain([1.0]).collect()
}

/// The weighted mean cross-entropy of clips, and half of `decay` times the squared parameters.
struct Problem<'a> {
    clips: &'a [Observation<'a>],
    /// `[clips, row]`.
    rows: Vec<f64>,
    row: usize,
    classes: usize,
    /// The sum of the clips' weights.
    total: f64,
    decay: f64,
    unit: f64,
}

impl<'a> Problem<'a> {
    fn of(clips: &'a [Observation<'a>], classes: usize, inverse_strength: f64) -> Self {
        assert!(clips.iter().all(|clip| clip.class < classes), "labels are numbers of classes");
        let length = clips.first().expect("clips to learn from").input.len();
        assert!(clips.iter().all(|clip| clip.input.len() == length), "inputs have one length");
        let values = clips.iter().flat_map(|clip| clip.input);
        let squares: f64 = values.map(|value| f64::from(*value).powi(2)).sum();
        let mean = squares / (clips.len() * length).max(1) as f64;
        let unit = if mean > 0.0 { mean.sqrt() } else { 1.0 };
        let total: f64 = clips.iter().map(|clip| clip.weight).sum();
        Self {
            clips,
            rows: clips.iter().flat_map(|clip| row_of(clip.input, unit)).collect(),
            row: length + 1,
            classes,
            total,
            decay: 1.0 / (inverse_strength * total),
            unit,
        }
    }

    /// Newton's method, whose steps are found by conjugate gradients.
    fn minimize(&self, weights: &mut Vec<f64>) {
        let (mut loss, mut shares) = self.loss(weights);
        for _ in 0..NEWTON_STEPS {
            let gradient = self.gradient(weights, &shares);
            if gradient.iter().all(|value| value.abs() <= GRADIENT) {
                break;
            }
            let step = self.step(&gradient, &shares);
            let slope = dot(&gradient, &step);
            let mut length = 1.0;
            let moved = loop {
                let moved: Vec<f64> = weights.iter().zip(&step).map(|(w, s)| w + length * s).collect();
                let (found, found_shares) = self.loss(&moved);
                if found <= loss + 1e-4 * length * slope {
                    (loss, shares) = (found, found_shares);
                    break Some(moved);
                }
                length /= 2.0;
                if length < 1e-10 {
                    break None;
                }
            };
            // Rounding leaves nothing to gain.
            let Some(moved) = moved else { break };
            *weights = moved;
        }
    }

    /// The loss, and the probabilities `[clips, classes]`.
    fn loss(&self, weights: &[f64]) -> (f64, Vec<f64>) {
        let mut shares = Vec::with_capacity(self.clips.len() * self.classes);
        let mut sum = 0.0;
        for (row, clip) in self.rows.chunks_exact(self.row).zip(self.clips) {
            let scores: Vec<f64> = weights.chunks_exact(self.row).map(|weights| dot(weights, row)).collect();
            let greatest = scores.iter().copied().fold(f64::NEG_INFINITY, f64::max);
            let total: f64 = scores.iter().map(|score| (score - greatest).exp()).sum();
            sum += clip.weight * (total.ln() + greatest - scores[clip.class]);
            shares.extend(scores.iter().map(|score| (score - greatest).exp() / total));
        }
        let squares: f64 =
            self.decayed(weights).iter().zip(weights).map(|(decayed, weight)| decayed * weight).sum();
        (sum / self.total + squares / 2.0, shares)
    }

    fn gradient(&self, weights: &[f64], shares: &[f64]) -> Vec<f64> {
        let mut errors = shares.to_vec();
        for (of_clip, clip) in errors.chunks_exact_mut(self.classes).zip(self.clips) {
            of_clip[clip.class] -= 1.0;
        }
        self.gathered(&errors, weights)
    }

    /// Minus the gradient times the inverse of the second derivatives, about.
    fn step(&self, gradient: &[f64], shares: &[f64]) -> Vec<f64> {
        let mut step = vec![0.0; gradient.len()];
        let mut rest: Vec<f64> = gradient.iter().map(|value| -value).collect();
        let mut direction = rest.clone();
        let mut squares = dot(&rest, &rest);
        let enough = squares * squares.sqrt().sqrt().min(0.5).powi(2);
        for _ in 0..CONJUGATE_STEPS {
            if squares <= enough {
                break;
            }
            let curved = self.curved(&direction, shares);
            let length = squares / dot(&direction, &curved);
            for (step, direction) in step.iter_mut().zip(&direction) {
                *step += length * direction;
            }
            for (rest, curved) in rest.iter_mut().zip(&curved) {
                *rest -= length * curved;
            }
            let before = std::mem::replace(&mut squares, dot(&rest, &rest));
            for (direction, rest) in direction.iter_mut().zip(&rest) {
                *direction = rest + squares / before * *direction;
            }
        }
        step
    }

    /// The second derivatives times a direction.
    fn curved(&self, direction: &[f64], shares: &[f64]) -> Vec<f64> {
        let mut changes = Vec::with_capacity(shares.len());
        for (row, shares) in self.rows.chunks_exact(self.row).zip(shares.chunks_exact(self.classes)) {
            let scores: Vec<f64> =
                direction.chunks_exact(self.row).map(|weights| dot(weights, row)).collect();
            let mean = dot(shares, &scores);
            changes.extend(shares.iter().zip(&scores).map(|(share, score)| share * (score - mean)));
        }
        self.gathered(&changes, direction)
    }

    /// Weighted mean over clips of the rows times one factor `[clips, classes]` for each class, and the decay.
    fn gathered(&self, factors: &[f64], weights: &[f64]) -> Vec<f64> {
        let mut sums = vec![0.0; weights.len()];
        let rows = self.rows.chunks_exact(self.row).zip(self.clips);
        for ((row, clip), factors) in rows.zip(factors.chunks_exact(self.classes)) {
            for (sums, factor) in sums.chunks_exact_mut(self.row).zip(factors) {
                let factor = clip.weight * factor;
                for (sum, value) in sums.iter_mut().zip(row) {
                    *sum += factor * value;
                }
            }
        }
        sums.iter().zip(self.decayed(weights)).map(|(sum, decayed)| sum / self.total + decayed).collect()
    }

    /// The decay's derivative; intercepts have none.
    fn decayed(&self, weights: &[f64]) -> Vec<f64> {
        let decay = |(at, weight): (usize, &f64)| match (at + 1).is_multiple_of(self.row) {
            true => 0.0,
            false => self.decay * weight,
        };
        weights.iter().enumerate().map(decay).collect()
    }
}

/// For each of [`INVERSE_STRENGTHS`], the weighted mean cross-entropy of clips of held-out subjects: the subjects are assigned in turn
/// to at most ten parts, and each part is held out once. Copies do not count. `None` if all clips are of one subject.
pub fn validation_losses(clips: &[Observation], classes: usize) -> Option<[f64; INVERSE_STRENGTHS.len()]> {
    let mut order: Vec<usize> = Vec::new();
    let mut seen = BTreeSet::new();
    order.extend(clips.iter().map(|clip| clip.subject).filter(|subject| seen.insert(*subject)));
    let parts = order.len().min(PARTS);
    if parts < 2 {
        return None;
    }
    let part_of = |subject: usize| order.iter().position(|known| *known == subject).unwrap_or(0) % parts;
    let total: f64 = clips.iter().filter(|clip| !clip.copy).map(|clip| clip.weight).sum();
    let mut losses = [0.0; INVERSE_STRENGTHS.len()];
    for part in 0..parts {
        let (left_out, kept): (Vec<Observation>, Vec<Observation>) =
            clips.iter().partition(|clip| part_of(clip.subject) == part);
        let mut model: Option<LogisticRegression> = None;
        for (loss, strength) in losses.iter_mut().zip(INVERSE_STRENGTHS) {
            let fitted = LogisticRegression::fit(&kept, classes, strength, model.as_ref());
            for clip in left_out.iter().filter(|clip| !clip.copy) {
                *loss += clip.weight * cross_entropy(&fitted.scores(clip.input), clip.class) / total;
            }
            model = Some(fitted);
        }
    }
    Some(losses)
}

fn cross_entropy(scores: &[f32], label: usize) -> f64 {
    let scores: Vec<f64> = scores.iter().copied().map(f64::from).collect();
    let greatest = scores.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    scores.iter().map(|score| (score - greatest).exp()).sum::<f64>().ln() + greatest - scores[label]
}

impl Learned for LogisticRegression {
    fn scores(&self, inputs: &[&[f32]]) -> Vec<Vec<f32>> {
        inputs.iter().map(|input| self.scores(input)).collect()
    }

    fn parameters(&self) -> Parameters {
        let row = self.weights.len() / self.classes;
        let rows = || self.weights.chunks_exact(row);
        let of_inputs = |row: &[f64]| row[..row.len() - 1].iter().map(|w| (w / self.unit) as f32).collect();
        let weights: Vec<f32> = rows().flat_map(|row| -> Vec<f32> { of_inputs(row) }).collect();
        let intercepts: Vec<f32> = rows().map(|row| row[row.len() - 1] as f32).collect();
        Parameters::from([
            ("weight".to_owned(), TensorData::new(weights, [self.classes, row - 1])),
            ("bias".to_owned(), TensorData::new(intercepts, [self.classes])),
        ])
    }
}

/// The classifier of so many classes with these parameters.
pub(super) fn restore(parameters: Parameters, classes: usize) -> Result<Box<dyn Learned>, ParametersError> {
    let info = |name: &str, shape: &[usize]| ParameterInfo { name: name.to_owned(), shape: shape.to_vec() };
    let inputs = input_len();
    let expected = [info("weight", &[classes, inputs]), info("bias", &[classes])];
    compare(&expected, &infos_of(&parameters))?;
    let values = |name: &str| parameters[name].as_slice::<f32>().expect("parameters are f32");
    let rows = values("weight").chunks_exact(inputs).zip(values("bias"));
    let weights = rows.flat_map(|(row, bias)| row.iter().chain([bias]).map(|value| f64::from(*value)));
    Ok(Box::new(LogisticRegression { weights: weights.collect(), classes, unit: 1.0 }))
}

/// Length of [`input`].
pub(crate) fn input_len() -> usize {
    2 * (FEATURE_SIDE / FACTOR).pow(2)
}

/// Fits the lesson with the strength that explains left-out subjects best.
pub(super) fn train(
    lesson: &Lesson,
    on_epoch: &mut dyn FnMut(Epoch) -> bool,
) -> Result<Box<dyn Learned>, Unfinished> {
    let Lesson { classes, examples, protocol, .. } = *lesson;
    let labels: Vec<usize> = examples.iter().map(|example| example.class).collect();
    let weights = protocol.balance.class_weights(&labels, classes);
    let copies: Vec<Vec<Vec<f32>>> = examples
        .par_iter()
        .map(|example| protocol.augment.copies(example.features).iter().map(input).collect())
        .collect();
    let mut clips: Vec<Observation> = Vec::new();
    for (example, copies) in examples.iter().zip(&copies) {
        // A clip and its copies count as one clip.
        let weight = weights[example.class] / (1 + copies.len()) as f64;
        let seen = [&example.input].into_iter().chain(copies).enumerate();
        clips.extend(seen.map(|(number, input)| Observation {
            input,
            class: example.class,
            subject: example.subject,
            weight,
            copy: number > 0,
        }));
    }
    let strength = validation_losses(&clips, classes).map_or(DEFAULT_INVERSE_STRENGTH, |losses| {
        // Of equal ones the strongest, which is first.
        let best =
            (1..losses.len()).fold(0, |best, other| if losses[other] < losses[best] { other } else { best });
        INVERSE_STRENGTHS[best]
    });
    let model = LogisticRegression::fit(&clips, classes, strength, None);
    let loss = |clip: &Observation| clip.weight * cross_entropy(&model.scores(clip.input), clip.class);
    let total: f64 = clips.iter().map(|clip| clip.weight).sum();
    let loss = clips.iter().map(loss).sum::<f64>() / total;
    on_epoch(Epoch { number: 0, loss, learned: &model });
    Ok(Box::new(model))
}
