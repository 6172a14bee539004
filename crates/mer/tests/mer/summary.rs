//! The summary of a trial.

use srflow_mer::{Best, Confusion, Prediction, Summary, SummaryError};

use crate::made_up::{NEGATIVE, POSITIVE, SURPRISE, prediction};

fn summary(predictions: &[Prediction]) -> Result<Summary, SummaryError> {
    Summary::of(&["negative", "positive", "surprise"].map(str::to_owned).into(), predictions)
}

/// Two subjects, one of them with a single clip; two epochs.
fn run() -> Vec<Prediction> {
    vec![
        prediction("1", "a", 0, [NEGATIVE, NEGATIVE]),
        prediction("1", "b", 0, [SURPRISE, NEGATIVE]),
        prediction("2", "a", 0, [POSITIVE, POSITIVE]),
        prediction("1", "a", 20, [NEGATIVE, SURPRISE]),
        prediction("1", "b", 20, [SURPRISE, SURPRISE]),
        prediction("2", "a", 20, [POSITIVE, NEGATIVE]),
    ]
}

#[test]
fn each_metric_takes_its_own_epoch() {
    let mut predictions = run();
    // A third epoch: subject 1 as at first, subject 2 wrong.
    predictions.push(prediction("1", "a", 40, [NEGATIVE, NEGATIVE]));
    predictions.push(prediction("1", "b", 40, [SURPRISE, SURPRISE]));
    predictions.push(prediction("2", "a", 40, [POSITIVE, NEGATIVE]));
    let summary = summary(&predictions).unwrap();
    let best = summary.best();
    assert_eq!(best[3], Best { value: 0.75, epoch: 0 }); // accuracy: (1/2 + 1) / 2
    assert_eq!(best[1], Best { value: 0.75, epoch: 0 }); // recall
    assert_eq!(best[4], Best { value: 0.5, epoch: 0 }); // geometric mean: first of equals
    assert_eq!(summary.last().epoch, 40);
    assert_eq!(summary.last().mean.accuracy, 0.5);
    assert_eq!(summary.last().pooled, [Confusion(vec![vec![1, 0, 0], vec![1, 0, 0], vec![0, 0, 1]])]);
}

#[test]
fn the_baseline_is_of_the_same_clips() {
    let summary = summary(&run()).unwrap();
    let baseline = summary.baseline();
    assert_eq!(baseline.pooled, [Confusion(vec![vec![1, 0, 0], vec![1, 0, 0], vec![1, 0, 0]])]);
    assert_eq!(baseline.mean.accuracy, 0.25);
    assert_eq!(summary.folds[1].clips(), 1);
}

#[test]
fn scores_of_several_seeds_are_their_means() {
    let of_seed = |seed, predictions: Vec<Prediction>| {
        predictions.into_iter().map(move |prediction| Prediction { seed, ..prediction })
    };
    let mut other = run();
    other[4].predicted = NEGATIVE;
    let [first, second] = [run(), other.clone()].map(|predictions| summary(&predictions).unwrap());
    let both: Vec<Prediction> = of_seed(3, run()).chain(of_seed(4, other)).collect();
    let both = summary(&both).unwrap();
    assert_eq!((both.seeds.as_slice(), both.clips()), ([3, 4].as_slice(), 3));
    let mean = |of: fn(&Summary) -> f64| (of(&first) + of(&second)) / 2.0;
    assert_eq!(both.last().mean.accuracy, mean(|summary| summary.last().mean.accuracy));
    assert_eq!(both.last().uf1(), mean(|summary| summary.last().uf1()));
    assert!(first.last().uf1() > second.last().uf1());
    assert_eq!(both.last().counts().total(), 6);
    assert_eq!(both.baseline(), first.baseline());

    let error = summary(&of_seed(3, run()).chain(of_seed(4, run()).skip(1)).collect::<Vec<_>>());
    let error = error.unwrap_err().to_string();
    assert!(error.contains("subject 1 clip a has 0 predictions at epoch 0 of seed 4"), "{error}");
}

#[test]
fn a_clip_that_is_missing_or_there_twice_or_doubtful_is_named() {
    assert_eq!(summary(&[]), Err(SummaryError::Empty));
    let mut twice = run();
    twice.push(twice[1].clone());
    let error = summary(&twice).unwrap_err().to_string();
    assert!(error.contains("subject 1 clip b has 2 predictions at epoch 0"), "{error}");
    let error = summary(&run()[..5]).unwrap_err().to_string();
    assert!(error.contains("subject 2 clip a has 0 predictions at epoch 20"), "{error}");
    let mut doubtful = run();
    doubtful[5].truth = SURPRISE;
    let error = summary(&doubtful).unwrap_err().to_string();
    assert!(error.contains("subject 2 clip a is positive in one prediction and surprise"), "{error}");
}
