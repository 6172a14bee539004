//! Micro-expression recognition: apex, optical strain, classifiers, leave-one-subject-out, metrics and tables.

mod apex;
mod augment;
mod balance;
mod cache;
mod clap;
mod classifier;
mod comparison;
mod extract;
mod extract_error;
mod face;
mod features;
mod features_file;
mod fold;
mod head_motion;
mod learning;
mod loso;
mod metrics;
mod model;
mod outcome;
mod predictions;
mod protocol;
mod recognition_protocol;
mod regions;
mod report;
mod results;
mod results_csv;
mod results_folder;
mod run;
mod sample;
pub mod spotting;
mod statistics;
mod strain;
mod summary;
mod time_course;
mod training;

pub use apex::{
    ApexErrors, ApexRule, Cell, SpottedApex, apex_errors, cells, difference_ratio, fill_apexes, spot_apex,
    spot_apexes,
};
pub use augment::Augment;
pub use balance::Balance;
pub use cache::{FeatureCache, FeatureKey, file_digest};
pub use classifier::{
    CLASSIFIERS, Classifier, ClassifierEntry, ClassifierFacts, INVERSE_STRENGTHS, LogisticRegression,
    Observation, OffApexNet, OffTaNet, SssNet, StstNet, initialized, validation_losses,
};
pub use comparison::{Comparison, comparisons};
pub use extract::{
    Extracted, FeatureSettings, Method, Preparation, ResizeOrder, extract, faces_of_clip, features_of_flow,
    features_of_frames,
};
pub use extract_error::{ExtractError, ExtractProblem};
pub use face::{FaceCrop, Landmarks};
pub use features::{Channel, FEATURE_SIDE, FeatureError, Features};
pub use features_file::{FeatureFileError, FeatureRecipe, write_features};
pub use head_motion::{HeadMotion, SubtractedMotion};
pub use loso::{
    Fold, FoldFolder, FoldRecord, LabelledClip, LeftOut, Loso, LosoError, LosoEvent, LosoWatch, folds,
    leave_one_subject_out_by, leave_out,
};
pub use metrics::{Confusion, Scores};
pub use model::{
    Doubt, HeldOut, LEAST_PROBABILITY, ModelCard, ModelData, ModelError, ModelFlow, ModelLesson, Recognition,
    RecognitionModel, TrainingRange, motion_px, probabilities, temperature,
};
pub use outcome::{METRICS, Outcome, OutcomeRecord, by_set};
pub use predictions::{Prediction, PredictionsError, Trial, read_predictions, write_predictions};
pub use protocol::{Protocol, ProtocolError};
pub use recognition_protocol::RecognitionProtocol;
pub use regions::{RegionFlow, RegionMap, Regions};
pub use report::{ReportError, ReportParts, report};
pub use results::{confusion_latex, confusion_title, fold_table, score_tables, unseen_classes};
pub use results_csv::{comparisons_csv, confusions_csv, folds_csv, scores_csv};
pub use results_folder::{
    Origin, ResultsError, ResultsFolder, ResultsRecord, TABLE_FILES, all_score_tables, write_tables,
};
pub use run::{
    DataRecord, FeatureSet, RunError, RunEvent, RunFolders, RunMethod, RunResults, RunSettings, RunWatch,
    Sets, TrainedPart, compute_features, run, run_part,
};
pub use sample::Sample;
pub use statistics::{Interval, MEASURES, SIGNIFICANCE, SubjectScores, holm};
pub use strain::{StrainFormula, optical_strain, strain_colors};
pub use summary::{Best, EpochScores, FoldScores, Summary, SummaryError};
pub use time_course::TimeCourse;
pub use training::{Training, cross_entropy};
