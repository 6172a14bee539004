//! Intervals and tests over subjects.

use srflow_mer::{Confusion, MEASURES, SubjectScores, holm};

/// One subject's clips of two classes: right and wrong ones of each.
fn subject(right: usize, wrong: usize) -> Confusion {
    Confusion(vec![vec![right, wrong], vec![wrong, right]])
}

const ACCURACY: usize = 3;

#[test]
fn intervals_narrow_with_subjects_and_hold_the_score() {
    let of = |subjects: usize| {
        let confusions: Vec<Confusion> = (0..subjects).map(|number| subject(3 + number % 3, 2)).collect();
        let scores = SubjectScores::new(&confusions);
        (scores.measures()[ACCURACY], scores.intervals()[ACCURACY])
    };
    let ((few, wide), (many, narrow)) = (of(6), of(96));
    assert!(wide.low < few && few < wide.high && narrow.low < many && many < narrow.high);
    let ratio = (wide.high - wide.low) / (narrow.high - narrow.low);
    // The square root of 16, as far as 2000 draws tell.
    assert!((3.0..5.0).contains(&ratio), "{ratio}");
    let alike: Vec<Confusion> = (0..5).map(|_| subject(3, 1)).collect();
    assert_eq!(SubjectScores::new(&alike).intervals()[ACCURACY].low, 0.75);
}

#[test]
fn exchanges_are_counted() {
    // Better by the same in each of five subjects: of 32 exchanges, none and all differ as much.
    let (better, worse): (Vec<_>, Vec<_>) = (0..5).map(|_| (subject(3, 1), subject(2, 2))).unzip();
    let (better, worse) = (SubjectScores::new(&better), SubjectScores::new(&worse));
    assert_eq!(better.exchanged(&worse)[ACCURACY], 2.0 / 32.0);
    assert_eq!(worse.exchanged(&better), better.exchanged(&worse));
    assert_eq!(better.exchanged(&better), [1.0; MEASURES]);
    // Of twenty subjects, exchanges are drawn.
    let (better, worse): (Vec<_>, Vec<_>) = (0..20).map(|_| (subject(3, 1), subject(2, 2))).unzip();
    let p = SubjectScores::new(&better).exchanged(&SubjectScores::new(&worse))[ACCURACY];
    assert!(p < 1e-3 && p > 0.0, "{p}");
}

#[test]
fn holm_raises_the_smallest_most() {
    let raised = holm(&[0.01, 0.04, 0.03, 0.5]);
    let expected = [0.04, 0.09, 0.09, 0.5];
    assert!(
        raised.iter().zip(expected).all(|(found, expected)| (found - expected).abs() < 1e-12),
        "{raised:?}"
    );
    assert_eq!(holm(&[0.6, 0.7]), [1.0, 1.0]);
    assert!(holm(&[]).is_empty());
}
