//! Tables of results.

use srflow_mer::{
    FoldRecord, Loso, Outcome, comparisons_csv, confusion_latex, confusions_csv, fold_table, folds_csv,
    score_tables, scores_csv, unseen_classes,
};

use crate::made_up::{NEGATIVE, POSITIVE, SURPRISE, prediction};

fn outcome(method: &str, said: usize) -> Outcome {
    let mut predictions = Vec::new();
    for epoch in [0, 20] {
        let said = if epoch == 0 { NEGATIVE } else { said };
        predictions.push(prediction("1", "a", epoch, [NEGATIVE, said]));
        predictions.push(prediction("2", "b", epoch, [POSITIVE, said]));
        predictions.push(prediction("2", "c", epoch, [POSITIVE, said]));
    }
    let fold = |subject: &str, clips| FoldRecord {
        dataset: "made-up".into(),
        subject: Some(subject.into()),
        seed: 0,
        clips,
        unseen_classes: Vec::new(),
        training_losses: vec![1.0, 0.5],
        seconds: 1.0,
        resumed: false,
    };
    let classes = ["negative", "positive", "surprise"].map(str::to_owned).into();
    let loso = Loso { classes, predictions, folds: vec![fold("1", 1), fold("2", 2)] };
    Outcome::of(method, "made-up", &loso).unwrap()
}

#[test]
fn tables_hold_each_metric_at_the_last_and_at_its_best_epoch() {
    let (a, b) = (outcome("a", POSITIVE), outcome("b", SURPRISE));
    let tables = score_tables(&[&a, &b], &[]);
    let accuracy = |table: usize| tables[table].rows.iter().map(|row| row.values[3]).collect::<Vec<_>>();
    assert_eq!(accuracy(0), [Some(0.5), Some(0.0), Some(0.5)]);
    assert!(tables[0].rows[2].baseline && tables[0].title.contains("3 clips, 2 subjects; after epoch 20"));
    // Two of the three clips are positive and predicted so: recalls 0, 1 and none.
    assert_eq!(tables[0].rows[0].values[6], Some(1.0 / 3.0));
    assert!(
        tables[0].legend().is_empty(),
        "two subjects decide nothing, and `a` is no better than always positive"
    );
    // Of F1_μ: one subject is wrong and one right.
    assert_eq!(tables[1].rows[0].values[..2], [Some(0.0), Some(1.0)]);
    assert_eq!(accuracy(2), [Some(0.5), Some(0.5)]);
    assert!(tables[2].title.contains("best epoch, chosen on the test clips") && !tables[2].ranked());
    let latex = confusion_latex(&a);
    let shaded = "positive & \\cellcolor{blue!0}0 & \\cellcolor{blue!60}2 & \\cellcolor{blue!0}0 \\\\\n";
    assert!(latex.contains(shaded), "{latex}");
    assert_eq!(fold_table(&b).rows[1].values[..2], [Some(2.0), Some(0.0)]);
    assert_eq!(fold_table(&b).rows[1].values.last(), Some(&Some(0.5)));
    let both = [a.clone(), b];
    let scores = scores_csv(&both);
    let lines: Vec<&str> = scores.lines().collect();
    assert_eq!(lines.len(), 1 + 2 * 2 + 1, "{scores}");
    assert!(
        lines[1].starts_with("made-up,a,last,20,") && lines[2].starts_with("made-up,a,best,,"),
        "{scores}"
    );
    assert!(lines[5].starts_with("made-up,always positive,last,,"), "{scores}");
    assert_eq!(confusions_csv(&both).lines().nth(2), Some("made-up,a,20,positive,0,2,0"));
    assert_eq!(folds_csv(&both).lines().nth(2), Some("made-up,a,made-up,2,2,20,1.0,1.0,1.0,1.0,1.0,0.5"));
    let comparisons = comparisons_csv(&both);
    assert_eq!(comparisons.lines().count(), 1 + 7);
    assert!(comparisons.contains("\nmade-up,a,b,f1_mu,0.5,1.0\n"), "{comparisons}");
    let mut alone = a.clone();
    assert_eq!(unseen_classes(&a).as_deref(), Some("made-up: no clip shows surprise."));
    alone.folds[1].unseen_classes = vec!["positive".to_owned(), "surprise".to_owned()];
    let note = unseen_classes(&alone).unwrap();
    assert!(note.ends_with("left to learn from: made-up 2 (positive)."), "{note}");
    let json = serde_json::to_value(a.record()).unwrap();
    assert_eq!(json["best"][3]["metric"], "f1_mu");
    assert_eq!(json["last"]["confusion"][1], serde_json::json!([0, 2, 0]));
}

#[test]
fn several_seeds_have_one_row_and_a_table_of_their_spread() {
    let mut several = outcome("a", POSITIVE);
    let of_second = several.folds.iter().cloned().map(|fold| FoldRecord { seed: 1, ..fold });
    several.folds = several.folds.iter().cloned().chain(of_second).collect();
    several.folds[3].training_losses[1] = 1.5;
    let predictions = |seed: u64, said| {
        [("1", "a", NEGATIVE), ("2", "b", POSITIVE), ("2", "c", POSITIVE)].map(|(subject, clip, truth)| {
            srflow_mer::Prediction { seed, ..prediction(subject, clip, 0, [truth, said]) }
        })
    };
    let both: Vec<_> = predictions(0, POSITIVE).into_iter().chain(predictions(1, SURPRISE)).collect();
    several.summary = srflow_mer::Summary::of(&several.summary.classes, &both).unwrap();
    let tables = score_tables(&[&several], &[]);
    // 0.5 with one seed, 0 with the other.
    assert_eq!((tables[0].rows[0].values[3], tables[0].rows.len()), (Some(0.25), 2));
    assert!(tables[2].title.contains("standard deviation between 2 seeds"), "{}", tables[2].title);
    assert_eq!(tables[2].rows[0].values[3], Some(0.125_f64.sqrt()));
    let folds = fold_table(&several);
    assert_eq!(folds.rows[1].values[..2], [Some(2.0), Some(0.5)]);
    assert_eq!(folds.rows[1].values.last(), Some(&Some(1.0)));
    let scores = scores_csv(std::slice::from_ref(&several));
    assert!(scores.contains("\nmade-up,a,seed 0,0,") && scores.contains("\nmade-up,a,seed 1,0,"), "{scores}");
    let json = serde_json::to_value(several.record()).unwrap();
    assert_eq!((&json["seeds"][1]["seed"], &json["seeds"][1]["f1_mu"]), (&1.into(), &0.0.into()));
    assert_eq!(json["last"]["confusion"][1], serde_json::json!([0, 2, 2]));
}

#[test]
fn methods_of_different_runs_have_their_own_last_epochs() {
    let (long, mut short) = (outcome("long", POSITIVE), outcome("short", POSITIVE));
    short.summary.epochs.truncate(1);
    let table = &score_tables(&[&long, &short], &[])[0];
    assert!(table.title.contains("after each method's last epoch"), "{}", table.title);
    let epochs: Vec<Option<f64>> = table.rows.iter().map(|row| row.values[0]).collect();
    assert_eq!((table.columns[0].header.as_str(), epochs), ("epoch", vec![Some(20.0), Some(0.0), None]));
    assert_eq!(table.columns.len(), table.rows[0].values.len());
}
