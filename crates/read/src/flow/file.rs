//! The files of a pair, on disk or in a tar.

use std::borrow::Cow;
use std::path::{Path, PathBuf};

use srflow_field::{
    Array, FileBytes, FileError, FlowField, Image, Labels, Mask, Plane, read_flow, read_grey16, read_image,
    read_image_size, read_labels, read_mask, read_npy,
};

use super::DatasetError;
use crate::packed::{Contents, Member};

/// A file of a pair.
#[derive(Debug, Clone, PartialEq)]
pub enum EntryFile {
    /// On disk.
    Path(PathBuf),
    /// A member of a tar, on disk or on the web.
    Member(Member),
}

impl From<PathBuf> for EntryFile {
    fn from(path: PathBuf) -> Self {
        Self::Path(path)
    }
}

impl EntryFile {
    /// The name in messages: a member has that of its tar as its folder.
    pub fn path(&self) -> Cow<'_, Path> {
        match self {
            Self::Path(path) => Cow::Borrowed(path),
            Self::Member(member) => Cow::Owned(member.path()),
        }
    }

    /// The path, if it is a file of its own on disk.
    pub fn on_disk(&self) -> Option<&Path> {
        match self {
            Self::Path(path) => Some(path),
            Self::Member(_) => None,
        }
    }
}

/// Files of one pair that are about to be decoded: those on disk are opened then, members of a tar are read already, together.
pub(super) struct Opened {
    contents: Contents,
}

impl Opened {
    /// Reads the members among the files, which must be those of one pair.
    pub fn of<'a>(files: impl IntoIterator<Item = &'a EntryFile>) -> Result<Self, DatasetError> {
        let member = |file: &'a EntryFile| match file {
            EntryFile::Path(_) => None,
            EntryFile::Member(member) => Some(member),
        };
        let members: Vec<&Member> = files.into_iter().filter_map(member).collect();
        Ok(Self { contents: Contents::read(&members)? })
    }

    pub fn image(&self, file: &EntryFile) -> Result<Image, DatasetError> {
        self.decode(file, read_image, |bytes| bytes.image())
    }

    pub fn image_size(&self, file: &EntryFile) -> Result<(usize, usize), DatasetError> {
        self.decode(file, read_image_size, |bytes| bytes.image_size())
    }

    pub fn flow(&self, file: &EntryFile) -> Result<FlowField, DatasetError> {
        self.decode(file, read_flow, |bytes| bytes.flow())
    }

    pub fn labels(&self, file: &EntryFile) -> Result<Labels, DatasetError> {
        self.decode(file, read_labels, |bytes| bytes.labels())
    }

    pub fn grey16(&self, file: &EntryFile) -> Result<Plane, DatasetError> {
        self.decode(file, read_grey16, |bytes| bytes.grey16())
    }

    /// A mask from a picture, or from a `.npy` array of shape (H, W) that is `true` where it is not zero.
    pub fn mask(&self, file: &EntryFile) -> Result<Mask, DatasetError> {
        let path = file.path();
        if !path.extension().is_some_and(|ending| ending.eq_ignore_ascii_case("npy")) {
            return self.decode(file, read_mask, |bytes| bytes.mask());
        }
        let array: Array = self.decode(file, read_npy, |bytes| bytes.npy())?;
        let wrong = |reason| DatasetError::Format { path: path.clone().into_owned(), reason };
        let [height, width] = array.shape[..] else {
            return Err(wrong(format!("shape {:?}: expected (H, W) for a mask", array.shape)));
        };
        let inside = array.values.iter().map(|&value| value != 0.0).collect();
        Mask::from_pixels(width, height, inside).map_err(|error| wrong(error.to_string()))
    }

    fn decode<T>(
        &self,
        file: &EntryFile,
        read: fn(&Path) -> Result<T, FileError>,
        decode: impl FnOnce(FileBytes) -> Result<T, FileError>,
    ) -> Result<T, DatasetError> {
        Ok(match file {
            EntryFile::Path(path) => read(path)?,
            EntryFile::Member(member) => {
                decode(FileBytes { name: &member.path(), bytes: self.contents.get(member) })?
            }
        })
    }
}
