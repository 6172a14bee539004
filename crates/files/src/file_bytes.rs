//! Files that are in memory.

use std::io::Cursor;
use std::path::Path;

use crate::codec::{detect_and_decode, npy};
use crate::image_file::{grey16_of, image_of, image_size_of, labels_of, mask_of};
use crate::{Array, FileError, FileProblem};
use srflow_core::{FlowField, Image, Labels, Mask, Plane, Size};

/// The content of a file that is in memory, such as a member of an archive. It is decoded as the function `read_*` for files does.
#[derive(Debug, Clone, Copy)]
pub struct FileBytes<'a> {
    /// The name in messages. Its extension helps to detect formats of flow.
    pub name: &'a Path,
    pub bytes: &'a [u8],
}

impl FileBytes<'_> {
    /// As [`read_image`](crate::read_image).
    ///
    /// # Errors
    /// When it has another format, or is corrupt.
    pub fn image(self) -> Result<Image, FileError> {
        self.named(image_of(self.bytes))
    }

    /// As [`read_image_size`](crate::read_image_size).
    ///
    /// # Errors
    /// When it has another format, or its header is corrupt.
    pub fn image_size(self) -> Result<Size, FileError> {
        self.named(image_size_of(&mut Cursor::new(self.bytes)))
    }

    /// As [`read_mask`](crate::read_mask).
    ///
    /// # Errors
    /// As [`FileBytes::image`].
    pub fn mask(self) -> Result<Mask, FileError> {
        self.named(mask_of(self.bytes))
    }

    /// As [`read_labels`](crate::read_labels).
    ///
    /// # Errors
    /// As [`FileBytes::image`], and when the image is not grey with 8 bits.
    pub fn labels(self) -> Result<Labels, FileError> {
        self.named(labels_of(self.bytes))
    }

    /// As [`read_grey16`](crate::read_grey16).
    ///
    /// # Errors
    /// As [`FileBytes::image`], and when the image is not grey with 16 bits.
    pub fn grey16(self) -> Result<Plane, FileError> {
        self.named(grey16_of(self.bytes))
    }

    /// As [`read_flow`](crate::read_flow).
    ///
    /// # Errors
    /// When it has no known format, or does not match its header.
    pub fn flow(self) -> Result<FlowField, FileError> {
        self.named(detect_and_decode(self.name, &mut { self.bytes }, self.bytes.len() as u64))
    }

    /// As [`read_npy`](crate::read_npy).
    ///
    /// # Errors
    /// When it contains another type of array, or does not match its header.
    pub fn npy(self) -> Result<Array, FileError> {
        self.named(npy::decode(&mut { self.bytes }, self.bytes.len() as u64))
    }

    fn named<T>(self, result: Result<T, FileProblem>) -> Result<T, FileError> {
        result.map_err(|problem| problem.in_file(self.name))
    }
}
