//! Spotting: in which frames of a long video a face shows an expression, and how well that is found.

mod action_units;
mod elan;
mod events;
mod regions;
mod score;
mod signals;
mod view;

pub use action_units::{ACTION_UNITS, candidate_units, unit_motion};
pub use elan::elan;
pub use events::{SpottedEvent, SpottingSettings, spot_events};
pub use regions::{REGIONS, RegionBoxes, RegionMotion, region_motion_of_features, regions};
pub use score::{
    Analysis, CountingRule, Counts, PredictedTypes, SpottingScores, TypeScores, retyped, score_intervals,
};
pub use signals::{SignalError, SignalRecorder, Signals};
pub use view::{FaceFollower, FaceView, Sight};
