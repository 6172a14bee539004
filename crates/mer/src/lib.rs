//! Micro-expression recognition: apex, optical strain, classifiers, leave-one-subject-out, metrics and tables.

mod apex;
mod cache;
mod clap;
mod classifier;
mod extract;
mod extract_error;
mod face;
mod features;
mod features_file;
mod fold;
mod loso;
mod metrics;
mod predictions;
mod protocol;
mod report;
mod results;
mod results_csv;
mod results_folder;
mod run;
mod strain;
mod summary;
mod training;

pub use apex::{
    ApexErrors, ApexRule, Cell, SpottedApex, apex_errors, cells, difference_ratio, fill_apexes, spot_apex,
    spot_apexes,
};
pub use cache::{FeatureCache, FeatureKey, file_digest};
pub use classifier::{
    CLASSIFIERS, Classifier, ClassifierEntry, ClassifierFacts, OffApexNet, OffTaNet, StstNet, initialized,
};
pub use extract::{Extracted, Method, Preparation, ResizeOrder, extract, features_of_frames};
pub use extract_error::{ExtractError, ExtractProblem};
pub use face::{FaceCrop, Landmarks};
pub use features::{Channel, FEATURE_SIDE, FeatureError, Features, Sample};
pub use features_file::{FeatureRecipe, write_features};
pub use loso::{
    Fold, FoldFolder, FoldRecord, LabelledClip, Loso, LosoError, LosoEvent, folds, leave_one_subject_out,
    leave_one_subject_out_by,
};
pub use metrics::{Confusion, Scores};
pub use predictions::{Prediction, PredictionsError, Trial, read_predictions, write_predictions};
pub use protocol::{Protocol, ProtocolError};
pub use report::{ReportError, ReportParts, report};
pub use results::{
    METRICS, Outcome, OutcomeRecord, by_set, confusion_latex, confusion_title, fold_table, score_tables,
    unseen_classes,
};
pub use results_csv::{confusions_csv, folds_csv, scores_csv};
pub use results_folder::{
    ResultsError, ResultsFolder, ResultsRecord, TABLE_FILES, all_score_tables, write_tables,
};
pub use run::{
    DataRecord, FeatureSet, RunError, RunEvent, RunFolders, RunMethod, RunResults, RunSettings, RunWatch,
    Sets, TrainedPart, compute_features, run, run_part,
};
pub use strain::{StrainFormula, optical_strain, strain_colors};
pub use summary::{Best, EpochScores, FoldScores, Summary, SummaryError};
pub use training::{Training, cross_entropy};
