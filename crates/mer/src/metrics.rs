//! Classification metrics: those of the SRFlow paper, per fold, and MEGC 2019's, pooled.

use serde::Serialize;

/// Confusion matrix: number of clips by true and predicted class, `[truth][predicted]`.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Confusion(pub Vec<Vec<usize>>);

/// The paper's five metrics, each in 0..1.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize)]
pub struct Scores {
    /// Precision, macro-averaged: `P_M`.
    #[serde(rename = "p_m")]
    pub precision: f64,
    /// Recall, macro-averaged: `R_M`.
    #[serde(rename = "r_m")]
    pub recall: f64,
    /// F1, macro-averaged: `F1_M`.
    #[serde(rename = "f1_m")]
    pub f1: f64,
    /// Micro-averaged F1, which with one label per clip is the accuracy: `F1_μ`.
    #[serde(rename = "f1_mu")]
    pub accuracy: f64,
    /// Geometric mean of the recalls: `G_M`.
    #[serde(rename = "g_m")]
    pub g_mean: f64,
}

impl Confusion {
    /// An empty matrix for this number of classes.
    pub fn new(classes: usize) -> Self {
        Self(vec![vec![0; classes]; classes])
    }

    /// Counts pairs (truth, predicted) of class numbers below `classes`.
    pub fn of(classes: usize, pairs: impl IntoIterator<Item = (usize, usize)>) -> Self {
        let mut confusion = Self::new(classes);
        for (truth, predicted) in pairs {
            confusion.0[truth][predicted] += 1;
        }
        confusion
    }

    /// Adds the clips of another.
    pub fn add(&mut self, other: &Self) {
        for (row, other) in self.0.iter_mut().zip(&other.0) {
            for (count, other) in row.iter_mut().zip(other) {
                *count += other;
            }
        }
    }

    /// The same clips, all predicted as one class.
    #[must_use]
    pub fn always(&self, class: usize) -> Self {
        let mut confusion = Self::new(self.0.len());
        for (row, truth) in confusion.0.iter_mut().zip(&self.0) {
            row[class] = truth.iter().sum();
        }
        confusion
    }

    pub fn total(&self) -> usize {
        self.0.iter().flatten().sum()
    }

    /// The most frequent class; the first of equal ones.
    pub fn most_frequent(&self) -> usize {
        let classes = 1..self.0.len();
        classes.fold(0, |most, class| if self.of_class(class) > self.of_class(most) { class } else { most })
    }

    /// The paper's metrics of one fold, as scikit-learn and imbalanced-learn compute them: macro averages run over the
    /// classes that the fold's truth or predictions name, and 0/0 is 0. All are 0
    /// without clips.
    pub fn scores(&self) -> Scores {
        let seen: Vec<usize> =
            (0..self.0.len()).filter(|&class| self.of_class(class) + self.predicted(class) > 0).collect();
        let mean = |of: &dyn Fn(usize) -> f64| {
            ratio(seen.iter().map(|&class| of(class)).sum::<f64>(), seen.len() as f64)
        };
        let product: f64 = seen.iter().map(|&class| self.recall(class)).product();
        Scores {
            precision: mean(&|class| self.precision(class)),
            recall: mean(&|class| self.recall(class)),
            f1: mean(&|class| self.f1(class)),
            accuracy: ratio(self.correct() as f64, self.total() as f64),
            g_mean: if seen.is_empty() { 0.0 } else { product.powf(1.0 / seen.len() as f64) },
        }
    }

    /// MEGC 2019's unweighted F1 of pooled predictions: the mean over all classes.
    pub fn uf1(&self) -> f64 {
        ratio((0..self.0.len()).map(|class| self.f1(class)).sum(), self.0.len() as f64)
    }

    /// MEGC 2019's unweighted average recall of pooled predictions: the mean over all classes.
    pub fn uar(&self) -> f64 {
        ratio((0..self.0.len()).map(|class| self.recall(class)).sum(), self.0.len() as f64)
    }

    fn correct(&self) -> usize {
        (0..self.0.len()).map(|class| self.0[class][class]).sum()
    }

    fn of_class(&self, class: usize) -> usize {
        self.0[class].iter().sum()
    }

    fn predicted(&self, class: usize) -> usize {
        self.0.iter().map(|row| row[class]).sum()
    }

    /// Share of the clips predicted as a class that are of it; 0 without any.
    pub(crate) fn precision(&self, class: usize) -> f64 {
        ratio(self.0[class][class] as f64, self.predicted(class) as f64)
    }

    /// Share of the clips of a class that are predicted as it; 0 without any.
    pub(crate) fn recall(&self, class: usize) -> f64 {
        ratio(self.0[class][class] as f64, self.of_class(class) as f64)
    }

    /// Of precision and recall of a class; 0 without clips or predictions.
    pub(crate) fn f1(&self, class: usize) -> f64 {
        ratio(2.0 * self.0[class][class] as f64, (self.of_class(class) + self.predicted(class)) as f64)
    }
}

impl Scores {
    /// The mean over folds; all 0 without folds.
    pub fn mean(folds: &[Scores]) -> Scores {
        let mean = |of: fn(&Scores) -> f64| ratio(folds.iter().map(of).sum::<f64>(), folds.len() as f64);
        Scores {
            precision: mean(|scores| scores.precision),
            recall: mean(|scores| scores.recall),
            f1: mean(|scores| scores.f1),
            accuracy: mean(|scores| scores.accuracy),
            g_mean: mean(|scores| scores.g_mean),
        }
    }

    /// In the order of the paper's columns: `P_M`, `R_M`, `F1_M`, `F1_μ`, `G_M`.
    pub fn values(&self) -> [f64; 5] {
        [self.precision, self.recall, self.f1, self.accuracy, self.g_mean]
    }
}

/// 0 where the divisor is 0.
fn ratio(above: f64, below: f64) -> f64 {
    if below == 0.0 { 0.0 } else { above / below }
}
