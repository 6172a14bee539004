//! Scores of the published annotations that need no network: what it takes to always say "negative".

use std::path::Path;

use srflow_data::micro_expression::Classes;
use srflow_mer::{Prediction, Summary};

/// Always negative over the real clips: dataset, clips, folds and the means over folds (`P_M`, `R_M`, `F1_M`, `F1_μ`,
/// `G_M`). SAMM's are the row of SSA in the SRFlow paper's table of SAMM.
const ALWAYS_NEGATIVE: [(&str, usize, usize, [&str; 5]); 4] = [
    ("samm", 133, 28, ["0.5814", "0.6786", "0.6124", "0.7429", "0.4286"]),
    ("casme2", 145, 24, ["0.4375", "0.5417", "0.4705", "0.6195", "0.2917"]),
    ("smic", 157, 16, ["0.1249", "0.2708", "0.1676", "0.3128", "0.0000"]),
    ("composite", 435, 68, ["0.4232", "0.5343", "0.4577", "0.5981", "0.2794"]),
];

/// The published list of all three datasets, each clip taken for negative.
fn predictions(path: &Path) -> Vec<Prediction> {
    let mut reader = csv::Reader::from_path(path).unwrap();
    let line = |line: Result<csv::StringRecord, csv::Error>| {
        let line = line.unwrap();
        let (dataset, subject, clip) = (&line[0], &line[1], &line[2]);
        // The list calls it negative, its name says surprise.
        let label = if clip == "s18_sur_03" { 2 } else { line[3].parse::<usize>().unwrap() };
        Prediction {
            dataset: dataset.to_owned(),
            subject: subject.to_owned(),
            clip: clip.to_owned(),
            truth: label,
            seed: 0,
            epoch: 0,
            predicted: 0,
            scores: vec![1.0, 0.0, 0.0],
        }
    };
    reader.records().map(line).collect()
}

#[test]
fn always_saying_negative_scores_as_in_the_paper() {
    let path = Path::new("../../../shared/data/me-annotations/data_apex.csv");
    if !path.exists() {
        eprintln!("skipped: shared-data: no annotations at {}", path.display());
        return;
    }
    let all = predictions(path);
    for (dataset, clips, folds, expected) in ALWAYS_NEGATIVE {
        let of_set = |prediction: &&Prediction| dataset == "composite" || prediction.dataset == dataset;
        let predictions: Vec<Prediction> = all.iter().filter(of_set).cloned().collect();
        let summary = Summary::of(Classes::default().names(), &predictions).unwrap();
        assert_eq!((predictions.len(), summary.folds.len()), (clips, folds), "{dataset}");
        assert_eq!(summary.best().map(|best| format!("{:.4}", best.value)), expected, "{dataset}");
        assert_eq!(summary.baseline().mean, summary.last().mean, "{dataset}");
    }
}
