//! Micro-expression recognition: apex, optical strain, classifiers, leave-one-subject-out, metrics and tables.

mod apex;
mod cache;
mod extract;
mod face;
mod features;
mod resize;
mod strain;

pub use apex::{ApexErrors, ApexRule, SpottedApex, apex_errors, spot_apex};
pub use cache::{FeatureCache, FeatureKey};
pub use extract::{
    ExtractError, ExtractProblem, Extracted, Method, Preparation, ResizeOrder, extract, features_of_frames,
};
pub use face::{ClipCrop, FaceBox, FaceCrop, FaceError, FacePoints, Landmarks};
pub use features::{Channel, FEATURE_SIDE, FeatureError, Features, Sample};
pub use resize::{resize_cubic, resize_flow};
pub use strain::{StrainFormula, optical_strain, strain_colors};
