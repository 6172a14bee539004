//! Made-up predictions.

use srflow_mer::Prediction;

pub const NEGATIVE: usize = 0;
pub const POSITIVE: usize = 1;
pub const SURPRISE: usize = 2;

/// A prediction for a clip of the dataset `made-up`; `said` is the true and the predicted class.
pub fn prediction(subject: &str, clip: &str, epoch: usize, said: [usize; 2]) -> Prediction {
    Prediction {
        dataset: "made-up".into(),
        subject: subject.into(),
        clip: clip.into(),
        truth: said[0],
        seed: 0,
        epoch,
        predicted: said[1],
        scores: vec![0.0; 3],
    }
}
