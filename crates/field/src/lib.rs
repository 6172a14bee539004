//! Flow fields, images and masks: files, colours, warping, resizing and metrics.
//!
//! Conventions of every crate of the workspace: arrays are row-major; an integer coordinate is the centre
//! of a pixel; flow is in pixels, `u` to the right and `v` down, from frame 1 to frame 2, stored at frame 1's pixel.

mod atomic_write;
mod codec;
mod color;
mod estimator;
mod excerpt;
mod file_bytes;
mod file_error;
mod flow_colors;
mod forward_interpolate;
mod grey;
mod grid;
mod image_file;
mod json_lines;
mod landmarks;
mod metrics;
mod named;
mod open;
mod parse_words;
pub mod random;
mod recent;
pub mod resize;
mod run_lock;
mod settings;
mod sha256;
mod shard;
mod size;
mod spares;
mod stages;
mod warp;

pub use atomic_write::{PARTIAL_EXTENSION, create_folder, remove_partial, write_atomically, write_file};
pub use codec::hdf5::{Hdf5Array, MAGIC as HDF5_MAGIC, hdf5_arrays};
pub use codec::npy::{Array, npy_pickle, read_npy, read_npy_plane, write_npy, write_npy_plane};
pub use codec::npz::open_zip;
pub use codec::npz::{Npz, NpzArray, write_npz};
pub use codec::{
    FlowFormat, encode_flow, encode_flow_half, read_flow, read_flow_as, write_flow, write_flow_as,
};
pub use color::parse_color;
pub use estimator::{EstimateError, FlowEstimate, FlowEstimator, FlowSequence, check_frame_sizes};
pub use excerpt::{excerpt, excerpts, is_unprintable, printable};
pub use file_bytes::FileBytes;
pub use file_error::{FileError, FileProblem};
pub use flow_colors::{flow_colors, longest_flow};
pub use forward_interpolate::forward_interpolate;
pub use grey::{luminance, opencv_grey, pillow_grey};
pub(crate) use grid::check_same_size;
pub use grid::{FlowField, Image, Labels, Mask, Plane, SizeError, SizeMismatch};
pub use image_file::{
    IMAGE_EXTENSIONS, read_grey16, read_image, read_image_size, read_labels, read_mask, write_image_png,
    write_labels_png, write_mask_png,
};
pub use json_lines::{JsonLines, read_json_lines};
pub use landmarks::MEDIAPIPE_OF_DLIB;
pub use metrics::{MAX_SCORED_FLOW, MeanMetrics, Metrics, ScoreError, score};
pub use open::{FileKind, open_file, read_file, read_text};
pub use parse_words::parse_error_in_words;
pub use recent::Recent;
pub use run_lock::{LockError, RunLock};
pub use settings::{Preset, SettingsError, parse_settings, read_settings, settings_text, with_setting};
pub use sha256::{SHA256SUMS, hexadecimal, parse_sha256sums_line, sha256_of_file, sha256sums_line};
pub use shard::{Shard, ShardChoice, ShardError, TakenShard};
pub use size::Size;
pub use spares::Spares;
pub use stages::in_stages;
pub use warp::{Tolerance, forward_backward_check, warp};
