//! Scoring any estimator over any dataset: tables, panels, curves and the one-file HTML report.

mod crop;
pub mod report;
mod table;
mod zero;

pub use crop::{CropError, Window, head_window};
pub use table::{Better, Column, Mark, Row, Table, TextStyle};
pub use zero::Zero;
