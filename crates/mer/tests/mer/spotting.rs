//! Spotted intervals are scored as the challenges' code scores them.

use std::collections::BTreeMap;

use srflow_data::micro_expression::intervals::{ExpressionKind, Interval};
use srflow_mer::spotting::{CountingRule, Counts, PredictedTypes, retyped, score_intervals};

fn interval(kind: ExpressionKind, onset: i64, offset: i64) -> Interval {
    Interval {
        video: "v".to_owned(),
        kind,
        onset,
        apex: None,
        offset,
        label: String::new(),
        action_units: String::new(),
    }
}

const MICRO: ExpressionKind = ExpressionKind::Micro;
const MACRO: ExpressionKind = ExpressionKind::Macro;

fn truths() -> Vec<Interval> {
    let all = [(MICRO, 100, 112), (MACRO, 200, 240), (MACRO, 205, 238), (MICRO, 400, 414), (MICRO, 700, 711)];
    all.map(|(kind, onset, offset)| interval(kind, onset, offset)).to_vec()
}

fn predictions() -> Vec<Interval> {
    let all = [(98, 110), (203, 239), (402, 420), (600, 605), (704, 715)];
    let mut all = all.map(|(onset, offset)| interval(MACRO, onset, offset)).to_vec();
    retyped(&mut all, PredictedTypes::Duration, 30.0);
    all
}

#[test]
fn rules_count_as_public_code_does() {
    // By hand, for 30 frames per second: IoU 11/15, 37/41 and 34/37, 13/21, none, 8/16.
    let expected = BTreeMap::from([
        ("strict", [[2, 3, 3], [1, 2, 2]]),
        ("exclusive", [[1, 3, 3], [1, 2, 2]]),
        ("megc2020", [[2, 3, 3], [2, 2, 2]]),
        ("of-fd", [[3, 3, 3], [2, 2, 2]]),
        ("any-type", [[3, 3, 3], [1, 2, 2]]),
    ]);
    for rule in CountingRule::ALL {
        let scores = score_intervals(&truths(), &predictions(), rule);
        let counts = [scores.micro, scores.macros].map(|scores| {
            let Counts { found, predicted, truths } = scores.counts;
            [found, predicted, truths]
        });
        assert_eq!(counts, expected[rule.name()], "{rule}");
    }
    let strict = score_intervals(&truths(), &predictions(), CountingRule::Strict);
    assert!((strict.micro.f1 - 2.0 / 3.0).abs() < 1e-12 && (strict.overall.f1 - 0.6).abs() < 1e-12);
    assert_eq!(strict.analysis, None, "no emotions");
}

#[test]
fn the_best_overlap_is_matched_first() {
    let truths = [interval(MICRO, 10, 19), interval(MICRO, 14, 23)];
    // Fits both, the second better; the other prediction fits the first alone.
    let predictions = [interval(MICRO, 13, 22), interval(MICRO, 8, 17)];
    for predictions in [predictions.to_vec(), predictions.iter().rev().cloned().collect()] {
        assert_eq!(score_intervals(&truths, &predictions, CountingRule::Strict).micro.counts.found, 2);
    }
}

#[test]
fn false_alarms_in_videos_without_expressions_count() {
    let elsewhere = Interval { video: "w".to_owned(), ..interval(MICRO, 100, 112) };
    let scores = score_intervals(&truths(), &[elsewhere], CountingRule::Strict);
    assert_eq!((scores.overall.counts.predicted, scores.overall.counts.found, scores.videos), (1, 0, 2));
}

#[test]
fn types_follow_from_lengths() {
    // At 30 frames per second 0.5 s are 15 steps, and 8/30 s are 8.
    let mut all = [
        interval(MACRO, 0, 15),
        interval(MICRO, 0, 16),
        Interval { apex: Some(8), ..interval(MICRO, 0, 40) },
        Interval { apex: Some(9), ..interval(MICRO, 0, 40) },
    ];
    let kinds = |all: &[Interval]| all.iter().map(|interval| interval.kind).collect::<Vec<_>>();
    retyped(&mut all, PredictedTypes::Rise, 30.0);
    assert_eq!(kinds(&all), [MICRO, MACRO, MICRO, MACRO]);
    retyped(&mut all, PredictedTypes::Duration, 30.0);
    assert_eq!(kinds(&all), [MICRO, MACRO, MACRO, MACRO]);
}

#[test]
fn strs_multiplies_spotting_and_analysis() {
    // The example of genbing99/STRS-Metric's README: three of five found, one emotion of three right.
    let labelled =
        |onset: i64, label: &str| Interval { label: label.to_owned(), ..interval(MICRO, onset, onset + 10) };
    let truths: Vec<Interval> = ["happiness", "others", "repression", "others", "others"]
        .iter()
        .enumerate()
        .map(|(number, label)| labelled(100 * number as i64, label))
        .collect();
    let predictions = [
        labelled(0, "Happiness "),
        labelled(101, "repression"),
        labelled(201, "others"),
        labelled(350, "others"),
        labelled(450, "others"),
    ];
    let scores = score_intervals(&truths, &predictions, CountingRule::Strict);
    let analysis = scores.analysis.unwrap();
    assert_eq!((scores.overall.counts.found, analysis.clips), (3, 3));
    assert!((analysis.f1 - 1.0 / 3.0).abs() < 1e-12 && (analysis.strs - 0.2).abs() < 1e-12);
}
