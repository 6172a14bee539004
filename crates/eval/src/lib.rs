//! Scoring any estimator over any dataset: tables, panels, curves and the one-file HTML report.

mod table;

pub use table::{Better, Column, Mark, Row, Table, TextStyle};
