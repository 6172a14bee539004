//! An expression with its class.

use std::fmt;

use serde::Serialize;
use srflow_core::{FlowEstimator, Image};
use srflow_data::micro_expression::intervals::ExpressionKind;
use srflow_mer::{Features, Recognition, RecognitionModel, features_of_frames};

/// An expression with its class.
#[derive(Debug, Clone, Default, PartialEq, Serialize)]
pub struct Classified {
    /// The video, or the dataset.
    pub source: String,
    /// Of a clip.
    pub subject: String,
    /// Of a clip.
    pub clip: String,
    /// Of a spotted expression.
    #[serde(rename = "type")]
    pub kind: Option<ExpressionKind>,
    pub onset: i64,
    pub apex: i64,
    pub offset: i64,
    /// Since the start of the video.
    pub onset_seconds: Option<f64>,
    /// `None` where the model does not know.
    pub class: Option<String>,
    pub most_probable: String,
    /// By class.
    pub probabilities: Vec<f64>,
    /// Why the model does not know.
    pub doubt: Option<String>,
    /// The clip's own class, if its dataset has the model's classes.
    pub truth: Option<String>,
}

/// A model, and what it sees expressions by.
pub struct Classifier<'a> {
    pub model: &'a RecognitionModel,
    /// The flow method of its features.
    pub estimator: &'a dyn FlowEstimator,
    /// A class is named if it is at least so probable.
    pub least_probability: f64,
}

impl Classifier<'_> {
    /// Classifies an expression by its onset and apex, which are cropped alike.
    ///
    /// # Errors
    /// When the flow method fails.
    pub fn classify(&self, expression: Classified, onset: Image, apex: Image) -> anyhow::Result<Seen> {
        let settings = self.model.card.features;
        let (features, _) = features_of_frames(&onset, &apex, self.estimator, settings)?;
        let recognition = self.model.recognize(&features, onset.width(), self.least_probability);
        let classified = expression.with(recognition, &self.model.card.classes);
        Ok((classified, Some(Pictures { onset, apex, features })))
    }
}

/// An expression and its pictures, if its frames were found.
pub type Seen = (Classified, Option<Pictures>);

/// The pictures of an expression, for the page.
pub struct Pictures {
    pub onset: Image,
    pub apex: Image,
    pub features: Features,
}

impl Classified {
    /// With what a model says.
    fn with(mut self, recognition: Recognition, classes: &[String]) -> Self {
        let Recognition { probabilities, class, doubt } = recognition;
        self.most_probable.clone_from(&classes[class]);
        self.class = doubt.is_none().then(|| self.most_probable.clone());
        self.doubt = doubt.map(|doubt| doubt.to_string());
        self.probabilities = probabilities;
        self
    }

    /// Where it is: the video and the time, or the clip.
    pub(super) fn place(&self) -> String {
        match self.onset_seconds {
            Some(seconds) => format!("{} at {seconds:.2} s", self.source),
            None => format!("{}/{}/{}", self.source, self.subject, self.clip),
        }
    }
}

impl fmt::Display for Classified {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let probability = self.probabilities.iter().copied().fold(0.0, f64::max);
        let place = self.place();
        match &self.doubt {
            None => write!(f, "{place}: {} ({:.0} %)", self.most_probable, 100.0 * probability),
            Some(doubt) => write!(f, "{place}: unknown, {doubt}"),
        }
    }
}
