//! Scores of pairs that are kept while an evaluation goes on, so that it can be continued, and divided among processes.

use serde::{Deserialize, Serialize};

use crate::evaluate::ScoredPair;
use crate::results::PairScores;

/// The scores of one pair.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct KeptPair {
    /// What they depend on besides the pair: evaluations that share scores have the same.
    pub evaluation: String,
    /// The pair's name within its dataset.
    pub pair: String,
    /// What tells whether the pair's files have changed.
    pub files: String,
    /// By method, in the order of [`Evaluation::methods`](crate::Evaluation::methods): the baseline first.
    pub methods: Vec<KeptScores>,
}

/// The scores of one method on one pair.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct KeptScores {
    pub scores: PairScores,
    /// Shares of pixels whose end-point error is at most 0.05, 0.10, ... 5 px; empty without true flow.
    pub within: Vec<f64>,
}

impl KeptPair {
    /// Of a pair that was scored.
    pub fn new(pair: &ScoredPair, evaluation: &str, files: String) -> Self {
        let methods = pair.estimates.iter().map(|estimate| estimate.kept.clone()).collect();
        Self { evaluation: evaluation.to_owned(), pair: pair.name.to_owned(), files, methods }
    }
}
