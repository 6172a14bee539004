//! Micro-expression recognition: apex, optical strain, classifiers, leave-one-subject-out, metrics and tables.

mod features;

pub use features::{Channel, FEATURE_SIDE, FeatureError, Features, Sample};
