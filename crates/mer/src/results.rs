//! Runs as tables: scores after the last epoch and their intervals, the paper's at the best epochs, confusion matrices, folds.

use srflow_report::{Better, Column, Row, Table, latex_escape};

use crate::comparison::{comparisons, marked};
use crate::loso::FoldRecord;
use crate::metrics::Confusion;
use crate::outcome::{MEASURE_KEYS, METRICS, Outcome};
use crate::statistics::MEASURES;
use crate::summary::{EpochScores, FoldScores, mean_scores};

/// Columns of [`MEASURE_KEYS`] that tables give intervals for.
const WITH_INTERVALS: [usize; 3] = [3, 5, 6];

/// Tables of the outcomes of one set: scores after each method's last epoch, with a column for it where methods differ; bounds
/// of three of them; where a run has several seeds, how much they differ; and where predictions of several epochs were recorded, the paper's, in which each metric takes its own best
/// epoch. The first has an unranked row for always predicting the most frequent class, and marks what `comparisons` found best.
/// `outcomes` are of one set.
pub fn score_tables(outcomes: &[&Outcome], left_out: &[String]) -> Vec<Table> {
    let Some(first) = outcomes.first() else { return Vec::new() };
    let row =
        |name: &str, values: Vec<Option<f64>>, baseline| Row { name: name.to_owned(), values, baseline };
    let counted =
        format!("{}: {} clips, {} subjects", first.set, first.summary.clips(), first.summary.folds.len());
    let mut tables = vec![last_table(outcomes, first, &counted)];
    let bounds = |outcome: &&Outcome| {
        let intervals = outcome.last_scores().intervals();
        let of = |measure: usize| [intervals[measure].low, intervals[measure].high].map(Some);
        row(&outcome.method, WITH_INTERVALS.into_iter().flat_map(of).collect(), false)
    };
    let bound = |measure: usize| {
        let (key, header) = MEASURE_KEYS[measure];
        [("low", "from"), ("high", "to")]
            .map(|(end, word)| Column::plain(&format!("{key}_{end}"), &format!("{header} {word}"), 4))
    };
    tables.push(Table {
        title: format!("{counted}; 95 % intervals over subjects"),
        columns: WITH_INTERVALS.into_iter().flat_map(bound).collect(),
        rows: outcomes.iter().map(bounds).collect(),
        ..Table::default()
    });
    tables.extend(seeds_table(outcomes, &counted));
    if outcomes.iter().any(|outcome| outcome.summary.epochs.len() > 1) {
        let best =
            |o: &&Outcome| row(&o.method, o.summary.best().map(|best| Some(best.value)).to_vec(), false);
        tables.push(Table {
            title: format!("{counted}; each metric at its best epoch, chosen on the test clips themselves"),
            columns: METRICS.iter().map(|(key, header)| Column::plain(key, header, 4)).collect(),
            rows: outcomes.iter().map(best).collect(),
            ..Table::default()
        });
    }
    tables[0].notes = left_out.to_vec();
    tables
}

/// How much scores differ between seeds; `None` where there is one of each method.
fn seeds_table(outcomes: &[&Outcome], counted: &str) -> Option<Table> {
    let row = |outcome: &&Outcome| {
        let by_seed: Vec<[f64; MEASURES]> =
            outcome.scores_by_seed().into_iter().map(|(_, scores)| scores).collect();
        let deviation = |measure: usize| {
            let values = by_seed.iter().map(|scores| scores[measure]);
            let count = values.len() as f64;
            let mean = values.clone().sum::<f64>() / count;
            (values.map(|value| (value - mean).powi(2)).sum::<f64>() / (count - 1.0)).sqrt()
        };
        let values = (0..MEASURES).map(|measure| (by_seed.len() > 1).then(|| deviation(measure)));
        Row { name: outcome.method.clone(), values: values.collect(), baseline: false }
    };
    let seeds =
        outcomes.iter().map(|outcome| outcome.summary.seeds.len()).max().filter(|seeds| *seeds > 1)?;
    Some(Table {
        title: format!("{counted}; standard deviation between {seeds} seeds, whose means are above"),
        columns: MEASURE_KEYS.iter().map(|(key, header)| Column::plain(key, header, 4)).collect(),
        rows: outcomes.iter().map(row).collect(),
        ..Table::default()
    })
}

fn last_table(outcomes: &[&Outcome], first: &Outcome, counted: &str) -> Table {
    let mut columns: Vec<Column> =
        MEASURE_KEYS.iter().map(|(key, header)| Column::ranked(key, header, Better::Higher)).collect();
    let row = |name: &str, scores: &EpochScores, baseline| {
        let pooled = [scores.uf1(), scores.uar()];
        let values = scores.mean.values().into_iter().chain(pooled).map(Some).collect();
        Row { name: name.to_owned(), values, baseline }
    };
    let mut rows: Vec<Row> = outcomes.iter().map(|o| row(&o.method, o.summary.last(), false)).collect();
    rows.push(row(&baseline_name(first), &first.summary.baseline(), true));
    let marked = marked(outcomes, &comparisons(outcomes));
    let mut tested: Vec<Vec<bool>> = marked.into_iter().map(|row| row.to_vec()).collect();
    let epoch = first.summary.last().epoch;
    let same = outcomes.iter().all(|outcome| outcome.summary.last().epoch == epoch);
    let after = match (same, outcomes.iter().any(|outcome| outcome.summary.epochs.len() > 1)) {
        (true, false) => String::new(),
        (true, true) => format!("; after epoch {epoch}, fixed beforehand"),
        (false, _) => {
            columns.insert(0, Column::plain("epoch", "epoch", 0));
            let epochs = outcomes.iter().map(|outcome| Some(outcome.summary.last().epoch as f64));
            for (row, epoch) in rows.iter_mut().zip(epochs.chain([None])) {
                row.values.insert(0, epoch);
            }
            tested.iter_mut().for_each(|row| row.insert(0, false));
            "; after each method's last epoch, fixed beforehand".to_owned()
        }
    };
    Table { title: format!("{counted}{after}"), columns, rows, tested: Some(tested), ..Table::default() }
}

/// Name of the row of the baseline, e.g. `always negative`.
pub(crate) fn baseline_name(outcome: &Outcome) -> String {
    format!("always {}", outcome.summary.classes[outcome.summary.most_frequent_class()])
}

/// Notes on classes that cannot be learned: those without clips in the set, and for each subject those that nobody else has.
/// `None` if there are none, or the training is not known.
pub fn unseen_classes(outcome: &Outcome) -> Option<String> {
    let Confusion(counts) = outcome.summary.last().counts();
    let classes = outcome.summary.classes.iter().zip(&counts);
    let absent: Vec<&str> = classes
        .filter(|(_, clips)| clips.iter().sum::<usize>() == 0)
        .map(|(class, _)| class.as_str())
        .collect();
    let alone = |fold: &FoldRecord| {
        let classes: Vec<&str> =
            fold.unseen_classes.iter().map(String::as_str).filter(|class| !absent.contains(class)).collect();
        (!classes.is_empty()).then(|| format!("{} ({})", fold.name(), classes.join(", ")))
    };
    // Folds of all seeds lack the same classes.
    let mut alone: Vec<String> = outcome.folds.iter().filter_map(alone).collect();
    alone.dedup();
    let mut notes = Vec::new();
    if !absent.is_empty() {
        notes.push(format!("{}: no clip shows {}.", outcome.set, absent.join(" or ")));
    }
    if !alone.is_empty() {
        notes.push(format!(
            "{}: without these subjects no example of a class is left to learn from: {}.",
            outcome.set,
            alone.join("; ")
        ));
    }
    (!notes.is_empty()).then(|| notes.join(" "))
}

/// `confusion matrix after epoch 200, clips of 5 seeds`.
pub(crate) fn confusion_name(outcome: &Outcome) -> String {
    let seeds = match outcome.summary.seeds.len() {
        1 => String::new(),
        seeds => format!(", clips of {seeds} seeds"),
    };
    format!("confusion matrix{}{seeds}", outcome.summary.after_last())
}

/// The title of an outcome's confusion matrix, e.g. `samm, tvl1: confusion matrix after epoch 200`.
pub fn confusion_title(outcome: &Outcome) -> String {
    format!("{}, {}: {}", outcome.set, outcome.method, confusion_name(outcome))
}

/// The confusion matrix after the last epoch, all folds pooled, as a LaTeX `tabular`: a row for each true class, a column for
/// each predicted one, clips in the cells, shaded by their share of the row.
pub fn confusion_latex(outcome: &Outcome) -> String {
    let names: Vec<String> = outcome.summary.classes.iter().map(|class| latex_escape(class)).collect();
    let mut out = format!("\\begin{{tabular}}{{l*{{{}}}r}}\n\\toprule\n", names.len());
    out += &format!("true\\textbackslash predicted & {} \\\\\n\\midrule\n", names.join(" & "));
    for (name, counts) in names.iter().zip(&outcome.summary.last().counts().0) {
        let clips = counts.iter().sum::<usize>().max(1);
        let cell = |count: &usize| format!(" & \\cellcolor{{blue!{}}}{count}", 60 * count / clips);
        out += &format!("{name}{} \\\\\n", counts.iter().map(cell).collect::<String>());
    }
    out + "\\bottomrule\n\\end{tabular}\n"
}

/// Each subject's scores after the last epoch, one row per subject, with the training loss if known.
pub fn fold_table(outcome: &Outcome) -> Table {
    let mut columns = vec![Column::plain("clips", "clips", 0)];
    columns.extend(METRICS.iter().map(|(key, header)| Column::plain(key, header, 4)));
    let row = |fold: &FoldScores| {
        let mut values = vec![Some(fold.clips() as f64)];
        values.extend(mean_scores(fold.last()).values().map(Some));
        if !outcome.folds.is_empty() {
            values.push(outcome.training_loss(fold));
        }
        Row { name: format!("{} {}", fold.dataset, fold.subject), values, baseline: false }
    };
    let rows: Vec<Row> = outcome.summary.folds.iter().map(row).collect();
    if !outcome.folds.is_empty() {
        columns.push(Column::plain("training_loss", "training loss", 4));
    }
    Table {
        title: format!("{}, {}: subjects{}", outcome.set, outcome.method, outcome.summary.after_last()),
        columns,
        rows,
        ..Table::default()
    }
}
