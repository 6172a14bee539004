//! The heads of datasets: where they are, and what is recorded of their files.

use glam::DVec3;
use srflow_avatar::HeadSource;

use crate::RenderError;
use crate::setting_files::{files_at, fingerprint};

/// A point between chin and crown, independent of the subject, metres.
pub(crate) fn centre(head: &HeadSource) -> DVec3 {
    match head.kind() {
        "ict" => DVec3::new(0.0, 0.035, 0.02),
        _ => DVec3::new(0.0, 0.03, 0.01),
    }
}

/// The head as recorded with a dataset, independent of where its files are.
///
/// # Errors
/// When its files cannot be read.
pub(crate) fn recorded(head: &HeadSource) -> Result<String, RenderError> {
    match head.is_builtin() {
        true => Ok(head.kind().to_owned()),
        false => Ok(format!("{}, {}", head.kind(), fingerprint(&head_files(head)?))),
    }
}

/// Names and sizes of the files of a head that is not made by code.
fn head_files(head: &HeadSource) -> Result<Vec<(String, u64)>, RenderError> {
    const EXPECTED: &str =
        "the file or folder of a head model, as docs/reference/avatar-files.md describes it";
    let files = head.paths().into_iter().map(|path| files_at(&path, "head", EXPECTED));
    Ok(files.collect::<Result<Vec<_>, _>>()?.concat())
}
