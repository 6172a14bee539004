//! Intervals and tests over subjects.

use srflow_mer::{Confusion, MEASURES, SubjectScores, holm};

/// One subject's clips of two classes: right and wrong ones of each.
fn subject(right: usize, wrong: usize) -> Confusion {
    Confusion(vec![vec![right, wrong], vec![wrong, right]])
}

/// Of subjects with one seed.
fn scores_of(subjects: &[Confusion]) -> SubjectScores {
    SubjectScores::new(subjects.iter().map(std::slice::from_ref))
}

const ACCURACY: usize = 3;
const UF1: usize = 5;

#[test]
fn a_row_of_one_seed_is_compared_with_each_seed_of_another() {
    let seeds = |right: usize| vec![subject(right, 1), subject(right - 1, 2)];
    let several: Vec<Vec<Confusion>> = (3..8).map(seeds).collect();
    let several = SubjectScores::new(several.iter().map(Vec::as_slice));
    let alone = |seed: usize| scores_of(&(3..8).map(|right| seeds(right)[seed].clone()).collect::<Vec<_>>());
    let mean = [ACCURACY, UF1].map(|score| (alone(0).measures()[score] + alone(1).measures()[score]) / 2.0);
    let found = [ACCURACY, UF1].map(|score| several.measures()[score]);
    assert!((found[0] - mean[0]).abs() < 1e-12 && (found[1] - mean[1]).abs() < 1e-12, "{found:?}, {mean:?}");
    // The same predictions with every seed are those of one seed.
    let twice: Vec<Vec<Confusion>> = (3..8).map(|right| vec![subject(right, 1); 2]).collect();
    let twice = SubjectScores::new(twice.iter().map(Vec::as_slice));
    assert_eq!(twice.exchanged(&alone(0)), [1.0; MEASURES]);
    assert_eq!(twice.exchanged(&alone(1)), alone(0).exchanged(&alone(1)));
}

#[test]
fn intervals_narrow_with_subjects_and_hold_the_score() {
    let of = |subjects: usize| {
        let confusions: Vec<Confusion> = (0..subjects).map(|number| subject(3 + number % 3, 2)).collect();
        let scores = scores_of(&confusions);
        (scores.measures()[ACCURACY], scores.intervals()[ACCURACY])
    };
    let ((few, wide), (many, narrow)) = (of(6), of(96));
    assert!(wide.low < few && few < wide.high && narrow.low < many && many < narrow.high);
    let ratio = (wide.high - wide.low) / (narrow.high - narrow.low);
    // The square root of 16, as far as 2000 draws tell.
    assert!((3.0..5.0).contains(&ratio), "{ratio}");
    let alike: Vec<Confusion> = (0..5).map(|_| subject(3, 1)).collect();
    assert_eq!(scores_of(&alike).intervals()[ACCURACY].low, 0.75);
}

#[test]
fn exchanges_are_counted() {
    // Better by the same in each of five subjects: of 32 exchanges, none and all differ as much.
    let (better, worse): (Vec<_>, Vec<_>) = (0..5).map(|_| (subject(3, 1), subject(2, 2))).unzip();
    let (better, worse) = (scores_of(&better), scores_of(&worse));
    assert_eq!(better.exchanged(&worse)[ACCURACY], 2.0 / 32.0);
    assert_eq!(worse.exchanged(&better), better.exchanged(&worse));
    assert_eq!(better.exchanged(&better), [1.0; MEASURES]);
    // Of twenty subjects, exchanges are drawn.
    let (better, worse): (Vec<_>, Vec<_>) = (0..20).map(|_| (subject(3, 1), subject(2, 2))).unzip();
    let p = scores_of(&better).exchanged(&scores_of(&worse))[ACCURACY];
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
