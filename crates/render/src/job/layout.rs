//! The files of a dataset that is made unit by unit.

use std::ffi::OsString;
use std::fs;
use std::path::{Path, PathBuf};

/// Where a dataset has its files.
pub(crate) trait Layout: Sync {
    /// Name of the file that records the dataset's arguments.
    const MANIFEST: &'static str;
    /// What units are called, in the plural.
    const UNITS: &'static str;

    /// The number of units of each group.
    fn groups(&self) -> Vec<u32>;

    /// The files of a unit in `dir`, which need not exist. The one that is written last is the first.
    fn files(&self, dir: &Path, group: u32, unit: u32) -> Vec<PathBuf>;

    /// Whether all files of a unit exist.
    fn is_whole(&self, dir: &Path, group: u32, unit: u32) -> bool {
        self.files(dir, group, unit).iter().all(|file| file.is_file())
    }

    /// The units, by group, whose last file is in `dir`, in any order; found by listing folders, so that the time does not grow with the
    /// size of the whole dataset.
    fn begun_in(&self, dir: &Path) -> Vec<(u32, u32)>;

    /// The name of a unit in messages.
    fn name(&self, group: u32, unit: u32) -> String;

    /// The files of a complete dataset besides those of its units and the manifest, relative to its folder.
    fn others(&self) -> Vec<PathBuf>;
}

/// The names in a folder; none where it cannot be listed.
pub(crate) fn names_in(folder: &Path) -> impl Iterator<Item = OsString> + use<> {
    fs::read_dir(folder).into_iter().flatten().flatten().map(|entry| entry.file_name())
}

/// The number that a file's name begins with.
pub(crate) fn leading_number(name: &OsString) -> Option<u32> {
    let name = name.to_str()?;
    name[..name.find(|c: char| !c.is_ascii_digit()).unwrap_or(name.len())].parse().ok()
}
