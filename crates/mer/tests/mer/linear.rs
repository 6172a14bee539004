//! Logistic regression against scikit-learn's; `tools/parity/mer_linear.py` repeats the rules for inputs and wrote the golden values.

use srflow_mer::{INVERSE_STRENGTHS, LogisticRegression, Observation, validation_losses};
use srflow_ops::golden::{Golden, noise};

const CLIPS: usize = 40;
const TRAINING: usize = 30;
const SUBJECTS: usize = 8;
const CLASSES: usize = 4;
const INPUTS: usize = 12;

struct Clips {
    inputs: Vec<Vec<f32>>,
    labels: Vec<usize>,
    subjects: Vec<usize>,
}

impl Clips {
    fn new() -> Self {
        let labels: Vec<usize> = (0..CLIPS).map(|clip| clip * 7 % 5 % CLASSES).collect();
        let value = |clip: usize, at: usize| {
            noise((clip * INPUTS + at) as u32, 3) + if at == labels[clip] { 0.75 } else { 0.0 }
        };
        Self {
            inputs: (0..CLIPS).map(|clip| (0..INPUTS).map(|at| value(clip, at)).collect()).collect(),
            subjects: (0..CLIPS).map(|clip| clip % SUBJECTS).collect(),
            labels,
        }
    }

    fn observations(&self) -> Vec<Observation<'_>> {
        observations(&self.inputs, &self.labels, &self.subjects)
    }
}

/// Clips that count alike.
fn observations<'a>(inputs: &'a [Vec<f32>], labels: &[usize], subjects: &[usize]) -> Vec<Observation<'a>> {
    let clips = inputs.iter().zip(labels).zip(subjects);
    clips
        .map(|((input, &class), &subject)| Observation { input, class, subject, weight: 1.0, copy: false })
        .collect()
}

fn golden() -> Golden {
    Golden::read("tests/golden/linear.safetensors")
}

fn largest_difference(found: impl IntoIterator<Item = f32>, expected: &[f32]) -> f32 {
    found.into_iter().zip(expected).map(|(found, expected)| (found - expected).abs()).fold(0.0, f32::max)
}

#[test]
fn scores_are_scikit_learns() {
    let (clips, golden) = (Clips::new(), golden());
    for strength in INVERSE_STRENGTHS {
        let model = LogisticRegression::fit(&clips.observations()[..TRAINING], CLASSES, strength, None);
        let found = clips.inputs.iter().flat_map(|input| {
            let scores = model.scores(input);
            let mean = scores.iter().sum::<f32>() / CLASSES as f32;
            scores.into_iter().map(move |score| score - mean)
        });
        let difference = largest_difference(found, golden.values(&format!("scores.{strength}")));
        assert!(difference < 2e-5, "C = {strength}: {difference}");
    }
}

#[test]
fn losses_of_left_out_subjects_are_scikit_learns() {
    let (clips, golden) = (Clips::new(), golden());
    let losses = validation_losses(&clips.observations(), CLASSES).unwrap();
    let difference = largest_difference(losses.map(|loss| loss as f32), golden.values("losses"));
    assert!(difference < 1e-5, "{difference}");
    // Copies of clips, some of them of wrong classes, are learned from: no loss is theirs.
    let copies = clips.observations().into_iter().map(|clip| Observation { weight: 0.0, copy: true, ..clip });
    let with_copies: Vec<Observation> = clips.observations().into_iter().chain(copies).collect();
    let found = validation_losses(&with_copies, CLASSES).unwrap();
    assert!(
        found.iter().zip(losses).all(|(found, loss)| (found - loss).abs() < 1e-6),
        "{found:?}, {losses:?}"
    );
    let of_one = observations(&clips.inputs, &clips.labels, &[0; CLIPS]);
    assert_eq!(validation_losses(&of_one, CLASSES), None, "one subject");
}

#[test]
fn the_unit_of_the_flow_does_not_matter() {
    let clips = Clips::new();
    let fit = |inputs: &[Vec<f32>]| {
        LogisticRegression::fit(&observations(inputs, &clips.labels, &clips.subjects), CLASSES, 0.1, None)
    };
    let scaled: Vec<Vec<f32>> =
        clips.inputs.iter().map(|input| input.iter().map(|value| 0.125 * value).collect()).collect();
    let (model, of_scaled) = (fit(&clips.inputs), fit(&scaled));
    for (input, scaled) in clips.inputs.iter().zip(&scaled) {
        assert_eq!(model.scores(input), of_scaled.scores(scaled));
    }
}

#[test]
fn a_class_without_clips_gets_the_least_scores() {
    let inputs = [[1.0, 0.0], [0.9, 0.1], [0.0, 1.0], [0.1, 0.8]].map(Vec::from);
    let model = LogisticRegression::fit(&observations(&inputs, &[0, 0, 2, 2], &[0; 4]), 3, 1.0, None);
    for (input, class) in inputs.iter().zip([0, 0, 2, 2]) {
        let scores = model.scores(input);
        assert!(scores.iter().all(|score| score.is_finite() && *score <= scores[class]), "{scores:?}");
        assert!(scores[1] < scores[0].min(scores[2]), "{scores:?}");
    }
    let still = [vec![0.0; 2], vec![0.0; 2]];
    let still = LogisticRegression::fit(&observations(&still, &[1, 1], &[0; 2]), 2, 1.0, None);
    assert!(still.scores(&[0.0, 0.0]).iter().all(|score| score.is_finite()));
}

#[test]
fn a_clip_that_counts_twice_is_a_clip_that_is_there_twice() {
    let clips = Clips::new();
    let mut weighted = clips.observations();
    weighted[..5].iter_mut().for_each(|clip| clip.weight = 2.0);
    let twice = [clips.observations(), clips.observations()[..5].to_vec()].concat();
    // The unit is that of the clips, which the copies change: these have none.
    let unit = |clips: &[Observation]| -> f64 {
        let squares: f64 = clips.iter().flat_map(|clip| clip.input).map(|x| f64::from(*x).powi(2)).sum();
        (squares / (clips.len() * INPUTS) as f64).sqrt()
    };
    let ratio = (unit(&weighted) / unit(&twice)).powi(2);
    let of_weighted = LogisticRegression::fit(&weighted, CLASSES, 0.1, None);
    let of_twice = LogisticRegression::fit(&twice, CLASSES, 0.1 / ratio, None);
    for clip in &weighted {
        let difference = largest_difference(of_weighted.scores(clip.input), &of_twice.scores(clip.input));
        assert!(difference < 1e-5, "{difference}");
    }
    let known = validation_losses(&clips.observations(), CLASSES).unwrap();
    weighted.iter_mut().for_each(|clip| clip.weight = 2.0);
    let doubled: Vec<f64> = validation_losses(&weighted, CLASSES).unwrap().into();
    assert!(
        doubled.iter().zip(known).any(|(found, known)| (found - known).abs() > 1e-4),
        "a strength is for a sum"
    );
}
