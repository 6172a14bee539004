//! Writing files while another process that begins with the same part removes files in progress, which it takes for what a
//! killed process left.

use std::io;
use std::path::Path;

use srflow_files::{FileError, FileProblem};

/// How many processes may begin with the same part while one file of it is being written.
const REMOVED_AT_MOST: u32 = 8;

/// Writes a file, and again if another process removed it before it got its name: one that begins with the same part takes files in progress
/// for what a killed process left.
pub(crate) fn until_kept(mut write: impl FnMut() -> Result<(), FileError>) -> Result<(), FileError> {
    let mut written = write();
    for _ in 0..REMOVED_AT_MOST {
        if !written.as_ref().is_err_and(was_removed) {
            break;
        }
        written = write();
    }
    written
}

/// Whether a file in progress vanished from a folder that is still there.
pub fn was_removed(error: &FileError) -> bool {
    let vanished =
        matches!(&error.problem, FileProblem::Place { error, .. } if error.kind() == io::ErrorKind::NotFound);
    vanished && error.path.parent().is_some_and(Path::is_dir)
}

#[cfg(test)]
mod tests {
    use std::fs;

    use srflow_files::write_file;

    use super::*;

    #[cfg(unix)]
    #[test]
    fn a_file_that_another_process_removed_is_written_again() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.bin");
        let mut times = 0;
        let mut write = |removed: u32| {
            until_kept(|| {
                write_file(&path, "a")?;
                times += 1;
                if times <= removed {
                    fs::remove_file(&path).unwrap();
                    fs::rename(folder.path().join("none"), &path).map_err(|error| {
                        FileProblem::Place { doing: "renaming", error, advice: "" }.in_file(&path)
                    })?;
                }
                Ok(())
            })
        };
        write(2).unwrap();
        assert_eq!(fs::read(&path).unwrap(), b"a");
        assert_eq!(write(u32::MAX).unwrap_err().path, path);
        assert!(until_kept(|| write_file(&folder.path().join("no/a.bin"), "a")).is_err());
    }
}
