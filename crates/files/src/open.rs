//! Opens untrusted files for reading: only regular files, with a size limit per kind.

use std::fs::{File, Metadata, OpenOptions};
use std::io::Read;
use std::path::{Path, PathBuf};

use crate::{FileError, FileProblem};

/// The kind of a file, which limits its size.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum FileKind {
    /// PNG, JPEG, PPM, BMP, WebP or TIFF.
    Image,
    Flow,
    /// NumPy arrays of any shape.
    Array,
    /// 3D Gaussians.
    Splats,
    /// Vertices and polygons.
    Mesh,
    /// CSV, or lists of splits.
    Table,
    Spreadsheet,
    /// Files written by hand: configurations, cameras.
    Settings,
    /// JSON written by programs: manifests, records, results.
    Json,
    /// A JSON Lines log.
    Log,
    /// Network weights or training state.
    Checkpoint,
    /// A network of another program for one purpose, such as finding faces, or a package with it.
    Network,
    /// A tar of a dataset, of which parts are read.
    Archive,
    /// Any file of a dataset that is published.
    OfDataset,
    /// A video, which another program reads piece by piece: unlimited.
    Video,
}

impl FileKind {
    /// Name in messages, and maximum size in bytes.
    const fn facts(self) -> (&'static str, u64) {
        const MIB: u64 = 1 << 20;
        const GIB: u64 = 1 << 30;
        match self {
            Self::Image => ("an image", 2 * GIB), // 2^27 pixels of 8 bytes, plus overhead
            Self::Flow => ("a flow file", 4 * GIB), // 2^27 pixels of two f64
            Self::Array => ("an array", 8 * GIB),
            Self::Splats => ("a file of 3D Gaussians", 16 * GIB),
            Self::Mesh => ("a mesh", 512 * MIB),
            Self::Table => ("a table", 256 * MIB),
            Self::Spreadsheet => ("a spreadsheet", 16 * MIB), // the published ones are below 0.1 MB
            Self::Settings => ("a file of settings", MIB),
            Self::Json => ("a JSON file", 256 * MIB),
            Self::Log => ("a log", GIB),
            Self::Checkpoint => ("a checkpoint", 16 * GIB),
            Self::Network => ("a network", 256 * MIB),
            Self::Archive => ("a tar", 1024 * GIB), // Hugging Face's limit is 500 GB
            Self::OfDataset => ("a file of a dataset", 1024 * GIB),
            Self::Video => ("a video", u64::MAX),
        }
    }
}

/// The file that another one names, in its folder or below it; `None` for a name that leads elsewhere. Windows' separators count too.
pub fn file_beside(path: &Path, name: &str) -> Option<PathBuf> {
    let name = name.replace('\\', "/");
    let name = name.strip_prefix("./").unwrap_or(&name);
    let is_below = !name.contains(':') && !name.split('/').any(|part| ["", ".", ".."].contains(&part));
    is_below.then(|| path.with_file_name(name))
}

/// Opens a file for reading and returns its size in bytes. Symbolic links are followed.
///
/// # Errors
/// When the file does not exist, is not a regular file (a folder, pipe, socket or device: reading one may never end), or is
/// larger than any plausible file of its kind.
pub fn open_file(path: &Path, kind: FileKind) -> Result<(File, u64), FileError> {
    let failed = |error| FileProblem::Io { doing: "opening", error };
    let open = || {
        // Checked before opening, since opening a device can have side effects, and after, since the file may have been replaced.
        check(&std::fs::metadata(path).map_err(failed)?, kind)?;
        let mut options = OpenOptions::new();
        options.read(true);
        #[cfg(unix)]
        {
            use std::os::unix::fs::OpenOptionsExt as _;
            options.custom_flags(libc::O_NONBLOCK | libc::O_NOCTTY);
        }
        let file = options.open(path).map_err(failed)?;
        let len = check(&file.metadata().map_err(failed)?, kind)?;
        Ok((file, len))
    };
    open().map_err(|problem: FileProblem| problem.in_file(path))
}

/// All bytes of a file.
///
/// # Errors
/// As [`open_file`], and when it cannot be read or grows beyond its limit while being read.
pub fn read_file(path: &Path, kind: FileKind) -> Result<Vec<u8>, FileError> {
    let (file, len) = open_file(path, kind)?;
    read_open(file, len, kind).map_err(|problem| problem.in_file(path))
}

/// All text of a file, without the mark that some editors put in front of UTF-8.
///
/// # Errors
/// As [`read_file`], and when it is not UTF-8.
pub fn read_text(path: &Path, kind: FileKind) -> Result<String, FileError> {
    let text = String::from_utf8(read_file(path, kind)?).map_err(|error| {
        let at = error.utf8_error().valid_up_to();
        let line = error.as_bytes()[..at].iter().filter(|byte| **byte == b'\n').count() + 1;
        let found = format!("the byte {:#04x} in line {line}", error.as_bytes()[at]);
        FileProblem::field("text", "UTF-8 (save it in this encoding)", found).in_file(path)
    })?;
    Ok(match text.strip_prefix('\u{feff}') {
        Some(text) => text.to_owned(),
        None => text,
    })
}

fn read_open(file: File, len: u64, kind: FileKind) -> Result<Vec<u8>, FileProblem> {
    let (_, most) = kind.facts();
    let mut bytes = Vec::new();
    let expected = usize::try_from(len).unwrap_or(usize::MAX);
    bytes.try_reserve_exact(expected).map_err(|_| {
        FileProblem::field("file size", "memory for it", format!("{len} bytes, more than is available"))
    })?;
    file.take(most.saturating_add(1)).read_to_end(&mut bytes).map_err(FileProblem::reading)?;
    check_len(bytes.len() as u64, kind)?;
    Ok(bytes)
}

/// Its length in bytes.
fn check(metadata: &Metadata, kind: FileKind) -> Result<u64, FileProblem> {
    if metadata.is_file() {
        return check_len(metadata.len(), kind);
    }
    let (name, _) = kind.facts();
    Err(FileProblem::field("file", format!("{name} in a regular file"), special(metadata)))
}

fn check_len(len: u64, kind: FileKind) -> Result<u64, FileProblem> {
    let (name, most) = kind.facts();
    if len <= most {
        return Ok(len);
    }
    let expected = format!("{name} of at most {} MiB", most >> 20);
    Err(FileProblem::field("file size", expected, format!("{} MiB", len.div_ceil(1 << 20))))
}

/// What it is instead of a regular file, and advice.
fn special(metadata: &Metadata) -> &'static str {
    if metadata.is_dir() {
        return "a folder: name a file in it";
    }
    #[cfg(unix)]
    {
        use std::os::unix::fs::FileTypeExt as _;
        let file_type = metadata.file_type();
        if file_type.is_fifo() {
            return "a pipe: write its output to a file first";
        } else if file_type.is_socket() {
            return "a socket";
        } else if file_type.is_char_device() || file_type.is_block_device() {
            return "a device";
        }
    }
    "something else"
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_file_is_read_whole() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.json");
        std::fs::write(&path, "{\n\"ü\": 1}").unwrap();
        assert_eq!(read_file(&path, FileKind::Json).unwrap(), "{\n\"ü\": 1}".as_bytes());
        assert_eq!(read_text(&path, FileKind::Json).unwrap(), "{\n\"ü\": 1}");
        std::fs::write(&path, b"{\n\xff}").unwrap();
        let error = read_text(&path, FileKind::Json).unwrap_err().to_string();
        assert!(
            error.contains("a.json: text: expected UTF-8") && error.contains("0xff in line 2"),
            "{error}"
        );
    }

    #[test]
    fn oversized_files_are_refused_without_reading() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("config.toml");
        File::create(&path).unwrap().set_len((1 << 20) + 1).unwrap();
        let error = read_file(&path, FileKind::Settings).unwrap_err().to_string();
        assert!(error.contains("expected a file of settings of at most 1 MiB, found 2 MiB"), "{error}");
        File::create(&path).unwrap().set_len(1 << 20).unwrap();
        assert_eq!(read_file(&path, FileKind::Settings).unwrap().len(), 1 << 20);
    }

    #[test]
    fn only_files_beside_or_below_are_named() {
        let found = |name| file_beside(Path::new("heads/a.obj"), name);
        assert_eq!(found("a.mtl"), Some("heads/a.mtl".into()));
        assert_eq!(found(r".\maps\skin.png"), Some("heads/maps/skin.png".into()));
        for name in ["", "../a.mtl", "/etc/passwd", r"C:\a.mtl", "maps/../../a.mtl", "a//b"] {
            assert_eq!(found(name), None, "{name}");
        }
    }

    #[test]
    fn a_folder_is_refused() {
        let folder = tempfile::tempdir().unwrap();
        let error = open_file(folder.path(), FileKind::Flow).unwrap_err().to_string();
        assert!(error.contains("expected a flow file in a regular file, found a folder"), "{error}");
    }

    #[cfg(unix)]
    #[test]
    fn pipes_and_devices_are_refused() {
        use std::os::unix::ffi::OsStrExt as _;
        let folder = tempfile::tempdir().unwrap();
        let pipe = folder.path().join("pipe");
        let name = std::ffi::CString::new(pipe.as_os_str().as_bytes()).unwrap();
        // SAFETY: `name` ends with a zero and lives until the call returns.
        assert_eq!(unsafe { libc::mkfifo(name.as_ptr(), 0o600) }, 0);
        let socket = folder.path().join("socket");
        let _listener = std::os::unix::net::UnixListener::bind(&socket).unwrap();
        let link = folder.path().join("link");
        std::os::unix::fs::symlink(&pipe, &link).unwrap();
        for (path, found) in [
            (pipe.as_path(), "a pipe"),
            (&link, "a pipe"),
            (&socket, "a socket"),
            (Path::new("/dev/zero"), "a device"),
        ] {
            let error = open_file(path, FileKind::Image).unwrap_err().to_string();
            assert!(error.contains(&format!("found {found}")), "{error}");
        }
    }
}
