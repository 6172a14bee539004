//! SHA-256 of files, and `SHA256SUMS`, the file that lists them for `sha256sum -c`.

use std::io;
use std::path::{Component, Path};

use sha2::{Digest, Sha256};

use crate::{FileError, FileKind, FileProblem, open_file};

/// Name of the file with the SHA-256 of all others in a folder.
pub const SHA256SUMS: &str = "SHA256SUMS";

/// The SHA-256 of a file.
///
/// # Errors
/// When it cannot be read.
pub fn sha256_of_file(path: &Path, kind: FileKind) -> Result<[u8; 32], FileError> {
    let (mut file, _) = open_file(path, kind)?;
    let mut hash = Sha256::new();
    io::copy(&mut file, &mut hash).map_err(|error| FileProblem::reading(error).in_file(path))?;
    Ok(hash.finalize().into())
}

/// The digits of a hash, in lower case.
pub fn hexadecimal(hash: impl AsRef<[u8]>) -> String {
    hash.as_ref().iter().map(|byte| format!("{byte:02x}")).collect()
}

/// The line of [`SHA256SUMS`] for a file, whose name has slashes on all systems.
pub fn sha256sums_line(digits: &str, name: &str) -> String {
    format!("{digits}  {name}\n")
}

/// Digits and name of a line of [`SHA256SUMS`]; `None` for other text, and for names outside of the folder.
pub fn parse_sha256sums_line(line: &str) -> Option<(&str, &Path)> {
    let (digits, name) = line.strip_suffix('\n').unwrap_or(line).split_once("  ")?;
    let is_hash = digits.len() == 64 && digits.bytes().all(|byte| byte.is_ascii_hexdigit());
    let name = Path::new(name);
    let is_inside = name.components().all(|part| matches!(part, Component::Normal(_)));
    (is_hash && is_inside && name.file_name().is_some()).then_some((digits, name))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lines_are_read_as_they_are_written_and_names_stay_in_the_folder() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("abc");
        std::fs::write(&path, "abc").unwrap();
        let digits = hexadecimal(sha256_of_file(&path, FileKind::OfDataset).unwrap());
        // FIPS 180-4, first example.
        assert_eq!(digits, "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad");
        let line = sha256sums_line(&digits, "a/b c");
        assert_eq!(parse_sha256sums_line(&line), Some((digits.as_str(), Path::new("a/b c"))));
        for name in ["/etc/passwd", "../up", "a/../../b", ""] {
            assert_eq!(parse_sha256sums_line(&sha256sums_line(&digits, name)), None, "{name}");
        }
        for line in ["", "text", &line[1..], &line.replace("ba78", "zz78")] {
            assert_eq!(parse_sha256sums_line(line), None, "{line}");
        }
    }
}
