//! What the training of any classifier takes and gives.

use std::collections::BTreeMap;

use srflow_nn::{Parameters, ParametersError};

use crate::features::Features;
use crate::protocol::Protocol;
use crate::sample::Sample;

/// A clip to learn from or to classify.
pub(crate) struct Example<'a> {
    /// Dataset, subject and clip.
    pub(crate) name: String,
    pub(crate) features: &'a Features,
    /// What the classifier sees of the features.
    pub(crate) input: Vec<f32>,
    pub(crate) class: usize,
    /// Number of its subject, within a run.
    pub(crate) subject: usize,
}

impl<'a> Example<'a> {
    /// Clips as a classifier with this input sees them.
    pub(crate) fn of_samples(samples: &'a [Sample], input: fn(&Features) -> Vec<f32>) -> Vec<Self> {
        let mut subjects = BTreeMap::new();
        for Sample { dataset, subject, .. } in samples {
            subjects.insert([dataset, subject], 0);
        }
        subjects.values_mut().zip(0..).for_each(|(number, count)| *number = count);
        let example = |sample: &'a Sample| Self {
            name: [&*sample.dataset, &sample.subject, &sample.clip].join("/"),
            features: &sample.features,
            input: input(&sample.features),
            class: sample.class,
            subject: subjects[&[&sample.dataset, &sample.subject]],
        };
        samples.iter().map(example).collect()
    }
}

/// What a classifier learns from.
pub(crate) struct Lesson<'a> {
    /// Random numbers are keyed by it, so that a fold does not depend on which others run, or where.
    pub(crate) name: &'a str,
    /// Number of classes.
    pub(crate) classes: usize,
    pub(crate) examples: &'a [&'a Example<'a>],
    pub(crate) protocol: &'a Protocol,
}

/// A classifier that has learned: it needs nothing else to score clips.
pub(crate) trait Learned: Send {
    /// One score per class, before any softmax, for each of the classifier's inputs.
    fn scores(&self, inputs: &[&[f32]]) -> Vec<Vec<f32>>;

    /// All that it has learned, by name.
    fn parameters(&self) -> Parameters;
}

/// A classifier after another pass over its lesson.
pub(crate) struct Epoch<'a> {
    /// From 0.
    pub(crate) number: usize,
    /// Mean cross-entropy over the lesson during this epoch.
    pub(crate) loss: f64,
    pub(crate) learned: &'a dyn Learned,
}

/// Trains a classifier. The function is called after each epoch and says whether to go on; a classifier whose last epoch is done is
/// trained whatever it says.
pub(crate) type Train = fn(&Lesson, &mut dyn FnMut(Epoch) -> bool) -> Result<Box<dyn Learned>, Unfinished>;

/// A classifier of so many classes that has learned these parameters.
pub(crate) type Restore = fn(Parameters, usize) -> Result<Box<dyn Learned>, ParametersError>;

/// Why training has no result.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Unfinished {
    /// The loss was not finite in this epoch.
    Diverged {
        epoch: usize,
    },
    Stopped,
}
