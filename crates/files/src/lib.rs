//! Files of flow, pictures and settings: their codecs, opening files that are not trusted, errors that name the file, atomic
//! writing, hashes and locks.

mod atomic_write;
mod codec;
mod csv_table;
mod file_bytes;
mod file_error;
mod image_file;
mod json_lines;
mod open;
mod orientation;
mod parse_words;
pub mod pickle;
mod point_table;
mod run_folder;
mod run_lock;
mod settings;
mod sha256;

pub use atomic_write::{PARTIAL_EXTENSION, create_folder, remove_partial, write_atomically, write_file};
pub use codec::hdf5::{Hdf5Array, MAGIC as HDF5_MAGIC, hdf5_arrays};
pub use codec::npy::{
    Array, npy_pickle, read_npy, read_npy_channels_first, read_npy_plane, write_npy, write_npy_plane,
};
pub use codec::npz::{Npz, NpzArray, write_npz};
pub use codec::npz::{open_zip, write_zip, zip_entry, zip_entry_named};
pub use codec::{
    FlowFormat, encode_flow, encode_flow_half, read_flow, read_flow_as, write_flow, write_flow_as,
};
pub use csv_table::{CsvRow, CsvTable, whole_number};
pub use file_bytes::FileBytes;
pub use file_error::{FileError, FileProblem};
pub use image_file::{
    IMAGE_EXTENSIONS, read_alpha, read_grey16, read_image, read_image_size, read_labels, read_mask,
    rgba_of_image, write_image_png, write_labels_png, write_mask_png,
};
pub use json_lines::{JsonLines, RecordError, parse_sealed_json, read_json_lines, sealed_json};
pub use open::{FileKind, file_beside, open_file, read_file, read_text};
pub use parse_words::parse_error_in_words;
pub use point_table::{PointRow, PointSet, PointTable};
pub use run_folder::{RUN_CONFIG, RunFolder, RunFolderError, RunMode, read_run_log};
pub use run_lock::{LockError, RunLock};
pub use settings::{Preset, SettingsError, parse_settings, read_settings, settings_text, with_setting};
pub use sha256::{SHA256SUMS, hexadecimal, parse_sha256sums_line, sha256_of_file, sha256sums_line};
