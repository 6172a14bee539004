//! The files of a pair, on disk or in a tar.

use std::collections::HashMap;
use std::ffi::OsStr;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use srflow_core::{FlowField, Image, Labels, Mask, Plane, Size};
use srflow_files::{
    Array, FileBytes, FileError, read_flow, read_grey16, read_image, read_image_size, read_labels, read_mask,
    read_npy,
};
use srflow_pack::{Contents, Member};

use super::error::DatasetError;

/// A file of a pair. Those of a million pairs are in memory at once.
#[derive(Debug, Clone, PartialEq)]
pub enum EntryFile {
    /// On disk: its folder, which may be shared with other files, and its name there.
    OnDisk { folder: Arc<PathBuf>, name: Box<OsStr> },
    /// A member of a tar, on disk or on the web.
    Member(Member),
}

impl From<PathBuf> for EntryFile {
    fn from(path: PathBuf) -> Self {
        let (folder, name) = match (path.parent(), path.file_name()) {
            (Some(folder), Some(name)) => (folder.to_owned(), name.into()),
            _ => (PathBuf::new(), path.as_os_str().into()),
        };
        Self::OnDisk { folder: Arc::new(folder), name }
    }
}

impl EntryFile {
    /// The name in messages: a member has that of its tar as its folder.
    pub fn path(&self) -> PathBuf {
        match self {
            Self::OnDisk { folder, name } => folder.join(&**name),
            Self::Member(member) => member.path(),
        }
    }

    /// The path, if it is a file of its own on disk.
    pub fn on_disk(&self) -> Option<PathBuf> {
        match self {
            Self::OnDisk { .. } => Some(self.path()),
            Self::Member(_) => None,
        }
    }
}

/// The folders of files that are listed, each in memory once.
#[derive(Default)]
pub(super) struct Folders(HashMap<PathBuf, Arc<PathBuf>>);

impl Folders {
    /// The file at `path`.
    pub fn file(&mut self, path: PathBuf) -> EntryFile {
        let (Some(parent), Some(name)) = (path.parent(), path.file_name()) else { return path.into() };
        let folder = match self.0.get(parent) {
            Some(folder) => folder.clone(),
            None => self.0.entry(parent.to_owned()).or_insert(Arc::new(parent.to_owned())).clone(),
        };
        EntryFile::OnDisk { folder, name: name.into() }
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
            EntryFile::OnDisk { .. } => None,
            EntryFile::Member(member) => Some(member),
        };
        let members: Vec<&Member> = files.into_iter().filter_map(member).collect();
        Ok(Self { contents: Contents::read(&members)? })
    }

    pub fn image(&self, file: &EntryFile) -> Result<Image, DatasetError> {
        self.decode(file, read_image, |bytes| bytes.image())
    }

    pub fn image_size(&self, file: &EntryFile) -> Result<Size, DatasetError> {
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
        let wrong = |reason| DatasetError::Format { path: path.clone(), reason };
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
            EntryFile::OnDisk { folder, name } => read(&folder.join(&**name))?,
            EntryFile::Member(member) => {
                decode(FileBytes { name: &member.path(), bytes: self.contents.get(member) })?
            }
        })
    }
}
