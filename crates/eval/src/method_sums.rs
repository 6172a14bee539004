//! Scores of one method over many pairs.

use std::collections::BTreeMap;

use srflow_core::{FlowEstimator, MeanMetrics, Metrics};

use crate::error_curve::ErrorCurve;
use crate::expression::Expression;
use crate::expression_error::ExpressionError;
use crate::kept::KeptScores;
use crate::results::{MethodScores, Region};
use crate::zero::Zero;

/// Sums over the pairs of one method.
pub(crate) struct MethodSums {
    scores: MethodScores,
    regions: BTreeMap<Region, MeanMetrics>,
    curve: ErrorCurve,
}

impl MethodSums {
    pub(crate) fn new(name: &str) -> Self {
        let name = name.to_owned();
        let baseline = name == Zero.name();
        Self {
            scores: MethodScores { name, baseline, ..MethodScores::default() },
            regions: BTreeMap::new(),
            curve: ErrorCurve::default(),
        }
    }

    pub(crate) fn add(&mut self, KeptScores { scores, within }: &KeptScores) {
        for region in Region::ALL {
            self.regions.entry(region).or_default().add(scores.region(region));
        }
        self.curve.add(within);
        self.scores.pairs.push(scores.clone());
    }

    pub(crate) fn finish(self) -> MethodScores {
        let means = self.regions.iter().filter_map(|(region, sum)| Some((*region, sum.mean()?)));
        let mut means: BTreeMap<Region, Metrics> = means.collect();
        MethodScores {
            whole: means.remove(&Region::Whole),
            head: means.remove(&Region::Head),
            visible: means.remove(&Region::Visible),
            regions: means,
            expression: Expression::mean(self.scores.pairs.iter().filter_map(|pair| pair.expression)),
            expression_error: ExpressionError::mean(
                self.scores.pairs.iter().filter_map(|pair| pair.expression_error),
            ),
            iterations: mean(self.scores.pairs.iter().filter_map(|pair| pair.iterations)),
            within: self.curve.mean(),
            ..self.scores
        }
    }
}

/// `None` of no numbers.
fn mean(numbers: impl Iterator<Item = f32>) -> Option<f64> {
    let (sum, count) = numbers.fold((0.0, 0), |(sum, count), number| (sum + f64::from(number), count + 1));
    (count > 0).then(|| sum / f64::from(count))
}
