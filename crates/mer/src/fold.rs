//! One fold: train on its training clips, score its tested clips.

use std::time::Instant;

use crate::learning::{Epoch, Example, Lesson, Train, Unfinished};

#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Trained {
    /// By recorded epoch, then by tested clip, then by class.
    pub(crate) scores: Vec<Vec<Vec<f32>>>,
    /// By recorded epoch: mean cross-entropy over the training clips during that epoch.
    pub(crate) losses: Vec<f64>,
    pub(crate) seconds: f64,
}

/// Trains a classifier and scores `tested` after each of the `recorded` epochs. `goes_on` is called after each epoch.
pub(crate) fn train_fold(
    train: Train,
    lesson: &Lesson,
    tested: &[&Example],
    recorded: &[usize],
    goes_on: &dyn Fn() -> bool,
) -> Result<Trained, Unfinished> {
    let start = Instant::now();
    let inputs: Vec<&[f32]> = tested.iter().map(|example| &example.input[..]).collect();
    let (mut scores, mut losses) = (Vec::new(), Vec::new());
    train(lesson, &mut |Epoch { number, loss, learned }| {
        if recorded.contains(&number) {
            losses.push(loss);
            scores.push(learned.scores(&inputs));
        }
        goes_on()
    })?;
    Ok(Trained { scores, losses, seconds: start.elapsed().as_secs_f64() })
}
