//! The file of predictions.

use std::sync::Arc;

use srflow_mer::{Prediction, Trial, read_predictions, write_predictions};

#[test]
fn the_first_of_equal_scores_wins() {
    assert_eq!(Prediction::class_of(&[0.5, 0.5, 0.1]), 0);
    assert_eq!(Prediction::class_of(&[0.5, 0.75, 0.75]), 1);
    assert_eq!(Prediction::class_of(&[-2.0, -1.0, -0.5, -0.25]), 3);
}

fn names(classes: usize) -> Arc<[String]> {
    ["negative", "positive", "surprise", "a, b"].map(str::to_owned).into_iter().take(classes).collect()
}

fn trial() -> Trial {
    let prediction = |clip: &str, scores: [f32; 3]| Prediction {
        dataset: "samm".into(),
        subject: "006".into(),
        clip: clip.into(),
        truth: 1,
        seed: 0,
        epoch: 20,
        predicted: Prediction::class_of(&scores),
        scores: scores.to_vec(),
    };
    let predictions = vec![prediction("a, \"b\"", [0.1, -1e-30, 3.402_823_5e38]), prediction("c", [1.0; 3])];
    Trial { method: "tvl1".into(), set: "composite".into(), classes: names(3), predictions }
}

#[test]
fn a_file_gives_back_every_bit() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("predictions.csv");
    let first = Trial { method: "zero".into(), ..trial() };
    write_predictions(&path, &[first.clone(), trial()]).unwrap();
    assert_eq!(read_predictions(&path).unwrap(), [first, trial()], "in the file's order");
    let mut four = Trial { classes: names(4), ..trial() };
    four.predictions.iter_mut().for_each(|prediction| prediction.scores.push(-7.5));
    write_predictions(&path, std::slice::from_ref(&four)).unwrap();
    assert_eq!(read_predictions(&path).unwrap(), [four]);
}

#[test]
fn other_files_are_refused_with_the_line() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("predictions.csv");
    write_predictions(&path, &[trial()]).unwrap();
    let text = std::fs::read_to_string(&path).unwrap();
    std::fs::write(&path, text.replace("c,positive", "c,happy")).unwrap();
    let error = read_predictions(&path).unwrap_err().to_string();
    assert!(error.contains("line 3") && error.contains("happy"), "{error}");
    std::fs::write(&path, text.replace("c,positive,20,negative", "c,positive,20,surprise")).unwrap();
    let error = read_predictions(&path).unwrap_err().to_string();
    assert!(error.contains("line 3: predicted is surprise, but") && error.contains("negative"), "{error}");
    std::fs::write(&path, text.replace("c,positive,20", "c,positive,twenty")).unwrap();
    let error = read_predictions(&path).unwrap_err().to_string();
    assert!(error.contains("line 3: epoch: expected a whole number"), "{error}");
    std::fs::write(&path, text.replace("truth", "class").replace("epoch", "step")).unwrap();
    let error = read_predictions(&path).unwrap_err().to_string();
    assert!(error.contains("no column truth, epoch;"), "{error}");
    for nothing in ["", text.lines().next().unwrap()] {
        std::fs::write(&path, nothing).unwrap();
        let error = read_predictions(&path).unwrap_err().to_string();
        assert!(error.contains("holds no predictions"), "{error}");
    }
    assert!(read_predictions(&folder.path().join("no.csv")).is_err());
}
