//! Scores any estimator over any dataset, and shows the scores and the scored pairs.

mod crop;
mod error_curve;
mod evaluate;
mod expression;
mod expression_error;
mod flow_files;
mod kept;
mod method_record;
mod method_sums;
mod pair_figures;
mod regions;
mod results;
mod score_report;
mod zero;

pub use crop::{CropError, Window, head_window, window_about};
pub use evaluate::{
    Estimate, EvaluateError, Event, Method, OnFailure, PairProblem, ScoredPair, Settings, evaluate,
    scored_pairs, spread,
};
pub use expression::Expression;
pub use expression_error::ExpressionError;
pub use flow_files::{FlowFileError, FlowFiles, FlowFilesError};
pub use kept::{KeptPair, KeptScores};
pub use method_record::MethodRecord;
pub use pair_figures::{pair_figures, sample_panels};
pub use results::{
    Evaluation, Failure, MethodScores, PairScores, Region, SCORES, ScoreColumn, dataset_title,
    improvement_columns, improvement_percent, score_columns,
};
pub use score_report::{score_figures, score_report};
pub use zero::Zero;
