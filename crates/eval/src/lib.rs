//! Scoring any estimator over any dataset: tables, panels, curves and the one-file HTML report.
