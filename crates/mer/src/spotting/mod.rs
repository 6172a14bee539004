//! Spotting: in which frames of a long video a face shows an expression, and how well that is found.

mod elan;
mod events;
mod regions;
mod score;
mod signals;
mod view;

pub use elan::elan;
pub use events::{SpottedEvent, SpottingSettings, spot_events};
pub use regions::{REGIONS, RegionBoxes, regions};
pub use score::{
    Analysis, CountingRule, Counts, PredictedTypes, SpottingScores, TypeScores, retyped, score_intervals,
};
pub use signals::{RegionMotion, SignalError, SignalRecorder, Signals};
pub use view::{FaceFollower, FaceView, Sight};
