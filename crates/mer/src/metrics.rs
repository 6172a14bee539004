//! Scores of classification: those of the SRFlow paper, per fold, and MEGC 2019's, pooled.

use srflow_read::micro_expression::EmotionClass;

/// Number of classes.
pub const CLASSES: usize = EmotionClass::ALL.len();

/// How often each class was told for each: `[truth][predicted]`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Confusion(pub [[usize; CLASSES]; CLASSES]);

/// The paper's five metrics, each in 0..1.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Scores {
    /// Precision, macro-averaged: `P_M`.
    pub precision: f64,
    /// Recall, macro-averaged: `R_M`.
    pub recall: f64,
    /// F1, macro-averaged: `F1_M`.
    pub f1: f64,
    /// Micro-averaged F1, which with one label per clip is the share of clips told right: `F1_μ`.
    pub accuracy: f64,
    /// Geometric mean of the recalls: `G_M`.
    pub g_mean: f64,
}

impl Confusion {
    /// Counts (truth, predicted).
    pub fn of(pairs: impl IntoIterator<Item = (EmotionClass, EmotionClass)>) -> Self {
        let mut confusion = Self::default();
        for (truth, predicted) in pairs {
            confusion.0[truth as usize][predicted as usize] += 1;
        }
        confusion
    }

    /// Both counts together.
    pub fn plus(mut self, other: &Self) -> Self {
        for (row, other) in self.0.iter_mut().zip(&other.0) {
            for (count, other) in row.iter_mut().zip(other) {
                *count += other;
            }
        }
        self
    }

    /// Clips counted.
    pub fn total(&self) -> usize {
        self.0.as_flattened().iter().sum()
    }

    /// The paper's metrics of one fold, as scikit-learn and imbalanced-learn compute them: macro averages run over the
    /// classes that the fold's truth or predictions name, and a quotient with nothing below the bar is 0. All are 0
    /// without clips.
    pub fn scores(&self) -> Scores {
        let seen: Vec<usize> =
            (0..CLASSES).filter(|&class| self.of_class(class) + self.told(class) > 0).collect();
        let mean = |of: &dyn Fn(usize) -> f64| {
            ratio(seen.iter().map(|&class| of(class)).sum::<f64>(), seen.len() as f64)
        };
        let product: f64 = seen.iter().map(|&class| self.recall(class)).product();
        Scores {
            precision: mean(&|class| ratio(self.0[class][class] as f64, self.told(class) as f64)),
            recall: mean(&|class| self.recall(class)),
            f1: mean(&|class| self.f1(class)),
            accuracy: ratio(self.right() as f64, self.total() as f64),
            g_mean: if seen.is_empty() { 0.0 } else { product.powf(1.0 / seen.len() as f64) },
        }
    }

    /// MEGC 2019's unweighted F1 of pooled predictions: the mean over the three classes.
    pub fn uf1(&self) -> f64 {
        (0..CLASSES).map(|class| self.f1(class)).sum::<f64>() / CLASSES as f64
    }

    /// MEGC 2019's unweighted average recall of pooled predictions: the mean over the three classes.
    pub fn uar(&self) -> f64 {
        (0..CLASSES).map(|class| self.recall(class)).sum::<f64>() / CLASSES as f64
    }

    fn right(&self) -> usize {
        (0..CLASSES).map(|class| self.0[class][class]).sum()
    }

    fn of_class(&self, class: usize) -> usize {
        self.0[class].iter().sum()
    }

    fn told(&self, class: usize) -> usize {
        self.0.iter().map(|row| row[class]).sum()
    }

    fn recall(&self, class: usize) -> f64 {
        ratio(self.0[class][class] as f64, self.of_class(class) as f64)
    }

    fn f1(&self, class: usize) -> f64 {
        ratio(2.0 * self.0[class][class] as f64, (self.of_class(class) + self.told(class)) as f64)
    }
}

impl Scores {
    /// The mean over folds; all 0 without one.
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

/// 0 where there is nothing below the bar.
fn ratio(above: f64, below: f64) -> f64 {
    if below == 0.0 { 0.0 } else { above / below }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Truth, prediction, and what `tools/parity/mer_metrics.py` prints for them.
    type Fold = (&'static [usize], &'static [usize], [f64; 5]);

    #[rustfmt::skip]
    const FOLDS: [Fold; 5] = [
        (&[0, 0, 0, 1, 1, 2], &[0, 0, 1, 1, 2, 2], [0.6666666666666666, 0.7222222222222222, 0.6555555555555556, 0.6666666666666666, 0.6933612743506347]),
        (&[0, 0, 0, 0], &[0, 0, 2, 0], [0.5, 0.375, 0.42857142857142855, 0.75, 0.0]),
        (&[0, 0, 1], &[0, 0, 0], [0.3333333333333333, 0.5, 0.4, 0.6666666666666666, 0.0]),
        (&[0, 1], &[2, 2], [0.0, 0.0, 0.0, 0.0, 0.0]),
        (&[1, 1], &[1, 1], [1.0, 1.0, 1.0, 1.0, 1.0]),
    ];

    fn confusion(truth: &[usize], predicted: &[usize]) -> Confusion {
        let class = |&number: &usize| EmotionClass::ALL[number];
        Confusion::of(truth.iter().map(class).zip(predicted.iter().map(class)))
    }

    #[test]
    fn a_fold_scores_as_in_scikit_learn() {
        for (truth, predicted, expected) in FOLDS {
            for (found, expected) in confusion(truth, predicted).scores().values().iter().zip(expected) {
                assert!((found - expected).abs() < 1e-15, "{truth:?} {predicted:?}: {found} for {expected}");
            }
        }
    }

    #[test]
    fn pooled_scores_count_all_three_classes() {
        let pooled = confusion(&[0, 0, 0, 1, 1, 2], &[0, 0, 1, 1, 2, 2]);
        assert_eq!([pooled.uf1(), pooled.uar()], [pooled.scores().f1, pooled.scores().recall]);
        let one_class = confusion(&[1, 1], &[1, 1]);
        assert_eq!([one_class.uf1(), one_class.uar()], [1.0 / 3.0; 2]);
    }

    #[test]
    fn an_empty_fold_scores_zero() {
        assert_eq!(Confusion::default().scores(), Scores::default());
        assert_eq!(Scores::mean(&[]), Scores::default());
    }
}
