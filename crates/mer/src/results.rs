//! Runs as tables: the SRFlow paper's (best three marked), those of a fixed epoch, confusion matrices and folds.

use serde::Serialize;
use srflow_report::{Better, Column, Row, Table, latex_escape};

use crate::loso::{FoldRecord, Loso};
use crate::metrics::{Confusion, Scores};
use crate::predictions::Trial;
use crate::summary::{EpochScores, FoldScores, Summary, SummaryError};

/// Keys and headers of the paper's metrics, in its order.
pub const METRICS: [(&str, &str); 5] =
    [("p_m", "P_M"), ("r_m", "R_M"), ("f1_m", "F1_M"), ("f1_mu", "F1_μ"), ("g_m", "G_M")];

/// One method's leave-one-subject-out run over one set of clips.
#[derive(Debug, Clone)]
pub struct Outcome {
    pub method: String,
    /// A dataset's name, or `composite`.
    pub set: String,
    /// Training of each fold; `None` if only the predictions are known.
    pub folds: Vec<FoldRecord>,
    pub summary: Summary,
}

impl Outcome {
    /// Scores a run.
    ///
    /// # Errors
    /// When its predictions are incomplete.
    pub fn of(method: &str, set: &str, loso: &Loso) -> Result<Self, SummaryError> {
        let summary = Summary::of(&loso.classes, &loso.predictions)?;
        Ok(Self { method: method.to_owned(), set: set.to_owned(), folds: loso.folds.clone(), summary })
    }

    /// Scores predictions without data on their training.
    ///
    /// # Errors
    /// When they are incomplete.
    pub fn of_trial(trial: &Trial) -> Result<Self, SummaryError> {
        let Trial { method, set, classes, predictions } = trial;
        let summary = Summary::of(classes, predictions)?;
        Ok(Self { method: method.clone(), set: set.clone(), folds: Vec::new(), summary })
    }

    /// All numbers, as JSON.
    pub fn record(&self) -> OutcomeRecord {
        let metric = |((key, _), best): (&(&'static str, &str), crate::summary::Best)| BestRecord {
            metric: key,
            value: best.value,
            epoch: best.epoch,
        };
        OutcomeRecord {
            method: self.method.clone(),
            set: self.set.clone(),
            best: METRICS.iter().zip(self.summary.best()).map(metric).collect(),
            last: EpochRecord::of(self.summary.last()),
            epochs: self.summary.epochs.iter().map(EpochRecord::of).collect(),
            baseline: BaselineRecord {
                always: self.summary.classes[self.summary.most_frequent_class()].clone(),
                scores: EpochRecord::of(&self.summary.baseline()),
            },
            folds: self.folds.clone(),
        }
    }
}

/// The stored form of [`Outcome`].
#[derive(Debug, Clone, Serialize)]
pub struct OutcomeRecord {
    method: String,
    set: String,
    best: Vec<BestRecord>,
    last: EpochRecord,
    epochs: Vec<EpochRecord>,
    baseline: BaselineRecord,
    #[serde(skip_serializing_if = "Vec::is_empty")]
    folds: Vec<FoldRecord>,
}

/// The baseline that always predicts one class.
#[derive(Debug, Clone, Serialize)]
struct BaselineRecord {
    always: String,
    #[serde(flatten)]
    scores: EpochRecord,
}

#[derive(Debug, Clone, Serialize)]
struct BestRecord {
    metric: &'static str,
    value: f64,
    epoch: usize,
}

#[derive(Debug, Clone, Serialize)]
struct EpochRecord {
    epoch: usize,
    #[serde(flatten)]
    mean: Scores,
    uf1: f64,
    uar: f64,
    /// `[truth][predicted]`.
    confusion: Vec<Vec<usize>>,
}

impl EpochRecord {
    fn of(EpochScores { epoch, mean, pooled }: &EpochScores) -> Self {
        let (uf1, uar) = (pooled.uf1(), pooled.uar());
        Self { epoch: *epoch, mean: *mean, uf1, uar, confusion: pooled.0.clone() }
    }
}

/// Groups outcomes by set; sets and outcomes are in order of first appearance.
pub fn by_set(outcomes: &[Outcome]) -> Vec<Vec<&Outcome>> {
    let mut sets: Vec<Vec<&Outcome>> = Vec::new();
    for outcome in outcomes {
        match sets.iter_mut().find(|set| set[0].set == outcome.set) {
            Some(set) => set.push(outcome),
            None => sets.push(vec![outcome]),
        }
    }
    sets
}

/// Two tables of the outcomes of one set: the paper's, in which each metric takes its own best epoch, and one after each
/// method's last epoch, with MEGC 2019's metrics. Where methods were trained for different numbers of epochs, the second has
/// a column for them. Both have an unranked row for always predicting the most frequent class. `outcomes` are of one set and not empty.
pub fn score_tables(outcomes: &[&Outcome], left_out: &[String]) -> Vec<Table> {
    let Some(first) = outcomes.first() else { return Vec::new() };
    let ranked = |&(key, header): &(&str, &str)| Column::ranked(key, header, Better::Higher);
    let row =
        |name: &str, values: Vec<Option<f64>>, baseline| Row { name: name.to_owned(), values, baseline };
    let paper: Vec<Column> = METRICS.iter().map(ranked).collect();
    let pooled = [("uf1", "UF1"), ("uar", "UAR")];
    let mut all: Vec<Column> = METRICS.iter().chain(&pooled).map(ranked).collect();
    let at_epoch = |scores: &EpochScores| {
        let pooled = [scores.pooled.uf1(), scores.pooled.uar()];
        scores.mean.values().into_iter().chain(pooled).map(Some).collect::<Vec<_>>()
    };
    let baseline = first.summary.baseline();
    let mut best: Vec<Row> = outcomes
        .iter()
        .map(|o| row(&o.method, o.summary.best().map(|best| Some(best.value)).to_vec(), false))
        .collect();
    best.push(row(&baseline_name(first), baseline.mean.values().map(Some).to_vec(), true));
    let mut last: Vec<Row> =
        outcomes.iter().map(|o| row(&o.method, at_epoch(o.summary.last()), false)).collect();
    last.push(row(&baseline_name(first), at_epoch(&baseline), true));

    let epoch = first.summary.last().epoch;
    let after = if outcomes.iter().all(|outcome| outcome.summary.last().epoch == epoch) {
        format!("after epoch {epoch}")
    } else {
        all.insert(0, Column::plain("epoch", "epoch", 0));
        let epochs = outcomes.iter().map(|outcome| Some(outcome.summary.last().epoch as f64));
        for (row, epoch) in last.iter_mut().zip(epochs.chain([None])) {
            row.values.insert(0, epoch);
        }
        "after each method's last epoch".to_owned()
    };
    let counted = format!(
        "{}: {} clips, {} subjects",
        first.set,
        first.summary.last().pooled.total(),
        first.summary.folds.len()
    );
    let table = |title, columns, rows| Table { title, columns, rows, notes: left_out.to_vec() };
    vec![
        table(format!("{counted}; each metric at its best epoch"), paper, best),
        table(format!("{counted}; {after}, fixed beforehand"), all, last),
    ]
}

/// Name of the row of the baseline, e.g. `always negative`.
pub(crate) fn baseline_name(outcome: &Outcome) -> String {
    format!("always {}", outcome.summary.classes[outcome.summary.most_frequent_class()])
}

/// Notes on classes that cannot be learned: those without clips in the set, and for each subject those that nobody else has.
/// `None` if there are none, or the training is not known.
pub fn unseen_classes(outcome: &Outcome) -> Option<String> {
    let Confusion(counts) = &outcome.summary.last().pooled;
    let classes = outcome.summary.classes.iter().zip(counts);
    let absent: Vec<&str> = classes
        .filter(|(_, clips)| clips.iter().sum::<usize>() == 0)
        .map(|(class, _)| class.as_str())
        .collect();
    let alone = |fold: &FoldRecord| {
        let classes: Vec<&str> =
            fold.unseen_classes.iter().map(String::as_str).filter(|class| !absent.contains(class)).collect();
        (!classes.is_empty()).then(|| format!("{} {} ({})", fold.dataset, fold.subject, classes.join(", ")))
    };
    let alone: Vec<String> = outcome.folds.iter().filter_map(alone).collect();
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

/// The title of an outcome's confusion matrix, e.g. `samm, tvl1: confusion matrix after epoch 200`.
pub fn confusion_title(outcome: &Outcome) -> String {
    let Outcome { set, method, summary, .. } = outcome;
    format!("{set}, {method}: confusion matrix after epoch {}", summary.last().epoch)
}

/// The confusion matrix after the last epoch, all folds pooled, as a LaTeX `tabular`: a row for each true class, a column for
/// each predicted one, clips in the cells, shaded by their share of the row.
pub fn confusion_latex(outcome: &Outcome) -> String {
    let names: Vec<String> = outcome.summary.classes.iter().map(|class| latex_escape(class)).collect();
    let mut out = format!("\\begin{{tabular}}{{l*{{{}}}r}}\n\\toprule\n", names.len());
    out += &format!("true\\textbackslash predicted & {} \\\\\n\\midrule\n", names.join(" & "));
    for (name, counts) in names.iter().zip(&outcome.summary.last().pooled.0) {
        let clips = counts.iter().sum::<usize>().max(1);
        let cell = |count: &usize| format!(" & \\cellcolor{{blue!{}}}{count}", 60 * count / clips);
        out += &format!("{name}{} \\\\\n", counts.iter().map(cell).collect::<String>());
    }
    out + "\\bottomrule\n\\end{tabular}\n"
}

/// Each subject's scores after the last epoch, one row per fold, with the training loss if known.
pub fn fold_table(outcome: &Outcome) -> Table {
    let mut columns = vec![Column::plain("clips", "clips", 0)];
    columns.extend(METRICS.iter().map(|(key, header)| Column::plain(key, header, 4)));
    let row = |fold: &FoldScores| {
        let last = &fold.confusions[fold.confusions.len() - 1];
        let mut values = vec![Some(last.total() as f64)];
        values.extend(last.scores().values().map(Some));
        Row { name: format!("{} {}", fold.dataset, fold.subject), values, baseline: false }
    };
    let mut rows: Vec<Row> = outcome.summary.folds.iter().map(row).collect();
    if !outcome.folds.is_empty() {
        columns.push(Column::plain("training_loss", "training loss", 4));
        for (row, fold) in rows.iter_mut().zip(&outcome.folds) {
            row.values.push(fold.training_losses.last().copied());
        }
    }
    Table {
        title: format!(
            "{}, {}: subjects after epoch {}",
            outcome.set,
            outcome.method,
            outcome.summary.last().epoch
        ),
        columns,
        rows,
        ..Table::default()
    }
}
