//! Metrics of classes.

use srflow_mer::{Confusion, Scores};

/// Truth, prediction, and what `tools/parity/mer_metrics.py` prints for them.
type Fold = (&'static [usize], &'static [usize], [f64; 5]);

#[rustfmt::skip]
const FOLDS: [Fold; 5] = [
    (&[0, 0, 0, 1, 1, 2], &[0, 0, 1, 1, 2, 2], [0.6666666666666666, 0.7222222222222222, 0.6555555555555556, 0.6666666666666666, 0.6933612743506347]),
    (&[0, 0, 0, 0], &[0, 0, 2, 0], [0.5, 0.375, 0.42857142857142855, 0.75, 0.0]),
    (&[0, 0, 1], &[0, 0, 0], [0.3333333333333333, 0.5, 0.4, 0.6666666666666666, 0.0]),
    (&[0, 1], &[2, 2], [0.0, 0.0, 0.0, 0.0, 0.0]),
    (&[1, 1], &[1, 1], [1.0, 1.0, 1.0, 1.0, 1.0]),
];

fn confusion(truth: &[usize], predicted: &[usize]) -> Confusion {
    Confusion::of(3, truth.iter().copied().zip(predicted.iter().copied()))
}

#[test]
fn a_fold_scores_as_in_scikit_learn() {
    for (truth, predicted, expected) in FOLDS {
        for (found, expected) in confusion(truth, predicted).scores().values().iter().zip(expected) {
            assert!((found - expected).abs() < 1e-15, "{truth:?} {predicted:?}: {found} for {expected}");
        }
    }
}

#[test]
fn pooled_scores_count_all_classes() {
    let pooled = confusion(&[0, 0, 0, 1, 1, 2], &[0, 0, 1, 1, 2, 2]);
    assert_eq!([pooled.uf1(), pooled.uar()], [pooled.scores().f1, pooled.scores().recall]);
    let one_class = confusion(&[1, 1], &[1, 1]);
    assert_eq!([one_class.uf1(), one_class.uar()], [1.0 / 3.0; 2]);
}

#[test]
fn any_number_of_classes_is_scored() {
    // Two of five classes are seen: the same as if there were but two.
    let pairs = [(4, 4), (4, 2), (2, 2)];
    let five = Confusion::of(5, pairs);
    assert_eq!(five.scores(), Confusion::of(2, pairs.map(|(truth, said)| (truth / 4, said / 4))).scores());
    assert_eq!(five.uar(), (0.5 + 1.0) / 5.0);
    assert_eq!(five.most_frequent(), 4);
    assert_eq!(five.always(4).0[2], [0, 0, 0, 0, 1]);
    assert_eq!(Confusion::of(4, [(1, 0), (3, 0)]).most_frequent(), 1, "the first of equal ones");
}

#[test]
fn an_empty_fold_scores_zero() {
    assert_eq!(Confusion::new(5).scores(), Scores::default());
    assert_eq!(Scores::mean(&[]), Scores::default());
}
