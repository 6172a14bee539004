//! Logistic regression against scikit-learn's; `tools/parity/mer_linear.py` repeats the rules for inputs and wrote the golden values.

use srflow_mer::{INVERSE_STRENGTHS, LogisticRegression, validation_losses};
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

    fn inputs(&self) -> Vec<&[f32]> {
        self.inputs.iter().map(Vec::as_slice).collect()
    }
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
        let inputs = clips.inputs();
        let model =
            LogisticRegression::fit(&inputs[..TRAINING], &clips.labels[..TRAINING], CLASSES, strength, None);
        let found = inputs.iter().flat_map(|input| {
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
    let losses = validation_losses(&clips.inputs(), &clips.labels, &clips.subjects, CLASSES).unwrap();
    let difference = largest_difference(losses.map(|loss| loss as f32), golden.values("losses"));
    assert!(difference < 1e-5, "{difference}");
    assert_eq!(validation_losses(&clips.inputs(), &clips.labels, &[0; CLIPS], CLASSES), None, "one subject");
}

#[test]
fn the_unit_of_the_flow_does_not_matter() {
    let clips = Clips::new();
    let fit = |inputs: &[&[f32]]| LogisticRegression::fit(inputs, &clips.labels, CLASSES, 0.1, None);
    let scaled: Vec<Vec<f32>> =
        clips.inputs.iter().map(|input| input.iter().map(|value| 0.125 * value).collect()).collect();
    let scaled: Vec<&[f32]> = scaled.iter().map(Vec::as_slice).collect();
    let (model, of_scaled) = (fit(&clips.inputs()), fit(&scaled));
    for (input, scaled) in clips.inputs.iter().zip(scaled) {
        assert_eq!(model.scores(input), of_scaled.scores(scaled));
    }
}

#[test]
fn a_class_without_clips_gets_the_least_scores() {
    let inputs: [&[f32]; 4] = [&[1.0, 0.0], &[0.9, 0.1], &[0.0, 1.0], &[0.1, 0.8]];
    let model = LogisticRegression::fit(&inputs, &[0, 0, 2, 2], 3, 1.0, None);
    for (input, class) in inputs.into_iter().zip([0, 0, 2, 2]) {
        let scores = model.scores(input);
        assert!(scores.iter().all(|score| score.is_finite() && *score <= scores[class]), "{scores:?}");
        assert!(scores[1] < scores[0].min(scores[2]), "{scores:?}");
    }
    let still = LogisticRegression::fit(&[&[0.0, 0.0], &[0.0, 0.0]], &[1, 1], 2, 1.0, None);
    assert!(still.scores(&[0.0, 0.0]).iter().all(|score| score.is_finite()));
}
