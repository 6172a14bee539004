//! The files and folders that settings name: what they contain, and the fingerprint by which a dataset records them.
//! Errors name the `field` and what was `expected` of it.

use std::path::Path;

use srflow_files::IMAGE_EXTENSIONS;

use crate::RenderError;
use crate::error::require;

/// Names and sizes of the files in a folder, sorted by name.
fn list_files(
    dir: &Path,
    field: &'static str,
    expected: &'static str,
) -> Result<Vec<(String, u64)>, RenderError> {
    let failed = |error| RenderError::Folder { field, path: dir.to_owned(), error, expected };
    let mut files = Vec::new();
    for entry in std::fs::read_dir(dir).map_err(failed)? {
        let entry = entry.map_err(failed)?;
        let metadata = std::fs::metadata(entry.path()).map_err(failed)?;
        if metadata.is_file() {
            files.push((entry.file_name().to_string_lossy().into_owned(), metadata.len()));
        }
    }
    files.sort();
    Ok(files)
}

/// Name and size of a file, or of the files in a folder.
///
/// # Errors
/// When it cannot be read.
pub(crate) fn files_at(
    path: &Path,
    field: &'static str,
    expected: &'static str,
) -> Result<Vec<(String, u64)>, RenderError> {
    let failed = |error| RenderError::Folder { field, path: path.to_owned(), error, expected };
    let metadata = std::fs::metadata(path).map_err(failed)?;
    if metadata.is_dir() {
        return list_files(path, field, expected);
    }
    let name = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
    Ok(vec![(name, metadata.len())])
}

/// Names and sizes of the image files in a folder, by name.
///
/// # Errors
/// When the folder cannot be read or has no image.
pub(crate) fn images_in(
    dir: &Path,
    field: &'static str,
    expected: &'static str,
) -> Result<Vec<(String, u64)>, RenderError> {
    let mut files = list_files(dir, field, expected)?;
    files.retain(|(name, _)| {
        let ending = name.rsplit_once('.').map_or("", |(_, ending)| ending);
        IMAGE_EXTENSIONS.iter().any(|known| known.eq_ignore_ascii_case(ending))
    });
    let expected = format!("a folder with images ({})", IMAGE_EXTENSIONS.join(", "));
    require(field, dir.display(), expected, !files.is_empty())?;
    Ok(files)
}

/// A short hash of the names and sizes of files (FNV-1a), independent of their folder.
pub(crate) fn fingerprint(files: &[(String, u64)]) -> String {
    let text: String = files.iter().map(|(name, size)| format!("{name} {size}\n")).collect();
    let hash = text
        .bytes()
        .fold(0xcbf2_9ce4_8422_2325_u64, |h, b| (h ^ u64::from(b)).wrapping_mul(0x0000_0100_0000_01b3));
    format!("{} files, fingerprint {hash:016x}", files.len())
}
