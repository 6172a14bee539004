//! The part of HDF5 that flow files and weights of Keras use: floating-point datasets in groups, contiguous; in the root group
//! of flow files also in chunks with deflate, shuffle and Fletcher-32 filters; written in the layout that every HDF5 library
//! since 1.6 reads.
//!
//! Section numbers refer to the *HDF5 File Format Specification Version 3.0*. Our own implementation, because files are
//! untrusted: every address, size and count is checked against the file before it is used or memory is allocated for it.

mod arrays;
mod chunks;
mod fields;
mod header;
mod read;
mod write;

pub use arrays::{Hdf5Array, hdf5_arrays};
pub(super) use read::Dataset;
pub(super) use write::write_image;

/// The first bytes of every HDF5 file.
pub const MAGIC: &[u8] = b"\x89HDF\r\n\x1a\n";

/// The undefined address.
const UNDEFINED: u64 = u64::MAX;
