//! Scores any estimator over any dataset: tables, panels, curves and the one-file HTML report.

mod crop;
mod error_curve;
mod evaluate;
mod expression;
mod flow_files;
mod kept;
mod method_record;
mod regions;
pub mod report;
mod results;
mod table;
mod zero;

pub use crop::{CropError, Window, head_window, window_about};
pub use evaluate::{
    Estimate, EvaluateError, Event, Method, OnFailure, PairProblem, ScoredPair, Settings, evaluate,
    scored_pairs, spread,
};
pub use expression::Expression;
pub use flow_files::{FlowFileError, FlowFiles, FlowFilesError};
pub use kept::{KeptPair, KeptScores};
pub use method_record::MethodRecord;
pub use results::{
    Evaluation, Failure, MethodScores, PairScores, Region, SCORES, ScoreColumn, dataset_title,
    improvement_columns, improvement_percent, score_columns,
};
pub use table::{
    Better, Column, Mark, Row, Table, TextStyle, joined, latex_escape, latex_file, markdown_file,
};
pub use zero::Zero;
