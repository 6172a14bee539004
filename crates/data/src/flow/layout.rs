//! The folders and files that the layout of a dataset asks for.

use std::collections::BTreeMap;
use std::collections::btree_map::Entry;
use std::path::{Path, PathBuf};

use srflow_core::excerpt;

use super::error::DatasetError;
use super::gaps::Gaps;
use crate::FrameNames;
use crate::listing::{contents, elsewhere, files, folders, name};

/// Checks that `dir` contains `needed` (a relative path with `/` separators). Otherwise the error says what `dir` contains on
/// the way there, and where `needed` is if that is one or two levels up or down.
pub fn require(kind: &str, dir: &Path, needed: &str) -> Result<PathBuf, DatasetError> {
    let wanted = dir.join(needed);
    if wanted.exists() {
        return Ok(wanted);
    }
    let hint = elsewhere(dir, needed)
        .map(|place| format!(". It is under {0}: give {kind}:{0}", place.display()))
        .unwrap_or_default();
    let looked_for = wanted.display().to_string();
    let reached = wanted.ancestors().find(|place| place.is_dir() && place.starts_with(dir)).unwrap_or(dir);
    Err(DatasetError::NotThere { kind: kind.to_owned(), looked_for, found: contents(reached), hint })
}

/// The error for a pattern that matches no file of `dir`.
pub fn nothing_fits(kind: &str, dir: &Path, pattern: &str, hint: &str) -> DatasetError {
    DatasetError::NotThere {
        kind: kind.to_owned(),
        looked_for: dir.join(pattern).display().to_string(),
        found: contents(dir),
        hint: if hint.is_empty() { String::new() } else { format!(". {hint}") },
    }
}

/// The folders two levels below `frames` of `dir`, as `PART/OUTER/INNER` for each of `parts`. Folders that lie so below `flows`
/// and not there are gaps.
pub fn places(
    kind: &str,
    dir: &Path,
    parts: &[&str],
    [frames, flows]: [&str; 2],
    gaps: &mut Gaps,
) -> Result<Vec<String>, DatasetError> {
    let mut places = Vec::new();
    for part in parts {
        let frames = require(kind, dir, &format!("{frames}/{part}"))?;
        let flows = require(kind, dir, &format!("{flows}/{part}"))?;
        folders_without(&flows, &frames, gaps)?;
        for outer in folders(&frames)? {
            folders_without(&flows.join(name(&outer)), &outer, gaps)?;
            let inner = folders(&outer)?;
            places.extend(inner.iter().map(|inner| format!("{part}/{}/{}", name(&outer), name(inner))));
        }
    }
    Ok(places)
}

/// Reports as gaps the folders of `dir` that have no counterpart of the same name in `counterpart`. `dir` need not exist.
pub fn folders_without(dir: &Path, counterpart: &Path, gaps: &mut Gaps) -> Result<(), DatasetError> {
    let found = if dir.is_dir() { folders(dir)? } else { Vec::new() };
    for folder in found {
        let other = counterpart.join(name(&folder));
        if !other.is_dir() {
            gaps.push(format!("{}: no folder {}", gaps.shown(&folder), gaps.shown(&other)));
        }
    }
    Ok(())
}

/// The files of a folder by the numbers in their names (see [`FrameNames`]): `OpticalFlowIntoFuture_0006_L.pfm` is 6.
pub type Numbered = BTreeMap<u64, PathBuf>;

/// The files of `dir` by number. A name without one, a number that occurs twice and copies are gaps.
pub fn numbered(dir: &Path, endings: &[&str], gaps: &mut Gaps) -> Result<Numbered, DatasetError> {
    let mut found = Numbered::new();
    let frames = FrameNames::new(files(dir, endings)?);
    for (path, number) in frames.files().iter().zip(frames.numbers()) {
        match number.and_then(|number| u64::try_from(number).ok()) {
            Some(number) => insert_once(&mut found, number, path.clone(), gaps),
            None => gaps.push(format!("{}: no frame number in its name", gaps.shown(path))),
        }
    }
    copies_are_gaps(&frames, gaps);
    Ok(found)
}

/// Reports as gaps the copies among the frames of a folder.
pub fn copies_are_gaps(frames: &FrameNames, gaps: &mut Gaps) {
    for (copy, original) in frames.copies() {
        let original = excerpt(original);
        gaps.push(format!(
            "{}: its name is that of a copy of {original}; move it elsewhere",
            gaps.shown(copy)
        ));
    }
}

/// Adds a file under its key; where another has the key already, that is a gap.
pub fn insert_once<K: Ord>(found: &mut BTreeMap<K, PathBuf>, key: K, path: PathBuf, gaps: &mut Gaps) {
    match found.entry(key) {
        Entry::Vacant(free) => _ = free.insert(path),
        Entry::Occupied(other) => {
            gaps.push(format!("{} exists twice, also as {}", gaps.shown(&path), name(other.get())));
        }
    }
}

/// [`numbered`], or nothing if the folder does not exist.
pub fn numbered_if_there(dir: &Path, endings: &[&str], gaps: &mut Gaps) -> Result<Numbered, DatasetError> {
    if dir.is_dir() { numbered(dir, endings, gaps) } else { Ok(Numbered::new()) }
}
