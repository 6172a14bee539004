//! Models that are trained once, saved, and used.

use std::sync::Arc;

use srflow_core::random::Key;
use srflow_mer::{
    CLASSIFIERS, ClassifierEntry, Doubt, FeatureSettings, Features, HeldOut, ModelCard, ModelFlow,
    ModelLesson, Prediction, Protocol, RecognitionModel, Sample, TrainingRange, Trial, probabilities,
    temperature,
};

/// Features that move to the right by so many pixels of the map, with noise.
fn features(right: f32, seed: u64) -> Features {
    let mut stream = Key::new(seed).stream("features");
    let values = (0..Features::LEN).map(|place| match place < Features::LEN / 3 {
        true => right + 0.1 * stream.normal(),
        false => 0.1 * stream.normal(),
    });
    Features::from_values(values.collect()).unwrap()
}

/// Three subjects with two clips of each of two classes, which move to either side.
fn samples() -> Vec<Sample> {
    let sample = |subject: u64, class: usize, take: u64| Sample {
        dataset: "d".to_owned(),
        subject: subject.to_string(),
        clip: format!("{class}-{take}"),
        class,
        features: features(if class == 0 { -1.0 } else { 1.0 }, 10 * subject + 5 * class as u64 + take),
        head_motion: None,
    };
    let all =
        (0..3).flat_map(|subject| (0..2).flat_map(move |class| [0, 1].map(|take| (subject, class, take))));
    all.map(|(subject, class, take)| sample(subject, class, take)).collect()
}

fn card(classifier: ClassifierEntry) -> ModelCard {
    ModelCard {
        srflow_version: "0".to_owned(),
        date: "2026-01-31T00:00:00Z".to_owned(),
        note: String::new(),
        classifier,
        classes: vec!["left".to_owned(), "right".to_owned()],
        features: FeatureSettings::default(),
        faces: "whole frames".to_owned(),
        flow: ModelFlow { method: "farneback".to_owned(), sha256: None, parameters: String::new() },
        data: Vec::new(),
        held_out: HeldOut { clips: 0, right: 0, sure: 0, sure_and_right: 0 },
        temperature: 1.5,
        range: TrainingRange { motion_px: [0.9, 1.1], face_px: [100, 200], unexplained: 0.8 },
    }
}

fn trained(classifier: ClassifierEntry) -> RecognitionModel {
    let samples = samples();
    let samples: Vec<&Sample> = samples.iter().collect();
    let protocol = Protocol { epochs: 2, batch: 6, ..Protocol::default() };
    let trial =
        Trial { method: "m".to_owned(), set: "d".to_owned(), classes: Arc::new([]), predictions: Vec::new() };
    let lesson = ModelLesson { samples: &samples, trial: &trial, protocol: &protocol };
    RecognitionModel::train(card(classifier), &lesson).unwrap()
}

#[test]
fn a_model_says_the_same_after_it_was_written_and_read() {
    for classifier in CLASSIFIERS {
        let folder = tempfile::tempdir().unwrap();
        let model = trained(classifier);
        model.write(folder.path()).unwrap();
        let read = RecognitionModel::open(folder.path()).unwrap();
        assert_eq!(read.card, model.card);
        for (right, seed) in [(-1.0, 1), (1.0, 2), (0.3, 3)] {
            let clip = features(right, seed);
            let [before, after] = [&model, &read].map(|model| model.recognize(&clip, 150, 0.0));
            assert_eq!((before.class, before.doubt), (after.class, after.doubt), "{classifier}");
            for (before, after) in before.probabilities.iter().zip(&after.probabilities) {
                assert!((before - after).abs() < 1e-5, "{classifier}: {before} {after}");
            }
        }
    }
}

#[test]
fn a_model_knows_what_it_has_seen_and_says_why_it_does_not_know() {
    let model = trained(ClassifierEntry::LINEAR);
    let said = model.recognize(&features(1.0, 7), 150, 0.5);
    assert_eq!((said.class, said.doubt), (1, None));
    assert!(said.probabilities[1] > 0.5 && (said.probabilities.iter().sum::<f64>() - 1.0).abs() < 1e-12);
    assert_eq!(model.recognize(&features(-1.0, 7), 150, 0.5).class, 0);
    let doubt = |right, face_px, least| model.recognize(&features(right, 7), face_px, least).doubt;
    assert_eq!(doubt(1.0, 150, 1.0), Some(Doubt::Improbable));
    assert!(matches!(doubt(3.0, 150, 0.0), Some(Doubt::Far { most_px: 1.1, .. })));
    assert!(matches!(doubt(0.1, 150, 0.0), Some(Doubt::Still { least_px: 0.9, .. })));
    let mut sideways = features(0.0, 7).values().to_vec();
    let third = Features::LEN / 3;
    sideways[third..2 * third]
        .iter_mut()
        .enumerate()
        .for_each(|(place, v)| *v = ((place / 16) % 2) as f32 * 2.8 - 1.4);
    let unlike = model.recognize(&Features::from_values(sideways).unwrap(), 150, 0.0).doubt;
    assert!(matches!(unlike, Some(Doubt::Unlike { most: 0.8, .. })), "{unlike:?}");
    assert_eq!(doubt(1.0, 60, 0.0), Some(Doubt::Small { face_px: 60, least_px: 100 }));
}

#[test]
fn probabilities_of_held_out_clips_are_their_frequencies() {
    // A classifier that is right in three of four clips, and twenty times too sure of it.
    let clips: Vec<([f32; 2], usize)> =
        (0..400).map(|clip| ([20.0 * 3.0_f32.ln(), 0.0], usize::from(clip % 4 == 0))).collect();
    let found = temperature(clips.iter().map(|(scores, truth)| (&scores[..], *truth)));
    assert!((found - 20.0).abs() < 0.05, "{found}");
    let shares = probabilities(&clips[0].0, found);
    assert!((shares[0] - 0.75).abs() < 1e-3, "{shares:?}");
    assert_eq!(temperature(std::iter::empty()), 1.0);
}

#[test]
fn held_out_clips_are_counted_after_the_last_epoch() {
    let prediction = |epoch, truth, scores: [f32; 2]| Prediction {
        dataset: "d".to_owned(),
        subject: "s".to_owned(),
        clip: format!("{truth}{scores:?}"),
        truth,
        seed: 0,
        epoch,
        predicted: Prediction::class_of(&scores),
        scores: scores.to_vec(),
    };
    let predictions = vec![
        prediction(0, 1, [9.0, 0.0]),
        prediction(7, 0, [1.0, 0.0]),
        prediction(7, 0, [2.0, 0.0]),
        prediction(7, 1, [2.0, 0.0]),
    ];
    let trial = Trial { method: "m".to_owned(), set: "d".to_owned(), classes: Arc::new([]), predictions };
    let protocol = Protocol::default();
    let (_, counts) = ModelLesson { samples: &[], trial: &trial, protocol: &protocol }.calibrated();
    assert_eq!(counts, HeldOut { clips: 3, right: 2, sure: 3, sure_and_right: 2 });
}

#[test]
fn a_damaged_model_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let refused = || RecognitionModel::open(folder.path()).err().unwrap().to_string();
    assert!(refused().contains("model.json"), "{}", refused());
    trained(ClassifierEntry::LINEAR).write(folder.path()).unwrap();
    let card = folder.path().join("model.json");
    let text = std::fs::read_to_string(&card).unwrap();
    for (from, to, expected) in [
        ("\"temperature\": 1.5", "\"temperature\": 0", "a temperature of 0"),
        ("\"temperature\"", "\"heat\"", "heat"),
        ("\"linear\"", "\"quadratic\"", "quadratic"),
        ("\"right\"\n", "\"right\", \"up\"\n", "classifier.safetensors: the parameters do not fit"),
        ("\"right\"\n", "\"left\"\n", "twice"),
    ] {
        assert!(text.contains(from), "{from}: {text}");
        std::fs::write(&card, text.replacen(from, to, 1)).unwrap();
        let said = refused();
        assert!(said.contains(expected), "{from}: {said}");
    }
    std::fs::write(&card, &text).unwrap();
    std::fs::write(folder.path().join("classifier.safetensors"), "x").unwrap();
    assert!(refused().contains("classifier.safetensors"), "{}", refused());
}

#[test]
fn the_model_that_comes_with_srflow_is_whole() {
    let model = RecognitionModel::rendered();
    assert_eq!(model.card.classes, ["negative", "positive", "surprise"]);
    assert!(model.card.note.contains("rendered"), "{}", model.card.note);
    let HeldOut { clips, right, sure, sure_and_right } = model.card.held_out;
    assert!(clips >= 500 && 10 * right > 9 * clips, "{right} of {clips}");
    assert!(sure_and_right * clips >= right * sure, "those that it is sure of are right as often");
}
