//! Networks in MediaPipe's package.

use std::io::Cursor;
use std::path::{Path, PathBuf};

use srflow_files::{FileKind, open_zip, read_file, zip_entry, zip_entry_named};

use zip::ZipArchive;

use crate::tflite::Network;
use crate::{FaceError, ModelError};

/// Where the networks come from, for messages and help.
pub const MODEL_SOURCES: &str = "the networks of MediaPipe, which are in its package up to version 0.10.21: `pip download \
    --no-deps --only-binary=:all: --python-version 3.11 --platform manylinux_2_28_x86_64 mediapipe==0.10.21` gets a file \
    mediapipe-0.10.21-....whl, which works on every system";

/// No network of MediaPipe's for faces or persons is larger, in bytes.
const LARGEST_MODEL: u64 = 64 << 20;

/// A network of MediaPipe's.
pub(crate) struct Model {
    /// Its file.
    pub(crate) name: &'static str,
    /// The folder of the file below `modules` of the package.
    pub(crate) folder: &'static str,
    /// Channels, height and width of its input.
    pub(crate) input: [usize; 3],
    /// What else tells it from other networks: a sentence with what was expected and found.
    pub(crate) check: fn(&Network) -> Result<(), String>,
}

/// Files of MediaPipe's: its wheel or another archive, its folder, or any folder with the files.
pub(crate) struct Package<'a> {
    path: &'a Path,
    /// `None` for a folder.
    archive: Option<ZipArchive<Cursor<Vec<u8>>>>,
}

impl<'a> Package<'a> {
    /// # Errors
    /// When it is neither a folder nor an archive that can be read.
    pub(crate) fn open(path: &'a Path) -> Result<Self, FaceError> {
        if path.is_dir() {
            return Ok(Self { path, archive: None });
        }
        let archive = open_zip(read_file(path, FileKind::Network)?)
            .map_err(|problem| missing(path, &format!("a file that is no whole .whl ({problem})")))?;
        Ok(Self { path, archive: Some(archive) })
    }

    /// Whether it has the file of a network.
    pub(crate) fn has(&self, model: &Model) -> bool {
        match &self.archive {
            Some(archive) => zip_entry_named(archive, model.name).is_some(),
            None => self.file(model).is_some(),
        }
    }

    /// Reads a network.
    ///
    /// # Errors
    /// When its file is missing, damaged, or another network.
    pub(crate) fn read(&mut self, model: &Model) -> Result<Network, FaceError> {
        let (bytes, found) = self.bytes(model)?;
        let network = Network::parse(&bytes).and_then(|network| {
            if network.input() != model.input {
                let [expected, found] = [model.input, network.input()].map(|[channels, height, width]| {
                    format!("{width}x{height} pixels of {channels} channels")
                });
                return Err(format!("expected a network for {expected}, found {found}"));
            }
            (model.check)(&network).map(|()| network)
        });
        network.map_err(|problem| ModelError { path: found, problem }.into())
    }

    /// The file of a network in a folder.
    fn file(&self, model: &Model) -> Option<PathBuf> {
        let below_modules = self.path.join("modules").join(model.folder).join(model.name);
        [self.path.join(model.name), below_modules].into_iter().find(|file| file.exists())
    }

    /// The bytes of a network, and the file that they are from.
    fn bytes(&mut self, model: &Model) -> Result<(Vec<u8>, PathBuf), FaceError> {
        let name = model.name;
        let Some(archive) = &mut self.archive else {
            let file = self.file(model).ok_or_else(|| missing(self.path, &format!("no {name}")))?;
            return Ok((read_file(&file, FileKind::Network)?, file));
        };
        let entry =
            zip_entry_named(archive, name).ok_or_else(|| missing(self.path, &format!("no {name} inside")))?;
        let bytes = zip_entry(archive, &entry, "a package of MediaPipe", LARGEST_MODEL);
        let bytes = bytes.map_err(|problem| ModelError {
            path: self.path.to_owned(),
            problem: format!("{entry}: {problem}; get the file again"),
        })?;
        Ok((bytes, self.path.join(entry)))
    }
}

fn missing(path: &Path, found: &str) -> ModelError {
    let problem = format!("expected {MODEL_SOURCES}, or a folder with its files; found {found}");
    ModelError { path: path.to_owned(), problem }
}
