use std::ffi::OsString;
use std::fs::{self, File, OpenOptions};
use std::io::{self, BufRead, BufReader, BufWriter, Write};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

use crate::{FileError, FileProblem};

/// Extension of a file being written. A leftover one belongs to a process that was killed.
pub const PARTIAL_EXTENSION: &str = "partial";

/// Names that are tried for a file in progress.
const NAMES: u32 = 1000;

/// Writes a file atomically: into `.NAME.PROCESS-COUNT.partial` next to it, which is renamed when complete. When `write`
/// fails, the partial file is removed and the old one stays.
///
/// The rename is atomic for other processes and if this one is killed, but not for a power cut.
///
/// A file on a read-only disk counts as written if it has this content already: a finished result stays one.
///
/// # Errors
/// When the folder cannot be written to, or with the error of `write`.
pub fn write_atomically(
    path: &Path,
    write: impl FnOnce(&mut BufWriter<File>) -> io::Result<()>,
) -> Result<(), FileError> {
    let failed = |doing| move |error| FileProblem::Io { doing, error }.in_file(path);
    let misplaced = |doing| {
        let advice = "give the path of a file, in a folder that exists and can be written to";
        move |error| FileProblem::Place { doing, error, advice }.in_file(path)
    };
    let (partial, file) = match create_partial(path) {
        Ok(created) => created,
        Err(error) if is_read_only(&error) && already_has(path, write) => return Ok(()),
        Err(error) => return Err(misplaced("creating")(error)),
    };
    let written = fill(file, write).map_err(failed("writing"));
    let result =
        written.and_then(|()| fs::rename(&partial, path).map_err(misplaced("renaming the finished file")));
    if result.is_err() {
        let _ = fs::remove_file(&partial); // the first error is the one to report
    }
    result
}

fn is_read_only(error: &io::Error) -> bool {
    matches!(error.kind(), io::ErrorKind::ReadOnlyFilesystem | io::ErrorKind::PermissionDenied)
}

/// Whether the file at `path` has the content that `write` writes, which a file elsewhere takes meanwhile.
fn already_has(path: &Path, write: impl FnOnce(&mut BufWriter<File>) -> io::Result<()>) -> bool {
    let Some(name) = path.file_name().filter(|_| path.is_file()) else { return false };
    let Ok((copy, file)) = create_partial(&std::env::temp_dir().join(name)) else { return false };
    let same = fill(file, write).and_then(|()| {
        let [mut one, mut other] = [BufReader::new(File::open(path)?), BufReader::new(File::open(&copy)?)];
        loop {
            let (left, right) = (one.fill_buf()?, other.fill_buf()?);
            let len = left.len().min(right.len());
            if left[..len] != right[..len] || (len == 0 && left.len() != right.len()) {
                return Ok(false);
            }
            if len == 0 {
                return Ok(true);
            }
            one.consume(len);
            other.consume(len);
        }
    });
    _ = fs::remove_file(copy);
    same.unwrap_or(false)
}

/// Writes a text or bytes as a file, as [`write_atomically`] does.
///
/// # Errors
/// Those of [`write_atomically`].
pub fn write_file(path: &Path, content: impl AsRef<[u8]>) -> Result<(), FileError> {
    write_atomically(path, |file| file.write_all(content.as_ref()))
}

/// Creates a folder and its missing parents. An existing one is left unchanged.
///
/// # Errors
/// When a file has that name, or the parent folder is not writable.
pub fn create_folder(path: &Path) -> Result<(), FileError> {
    let advice = "give the path of a folder, or of one that can be created";
    let failed = |error| FileProblem::Place { doing: "making the folder", error, advice };
    fs::create_dir_all(path).map_err(|error| failed(error).in_file(path))
}

/// Removes the files and folders in `folder` that a killed process left unfinished: those named `.NAME.partial` whose name (with what
/// [`write_atomically`] adds to it) and age are `abandoned`. Other processes may remove the same ones.
///
/// # Errors
/// When the folder cannot be listed, or one of them cannot be removed.
pub fn remove_partial(folder: &Path, abandoned: impl Fn(&str, Duration) -> bool) -> Result<(), FileError> {
    let failed = |doing| move |error| FileProblem::Io { doing, error }.in_file(folder);
    for entry in fs::read_dir(folder).map_err(failed("listing the folder"))? {
        let entry = entry.map_err(failed("listing the folder"))?;
        let (path, name) = (entry.path(), entry.file_name().to_string_lossy().into_owned());
        let is_partial = path.extension().is_some_and(|extension| extension == PARTIAL_EXTENSION);
        let Some(name) = name.strip_prefix('.').filter(|_| is_partial) else { continue };
        let modified = entry.metadata().and_then(|metadata| metadata.modified());
        let age = modified.ok().and_then(|modified| modified.elapsed().ok()).unwrap_or_default();
        if !abandoned(name, age) {
            continue;
        }
        let removed = if path.is_dir() { fs::remove_dir_all(&path) } else { fs::remove_file(&path) };
        match removed {
            Err(error) if error.kind() != io::ErrorKind::NotFound => {
                return Err(FileProblem::Io { doing: "removing", error }.in_file(&path));
            }
            _ => {}
        }
    }
    Ok(())
}

fn fill(file: File, write: impl FnOnce(&mut BufWriter<File>) -> io::Result<()>) -> io::Result<()> {
    let mut writer = BufWriter::with_capacity(1 << 18, file);
    write(&mut writer)?;
    writer.flush()
}

/// The file in progress. Processes in containers have the same numbers, so another one may have the first name, or may have been killed
/// and left it.
fn create_partial(path: &Path) -> io::Result<(PathBuf, File)> {
    let mut taken = 0;
    loop {
        let partial = partial_path(path)?;
        match OpenOptions::new().write(true).create_new(true).open(&partial) {
            Err(error) if error.kind() == io::ErrorKind::AlreadyExists && taken < NAMES => taken += 1,
            opened => return Ok((partial, opened?)),
        }
    }
}

fn partial_path(path: &Path) -> io::Result<PathBuf> {
    static COUNT: AtomicU64 = AtomicU64::new(0); // distinguishes the threads of this process
    let name = path
        .file_name()
        .ok_or_else(|| io::Error::new(io::ErrorKind::InvalidInput, "expected the name of a file"))?;
    let mut partial = OsString::from(".");
    partial.push(name);
    let count = COUNT.fetch_add(1, Ordering::Relaxed);
    partial.push(format!(".{}-{count}.{PARTIAL_EXTENSION}", std::process::id()));
    Ok(path.with_file_name(partial))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn names(folder: &Path) -> Vec<String> {
        let entries = fs::read_dir(folder).unwrap();
        entries.map(|entry| entry.unwrap().file_name().into_string().unwrap()).collect()
    }

    #[test]
    fn a_file_with_the_same_content_is_recognized() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("same.bin");
        let content: Vec<u8> = (0..40_000_u32).flat_map(u32::to_le_bytes).collect();
        let has = |content: &[u8]| already_has(&path, |file| file.write_all(content));
        assert!(!has(b""), "no file");
        write_file(&path, &content).unwrap();
        assert!(has(&content));
        assert!(!has(&content[..content.len() - 1]) && !has(&[&content[..], b"x"].concat()) && !has(b""));
        let mut changed = content.clone();
        changed[99_999] ^= 1;
        assert!(!has(&changed));
    }

    #[test]
    fn a_failed_write_leaves_the_old_file_and_nothing_else() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.bin");
        write_file(&path, "old").unwrap();
        let error = write_atomically(&path, |writer| {
            writer.write_all(b"new, but")?;
            Err(io::Error::other("the disk is full"))
        })
        .unwrap_err();
        assert!(error.to_string().contains("a.bin: writing: the disk is full"), "{error}");
        assert_eq!(fs::read(&path).unwrap(), b"old");
        assert_eq!(names(folder.path()), ["a.bin"]);
    }

    #[test]
    fn what_a_killed_process_left_is_removed() {
        let folder = tempfile::tempdir().unwrap();
        for name in ["a.bin", ".a.bin.7-0.partial", ".b.bin.7-1.partial", "c.partial", ".d"] {
            fs::write(folder.path().join(name), "x").unwrap();
        }
        fs::create_dir_all(folder.path().join(".step-4.partial/below")).unwrap();
        remove_partial(folder.path(), |name, age| !name.starts_with("b.bin") && age.as_secs() < 3600)
            .unwrap();
        let mut left = names(folder.path());
        left.sort();
        assert_eq!(left, [".b.bin.7-1.partial", ".d", "a.bin", "c.partial"]);
    }

    #[test]
    fn a_name_that_another_container_has_taken_is_left_to_it() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.bin");
        let taken = partial_path(&path).unwrap();
        let number = |path: &Path| -> u64 {
            let name = path.file_stem().unwrap().to_str().unwrap().to_owned();
            name.rsplit_once('-').unwrap().1.parse().unwrap()
        };
        // Other tests count too, so all of the next names are taken.
        for count in number(&taken)..number(&taken) + 50 {
            let name = format!(".a.bin.{}-{count}.partial", std::process::id());
            fs::write(folder.path().join(name), "other").unwrap();
        }
        write_file(&path, "new").unwrap();
        assert_eq!(fs::read(&path).unwrap(), b"new");
        assert_eq!(names(folder.path()).len(), 51);
    }

    #[test]
    fn a_missing_folder_is_named() {
        let folder = tempfile::tempdir().unwrap();
        let error = write_atomically(&folder.path().join("no/a.bin"), |_| Ok(())).unwrap_err();
        assert!(error.to_string().contains("no/a.bin: creating"), "{error}");
        assert!(error.to_string().contains("in a folder that exists"), "{error}");
    }

    #[test]
    fn a_file_with_a_folders_name_is_reported() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("file");
        fs::write(&file, "x").unwrap();
        for path in [file.clone(), file.join("below")] {
            let error = create_folder(&path).unwrap_err().to_string();
            assert!(error.starts_with(path.to_str().unwrap()), "{error}");
            assert!(error.contains("give the path of a folder"), "{error}");
        }
        create_folder(&folder.path().join("new/below")).unwrap();
        create_folder(&folder.path().join("new/below")).unwrap();
    }
}
