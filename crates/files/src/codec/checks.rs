//! What several formats check, and say of what they find.

use std::fs::File;
use std::io::BufReader;
use std::path::Path;

use zip::result::ZipError;

use crate::{FileError, FileKind, FileProblem, open_file};
use srflow_core::FlowField;

/// Opens a file and returns it with its length in bytes.
pub(crate) fn read_with<T>(
    path: &Path,
    kind: FileKind,
    read: impl FnOnce(&mut BufReader<File>, u64) -> Result<T, FileProblem>,
) -> Result<T, FileError> {
    let (file, len) = open_file(path, kind)?;
    read(&mut BufReader::with_capacity(1 << 16, file), len).map_err(|problem| problem.in_file(path))
}

/// # Errors
/// When a pixel is neither known (both components finite) nor unknown (both NaN).
pub(super) fn check_finite_or_unknown(flow: &FlowField) -> Result<(), FileProblem> {
    check_pixels(flow, "finite numbers, or NaN twice where the flow is unknown", |[u, v]| {
        (u.is_finite() && v.is_finite()) || (u.is_nan() && v.is_nan())
    })
}

/// # Errors
/// Names the first pixel for which `fine` is false.
pub(super) fn check_pixels(
    flow: &FlowField,
    expected: &'static str,
    fine: impl Fn([f32; 2]) -> bool,
) -> Result<(), FileProblem> {
    match flow.pixels().iter().position(|pixel| !fine(*pixel)) {
        None => Ok(()),
        Some(index) => {
            let (x, y) = (index % flow.width(), index / flow.width());
            let [u, v] = flow.pixels()[index];
            Err(FileProblem::Pixel { x, y, expected, found: format!("({u}, {v})") })
        }
    }
}

/// The first bytes of a file as readable text.
pub(super) fn quote(start: &[u8]) -> String {
    match start.get(..start.len().min(8)) {
        None | Some([]) => "an empty file".to_owned(),
        Some(start) => format!("\"{}\"", start.escape_ascii()),
    }
}

/// What is wrong with an archive of arrays.
pub(super) fn broken(error: ZipError) -> FileProblem {
    let expected = "a valid .npz or .npz16 file";
    FileProblem::field("archive", expected, error.to_string())
}
