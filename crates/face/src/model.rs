//! Networks in MediaPipe's package.

use std::path::{Path, PathBuf};

use srflow_files::{FileKind, open_zip, read_file, zip_entry, zip_entry_named};

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

impl Model {
    /// Reads the network from MediaPipe's package: its wheel, its folder, or any folder with the file.
    ///
    /// # Errors
    /// When the file is missing, damaged, or another network.
    pub(crate) fn read(&self, path: &Path) -> Result<Network, FaceError> {
        let (bytes, found) = self.bytes(path)?;
        let network = Network::parse(&bytes).and_then(|network| {
            if network.input() != self.input {
                let [expected, found] = [self.input, network.input()].map(|[channels, height, width]| {
                    format!("{width}x{height} pixels of {channels} channels")
                });
                return Err(format!("expected a network for {expected}, found {found}"));
            }
            (self.check)(&network).map(|()| network)
        });
        network.map_err(|problem| ModelError { path: found, problem }.into())
    }

    /// Whether its file is in a package, as far as that can be read.
    pub(crate) fn is_in(&self, path: &Path) -> bool {
        if path.is_dir() {
            return self.places(path).iter().any(|file| file.exists());
        }
        let zip = read_file(path, FileKind::Network).ok().and_then(|bytes| open_zip(bytes).ok());
        zip.is_some_and(|zip| zip_entry_named(&zip, self.name).is_some())
    }

    /// Where the file may be below a folder.
    fn places(&self, folder: &Path) -> [PathBuf; 2] {
        [folder.join(self.name), folder.join("modules").join(self.folder).join(self.name)]
    }

    /// The bytes of the network, and the file that they are from.
    fn bytes(&self, path: &Path) -> Result<(Vec<u8>, PathBuf), FaceError> {
        let name = self.name;
        let missing = |found: String| ModelError {
            path: path.to_owned(),
            problem: format!("expected {MODEL_SOURCES}, or a folder with its files; found {found}"),
        };
        if path.is_dir() {
            let Some(file) = self.places(path).into_iter().find(|file| file.exists()) else {
                return Err(missing(format!("no {name}")).into());
            };
            return Ok((read_file(&file, FileKind::Network)?, file));
        }
        let bytes = read_file(path, FileKind::Network)?;
        let mut zip = open_zip(bytes)
            .map_err(|problem| missing(format!("a file that is no whole .whl ({problem})")))?;
        let Some(entry) = zip_entry_named(&zip, name) else {
            return Err(missing(format!("no {name} inside")).into());
        };
        let bytes = zip_entry(&mut zip, &entry, "a package of MediaPipe", LARGEST_MODEL);
        let bytes = bytes.map_err(|problem| ModelError {
            path: path.to_owned(),
            problem: format!("{entry}: {problem}; get the file again"),
        })?;
        Ok((bytes, path.join(entry)))
    }
}
