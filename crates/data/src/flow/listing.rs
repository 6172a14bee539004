//! Listing folders in natural order, and messages about missing files.

use std::cmp::Ordering;
use std::collections::BTreeMap;
use std::collections::btree_map::Entry;
use std::path::{Path, PathBuf};

use srflow_files::{FlowFormat, IMAGE_EXTENSIONS};

use super::error::DatasetError;
use super::gaps::Gaps;

/// Extensions of frames, masks and occlusions.
pub const IMAGES: &[&str] = &IMAGE_EXTENSIONS;

/// Extensions of flow files.
pub const FLOWS: &[&str] = &["flo", "flo5", "png", "png128", "pfm", "npy", "npz", "npz16"];

/// Natural order: runs of digits compare by value, so that `frame10` comes after `frame9`.
pub fn natural_order(a: &str, b: &str) -> Ordering {
    let (mut a_rest, mut b_rest) = (a.as_bytes(), b.as_bytes());
    loop {
        let (a_part, a_next) = leading_part(a_rest);
        let (b_part, b_next) = leading_part(b_rest);
        let order = match (a_part.first(), b_part.first()) {
            (Some(x), Some(y)) if x.is_ascii_digit() && y.is_ascii_digit() => {
                let (x, y) = (without_zeros(a_part), without_zeros(b_part));
                x.len().cmp(&y.len()).then_with(|| x.cmp(y))
            }
            (None, None) => return a.cmp(b), // equal except for leading zeros
            _ => a_part.cmp(b_part),
        };
        if order != Ordering::Equal {
            return order;
        }
        (a_rest, b_rest) = (a_next, b_next);
    }
}

/// The leading run of digits, or the leading run of anything else, and the rest.
fn leading_part(text: &[u8]) -> (&[u8], &[u8]) {
    let digits = text.first().is_some_and(u8::is_ascii_digit);
    let end = text.iter().position(|c| c.is_ascii_digit() != digits).unwrap_or(text.len());
    text.split_at(end)
}

fn without_zeros(digits: &[u8]) -> &[u8] {
    let start = digits.iter().position(|&c| c != b'0').unwrap_or(digits.len());
    &digits[start..]
}

/// Extensions of masks.
pub const MASKS: &[&str] = &["png", "jpg", "jpeg", "ppm", "pgm", "bmp", "npy"];

/// The files of `dir` with one of the extensions `endings` (case-insensitive), in natural order. Hidden files are skipped.
pub fn files(dir: &Path, endings: &[&str]) -> Result<Vec<PathBuf>, DatasetError> {
    let has_ending = |path: &Path| {
        let ending = path.extension().and_then(|e| e.to_str()).unwrap_or_default();
        endings.iter().any(|e| e.eq_ignore_ascii_case(ending))
    };
    Ok(visible(dir)?.into_iter().filter(|path| has_ending(path) && path.is_file()).collect())
}

/// The pictures in `dir`, in natural order: `frame9` before `frame10`. Hidden files are skipped.
///
/// # Errors
/// When the folder cannot be read.
pub fn pictures(dir: &Path) -> Result<Vec<PathBuf>, DatasetError> {
    files(dir, IMAGES)
}

/// The flow files in `dir`, in natural order: all but `.png`, which are pictures as often. Hidden files are skipped.
///
/// # Errors
/// When the folder cannot be read.
pub fn flow_files(dir: &Path) -> Result<Vec<PathBuf>, DatasetError> {
    let formats = FlowFormat::ALL.into_iter().filter(|format| *format != FlowFormat::KittiPng);
    files(dir, &formats.map(FlowFormat::extension).collect::<Vec<&str>>())
}

/// [`files`], or nothing if the folder does not exist.
pub fn files_if_there(dir: &Path, endings: &[&str]) -> Result<Vec<PathBuf>, DatasetError> {
    if dir.is_dir() { files(dir, endings) } else { Ok(Vec::new()) }
}

/// The folders in `dir`, in natural order. Hidden ones are skipped.
pub fn folders(dir: &Path) -> Result<Vec<PathBuf>, DatasetError> {
    Ok(visible(dir)?.into_iter().filter(|path| path.is_dir()).collect())
}

fn visible(dir: &Path) -> Result<Vec<PathBuf>, DatasetError> {
    let failed = |error| DatasetError::Io { path: dir.to_owned(), error };
    let mut named = Vec::new();
    for entry in std::fs::read_dir(dir).map_err(failed)? {
        let entry = entry.map_err(failed)?;
        let name = entry.file_name().to_string_lossy().into_owned();
        if !name.starts_with('.') {
            named.push((name, entry.path()));
        }
    }
    named.sort_by(|a, b| natural_order(&a.0, &b.0));
    Ok(named.into_iter().map(|(_, path)| path).collect())
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

/// The last component of a path, as text.
pub fn name(path: &Path) -> String {
    path.file_name().map(|n| n.to_string_lossy().into_owned()).unwrap_or_default()
}

/// The last component of a path without its extension, as text.
pub fn stem(path: &Path) -> String {
    path.file_stem().map(|n| n.to_string_lossy().into_owned()).unwrap_or_default()
}

/// The files of a folder by the last number in their names: `OpticalFlowIntoFuture_0006_L.pfm` is 6.
pub type Numbered = BTreeMap<u64, PathBuf>;

/// The files of `dir` by number. A name without one and a number that occurs twice are gaps.
pub fn numbered(dir: &Path, endings: &[&str], gaps: &mut Gaps) -> Result<Numbered, DatasetError> {
    let mut found = Numbered::new();
    for path in files(dir, endings)? {
        match last_number(&stem(&path)) {
            Some(number) => insert_once(&mut found, number, path, gaps),
            None => gaps.push(format!("{}: no frame number in its name", gaps.shown(&path))),
        }
    }
    Ok(found)
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

pub fn last_number(stem: &str) -> Option<u64> {
    let end = stem.rfind(|c: char| c.is_ascii_digit())? + 1;
    let start = stem[..end]
        .rfind(|c: char| !c.is_ascii_digit())
        .map_or(0, |at| at + stem[at..].chars().next().map_or(1, char::len_utf8));
    stem[start..end].parse().ok()
}

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

/// A folder one or two levels up or down from `dir` that contains `needed`.
pub fn elsewhere(dir: &Path, needed: &str) -> Option<PathBuf> {
    let full = std::path::absolute(dir).ok()?;
    let above = full.ancestors().skip(1).take(2).map(Path::to_owned);
    let below = folders(dir).unwrap_or_default();
    let further: Vec<PathBuf> = below.iter().flat_map(|d| folders(d).unwrap_or_default()).collect();
    above.chain(below).chain(further).find(|place| place.join(needed).exists())
}

/// A short list of a folder's contents.
pub fn contents(dir: &Path) -> String {
    const NAMED: usize = 6;
    if !dir.exists() {
        return format!("but there is no {}", dir.display());
    }
    if !dir.is_dir() {
        return format!("but {} is a file; a folder is expected", dir.display());
    }
    let found: Vec<String> = match visible(dir) {
        Ok(paths) => paths.iter().map(|path| name(path)).collect(),
        Err(error) => return format!("but cannot list {error}"),
    };
    match found.len() {
        0 => format!("but {} is empty", dir.display()),
        n if n > NAMED => {
            format!("but {} holds {} and {} more", dir.display(), found[..NAMED].join(", "), n - NAMED)
        }
        _ => format!("but {} holds only {}", dir.display(), found.join(", ")),
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    #[test]
    fn every_flow_format_is_found() {
        for format in srflow_files::FlowFormat::ALL {
            assert!(FLOWS.contains(&format.extension()), "{format}");
        }
    }

    #[test]
    fn digits_compare_by_value() {
        let mut names = ["a10", "a9", "a010", "a", "b1", "a9b", "10", "9", ""];
        names.sort_by(|a, b| natural_order(a, b));
        assert_eq!(names, ["", "9", "10", "a", "a9", "a9b", "a010", "a10", "b1"]);
    }

    #[test]
    fn the_last_number_of_a_name_is_its_frame() {
        let numbers =
            ["OpticalFlowIntoFuture_0006_L", "000030_0010", "é12é", "7", "none", "", "99999999999999999999"];
        assert_eq!(numbers.map(last_number), [Some(6), Some(10), Some(12), Some(7), None, None, None]);
    }

    proptest! {
        #[test]
        fn natural_order_is_an_order(names in prop::collection::vec("[a0-1é_-]{0,6}", 3)) {
            let [a, b, c] = &names[..] else { unreachable!() };
            prop_assert_eq!(natural_order(a, b), natural_order(b, a).reverse());
            prop_assert_eq!(natural_order(a, b) == Ordering::Equal, a == b);
            if natural_order(a, b).is_le() && natural_order(b, c).is_le() {
                prop_assert!(natural_order(a, c).is_le());
            }
        }

        #[test]
        fn a_name_has_a_number_when_it_has_a_digit(name in ".{0,12}") {
            prop_assert_eq!(last_number(&name).is_some(), name.bytes().any(|c| c.is_ascii_digit()));
        }
    }
}
