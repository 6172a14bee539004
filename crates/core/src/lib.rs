//! Flow fields, images and masks: colours, warping, resizing, metrics, and the seeded random numbers of everything generated.
//!
//! Conventions of every crate of the workspace: arrays are row-major; an integer coordinate is the centre
//! of a pixel; flow is in pixels, `u` to the right and `v` down, from frame 1 to frame 2, stored at frame 1's pixel.

mod color;
pub mod dense;
mod estimator;
mod excerpt;
mod flow_colors;
mod forward_interpolate;
mod grey;
mod grid;
mod hull;
mod landmarks;
mod median;
mod metrics;
mod named;
pub mod random;
mod recent;
pub mod resize;
mod setting;
mod shard;
mod size;
mod spares;
mod stages;
mod surface_motion;
mod warp;

pub use color::{Color, parse_color};
pub use estimator::{EstimateError, FlowEstimate, FlowEstimator, FlowSequence, check_frame_sizes};
pub use excerpt::{excerpt, excerpts, is_unprintable, printable};
pub use flow_colors::{flow_colors, longest_flow};
pub use forward_interpolate::forward_interpolate;
pub use grey::{LUMA, luminance, opencv_grey, pillow_grey};
pub(crate) use grid::check_same_size;
pub use grid::{FlowField, Image, Labels, Mask, Plane, SizeError, SizeMismatch};
pub use hull::ConvexHull;
pub use landmarks::MEDIAPIPE_OF_DLIB;
pub use median::median;
pub use metrics::{MAX_SCORED_FLOW, MeanMetrics, Metrics, ScoreError, score};
pub use recent::Recent;
pub use setting::{Numbers, SettingError, parse_setting};
pub use shard::Shard;
pub use size::Size;
pub use spares::Spares;
pub use stages::in_stages;
pub use surface_motion::SurfaceMotion;
pub use warp::{Tolerance, forward_backward_check, warp};
