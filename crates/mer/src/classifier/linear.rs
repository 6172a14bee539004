//! Multinomial logistic regression on the means of 8x8 pixels of the flow: the classifier for a few hundred clips. Reference:
//! `LogisticRegression` of scikit-learn. Parity: `PARITY.md`.

use std::collections::BTreeSet;
use std::time::Instant;

use srflow_core::dense::dot;

use super::{ClassifierFacts, reduced};
use crate::features::Features;
use crate::fold::{Example, Trained, Unfinished};
use crate::protocol::Protocol;

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

/// The input for a clip: `[2, 14, 14]`, row-major.
pub(super) fn input(features: &Features) -> Vec<f32> {
    reduced::<8>(features, 2)
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
    /// Minimizes `inverse_strength` times the summed cross-entropy plus half the sum of squared weights; intercepts are free.
    /// Inputs are divided by their root mean square, so that the strength means the same for small and large motion.
    /// `start` has the weights of a similar problem.
    ///
    /// # Panics
    /// If inputs differ in length, there are none, or a label is no class.
    pub fn fit(
        inputs: &[&[f32]],
        labels: &[usize],
        classes: usize,
        inverse_strength: f64,
        start: Option<&Self>,
    ) -> Self {
        let problem = Problem::of(inputs, labels, classes, inverse_strength);
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

/// The mean cross-entropy of clips, and half of `decay` times the squared weights.
struct Problem<'a> {
    /// `[clips, row]`.
    rows: Vec<f64>,
    row: usize,
    labels: &'a [usize],
    classes: usize,
    decay: f64,
    unit: f64,
}

impl<'a> Problem<'a> {
    fn of(inputs: &[&[f32]], labels: &'a [usize], classes: usize, inverse_strength: f64) -> Self {
        assert!(!inputs.is_empty() && inputs.len() == labels.len(), "a label for each of the inputs");
        assert!(labels.iter().all(|label| *label < classes), "labels are numbers of classes");
        let length = inputs[0].len();
        assert!(inputs.iter().all(|input| input.len() == length), "inputs have one length");
        let squares: f64 = inputs.iter().copied().flatten().map(|value| f64::from(*value).powi(2)).sum();
        let mean = squares / (inputs.len() * length).max(1) as f64;
        let unit = if mean > 0.0 { mean.sqrt() } else { 1.0 };
        Self {
            rows: inputs.iter().flat_map(|input| row_of(input, unit)).collect(),
            row: length + 1,
            labels,
            classes,
            decay: 1.0 / (inverse_strength * inputs.len() as f64),
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
        let mut shares = Vec::with_capacity(self.labels.len() * self.classes);
        let mut sum = 0.0;
        for (row, label) in self.rows.chunks_exact(self.row).zip(self.labels) {
            let scores: Vec<f64> = weights.chunks_exact(self.row).map(|weights| dot(weights, row)).collect();
            let greatest = scores.iter().copied().fold(f64::NEG_INFINITY, f64::max);
            let total: f64 = scores.iter().map(|score| (score - greatest).exp()).sum();
            sum += total.ln() + greatest - scores[*label];
            shares.extend(scores.iter().map(|score| (score - greatest).exp() / total));
        }
        let squares: f64 =
            self.decayed(weights).iter().zip(weights).map(|(decayed, weight)| decayed * weight).sum();
        (sum / self.labels.len() as f64 + squares / 2.0, shares)
    }

    fn gradient(&self, weights: &[f64], shares: &[f64]) -> Vec<f64> {
        let mut errors = shares.to_vec();
        for (of_clip, label) in errors.chunks_exact_mut(self.classes).zip(self.labels) {
            of_clip[*label] -= 1.0;
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

    /// Mean over clips of the rows times one factor `[clips, classes]` for each class, and the decay of weights.
    fn gathered(&self, factors: &[f64], weights: &[f64]) -> Vec<f64> {
        let mut sums = vec![0.0; weights.len()];
        for (row, factors) in self.rows.chunks_exact(self.row).zip(factors.chunks_exact(self.classes)) {
            for (sums, factor) in sums.chunks_exact_mut(self.row).zip(factors) {
                for (sum, value) in sums.iter_mut().zip(row) {
                    *sum += factor * value;
                }
            }
        }
        let count = self.labels.len() as f64;
        sums.iter().zip(self.decayed(weights)).map(|(sum, decayed)| sum / count + decayed).collect()
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

/// For each of [`INVERSE_STRENGTHS`], the mean cross-entropy of clips of held-out subjects: the subjects are assigned in turn to at
/// most ten parts, and each part is held out once. `None` if all clips are of one subject.
pub fn validation_losses(
    inputs: &[&[f32]],
    labels: &[usize],
    subjects: &[usize],
    classes: usize,
) -> Option<[f64; INVERSE_STRENGTHS.len()]> {
    let mut order: Vec<usize> = Vec::new();
    let mut seen = BTreeSet::new();
    order.extend(subjects.iter().filter(|subject| seen.insert(**subject)));
    let parts = order.len().min(PARTS);
    if parts < 2 {
        return None;
    }
    let part_of = |subject: usize| order.iter().position(|known| *known == subject).unwrap_or(0) % parts;
    let mut losses = [0.0; INVERSE_STRENGTHS.len()];
    for part in 0..parts {
        let (left_out, kept): (Vec<usize>, Vec<usize>) =
            (0..inputs.len()).partition(|&clip| part_of(subjects[clip]) == part);
        let kept_inputs: Vec<&[f32]> = kept.iter().map(|&clip| inputs[clip]).collect();
        let kept_labels: Vec<usize> = kept.iter().map(|&clip| labels[clip]).collect();
        let mut model: Option<LogisticRegression> = None;
        for (loss, strength) in losses.iter_mut().zip(INVERSE_STRENGTHS) {
            let fitted =
                LogisticRegression::fit(&kept_inputs, &kept_labels, classes, strength, model.as_ref());
            for &clip in &left_out {
                *loss += cross_entropy(&fitted.scores(inputs[clip]), labels[clip]) / inputs.len() as f64;
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

/// Trains on `training` with the strength that explains left-out subjects best, and scores `tested`.
pub(super) fn train_fold(
    _name: &str,
    classes: usize,
    training: &[&Example],
    tested: &[&Example],
    _protocol: &Protocol,
    goes_on: &dyn Fn() -> bool,
) -> Result<Trained, Unfinished> {
    let start = Instant::now();
    let inputs: Vec<&[f32]> = training.iter().map(|example| &example.input[..]).collect();
    let labels: Vec<usize> = training.iter().map(|example| example.class).collect();
    let subjects: Vec<usize> = training.iter().map(|example| example.subject).collect();
    let losses = validation_losses(&inputs, &labels, &subjects, classes);
    let strength = losses.map_or(DEFAULT_INVERSE_STRENGTH, |losses| {
        // Of equal ones the strongest, which is first.
        let best =
            (1..losses.len()).fold(0, |best, other| if losses[other] < losses[best] { other } else { best });
        INVERSE_STRENGTHS[best]
    });
    let model = LogisticRegression::fit(&inputs, &labels, classes, strength, None);
    let loss: f64 =
        inputs.iter().zip(&labels).map(|(input, label)| cross_entropy(&model.scores(input), *label)).sum();
    let scores = tested.iter().map(|example| model.scores(&example.input)).collect();
    goes_on();
    Ok(Trained {
        scores: vec![scores],
        losses: vec![loss / inputs.len().max(1) as f64],
        seconds: start.elapsed().as_secs_f64(),
    })
}
