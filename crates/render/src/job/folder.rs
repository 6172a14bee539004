//! The output folder: which dataset it belongs to, and the leftovers of an interrupted run.

use std::fs;
use std::io;
use std::path::Path;
use std::time::Duration;

use serde_json::Value;
use srflow_core::excerpt;
use srflow_files::{
    FileKind, SHA256SUMS, create_folder, parse_error_in_words, read_text, remove_partial, write_file,
};

use super::layout::Layout as _;
use super::plan::{Plan, Run};
use crate::RenderError;

/// Minimum age of a partial file before it counts as left by an interrupted run: another shard may be working in the same
/// folder.
const ABANDONED_AFTER: Duration = Duration::from_secs(60);

/// Claims `dir` for the planned dataset: a new folder, or one with the same dataset, begun before. `force` deletes another
/// dataset there.
pub fn claim<P: Plan>(dir: &Path, plan: &P, force: bool) -> Result<(), RenderError> {
    let name = P::Layout::MANIFEST;
    let path = dir.join(name);
    if force && path.exists() {
        let found = read_text(&path, FileKind::Json)?;
        remove(&dir.join(SHA256SUMS))?;
        plan.delete(dir, &found)?;
        create_folder(dir)?;
        return Ok(write_file(&path, plan.manifest())?);
    }
    claim_as(dir, name, &plan.manifest())
}

/// Claims `dir` for a dataset whose manifest, of this name, is `planned`.
pub(crate) fn claim_as(dir: &Path, name: &'static str, planned: &str) -> Result<(), RenderError> {
    let path = dir.join(name);
    let has_others =
        !path.exists() && has_visible_entries(dir).map_err(|error| RenderError::io(dir, error))?;
    // Another part may have begun between the two looks: it writes the manifest before anything else.
    if path.exists() {
        let found = read_text(&path, FileKind::Json)?;
        return difference(&path, &found, planned)?.map_or(Ok(()), Err);
    }
    if has_others {
        return Err(RenderError::NotADataset { path: dir.to_owned(), manifest: name });
    }
    create_folder(dir)?;
    Ok(write_file(&path, planned)?)
}

/// Whether a folder contains anything except hidden files, which other shards may be writing.
fn has_visible_entries(dir: &Path) -> io::Result<bool> {
    let entries = match fs::read_dir(dir) {
        Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(false),
        entries => entries?,
    };
    for entry in entries {
        if !entry?.file_name().to_string_lossy().starts_with('.') {
            return Ok(true);
        }
    }
    Ok(false)
}

/// The error that names the first field in which the manifest at `path` and the planned one differ.
fn difference(path: &Path, found: &str, planned: &str) -> Result<Option<RenderError>, RenderError> {
    let parse = |text| {
        serde_json::from_str::<Value>(text).map_err(|error| RenderError::Malformed {
            path: path.to_owned(),
            reason: parse_error_in_words(&error),
        })
    };
    let (found, planned) = (parse(found)?, parse(planned)?);
    if found == planned {
        return Ok(None);
    }
    let other = || {
        let name = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
        (name, "of another kind".to_owned(), "what this command writes".to_owned())
    };
    let (field, found, asked) = first_difference(&found, &planned).unwrap_or_else(other);
    let dir = path.parent().unwrap_or(path).to_owned();
    Ok(Some(RenderError::OtherDataset { path: dir, field, found, asked }))
}

/// The name of the first field in which two objects differ, and its values, abbreviated.
pub(crate) fn first_difference(found: &Value, planned: &Value) -> Option<(String, String, String)> {
    let (Value::Object(there), Value::Object(asked)) = (found, planned) else { return None };
    // A nested difference is more specific than the field around it, so single values come first.
    let nested = |value: &Value| value.is_object() || value.is_array();
    let names: std::collections::BTreeSet<&String> = there.keys().chain(asked.keys()).collect();
    let mut differing: Vec<_> = names
        .into_iter()
        .map(|name| (name, &found[name], &planned[name]))
        .filter(|(_, a, b)| a != b)
        .collect();
    differing.sort_by_key(|(_, a, b)| (nested(a) || nested(b), a.is_array() || b.is_array()));
    let (name, a, b) = differing.into_iter().next()?;
    if let Some(within) = first_difference(a, b) {
        return Some(within);
    }
    let brief = |value: &Value| match value {
        // Settings at their defaults are left out of some manifests.
        Value::Null => "(not given)".to_owned(),
        value if nested(value) => "other values".to_owned(),
        value => excerpt(&value.to_string()),
    };
    Some((name.clone(), brief(a), if nested(b) { "those of its arguments".to_owned() } else { brief(b) }))
}

/// Creates the folders of `runs`, and removes partial files of an interrupted run.
pub fn tidy<P: Plan>(dir: &Path, plan: &P, runs: &[Run]) -> Result<(), RenderError> {
    remove_partial(dir, |_, age| age >= ABANDONED_AFTER)?;
    for run in runs {
        for folder in plan.folders(dir, run) {
            create_folder(&folder)?;
            remove_partial(&folder, |name, _| plan.makes(run, &folder, name))?;
        }
    }
    Ok(())
}

/// Removes a file, or a folder with all that is in it, which may already be gone.
///
/// # Errors
/// When it cannot be removed.
pub(crate) fn remove(path: &Path) -> Result<(), RenderError> {
    match if path.is_dir() { fs::remove_dir_all(path) } else { fs::remove_file(path) } {
        Err(error) if error.kind() != io::ErrorKind::NotFound => Err(RenderError::io(path, error)),
        _ => Ok(()),
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Barrier;

    use super::*;

    #[test]
    fn parts_that_begin_at_once_share_a_folder() {
        let parent = tempfile::tempdir().unwrap();
        for round in 0..40 {
            let dir = parent.path().join(round.to_string());
            let start = Barrier::new(8);
            let claimed = std::thread::scope(|scope| {
                let begin = |number: usize| {
                    let (dir, start) = (&dir, &start);
                    scope.spawn(move || {
                        start.wait();
                        claim_as(dir, "a.json", "{}").map(|()| fs::create_dir(dir.join(number.to_string())))
                    })
                };
                let threads: Vec<_> = (0..8).map(begin).collect();
                threads.into_iter().map(|thread| thread.join().unwrap()).collect::<Vec<_>>()
            });
            for result in claimed {
                result.unwrap().unwrap();
            }
        }
        fs::create_dir_all(parent.path().join("other/photographs")).unwrap();
        assert!(matches!(
            claim_as(&parent.path().join("other"), "a.json", "{}"),
            Err(RenderError::NotADataset { .. })
        ));
    }
}
