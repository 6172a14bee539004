//! Listing folders in natural order, and their contents in messages.

use std::cmp::Ordering;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use srflow_files::{FileError, FileProblem, FlowFormat, IMAGE_EXTENSIONS};

/// Extensions of frames, masks and occlusions.
pub const IMAGES: &[&str] = &IMAGE_EXTENSIONS;

pub const FLOWS: &[&str] = &["flo", "flo5", "png", "png128", "pfm", "npy", "npz", "npz16"];

/// Extensions of videos.
pub const VIDEOS: &[&str] = &["mp4", "avi", "mov", "mkv", "mts", "mpg", "mpeg", "wmv", "webm"];

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

pub const MASKS: &[&str] = &["png", "jpg", "jpeg", "jpe", "jfif", "ppm", "pgm", "pnm", "bmp", "npy"];

/// The files of `dir` with one of the extensions `endings` (case-insensitive), in natural order. Hidden files are skipped.
pub fn files(dir: &Path, endings: &[&str]) -> Result<Vec<PathBuf>, FileError> {
    Ok(visible(dir)?.into_iter().filter(|path| has_ending(path, endings) && path.is_file()).collect())
}

/// Whether the name ends in one of these extensions, in any case.
pub fn has_ending(path: &Path, endings: &[&str]) -> bool {
    let ending = path.extension().and_then(|e| e.to_str()).unwrap_or_default();
    endings.iter().any(|e| e.eq_ignore_ascii_case(ending))
}

/// The pictures in `dir`, in natural order: `frame9` before `frame10`. Hidden files are skipped.
///
/// # Errors
/// When the folder cannot be read.
pub fn pictures(dir: &Path) -> Result<Vec<PathBuf>, FileError> {
    files(dir, IMAGES)
}

/// The flow files in `dir`, in natural order: all but `.png`, which are pictures as often. Hidden files are skipped.
///
/// # Errors
/// When the folder cannot be read.
pub fn flow_files(dir: &Path) -> Result<Vec<PathBuf>, FileError> {
    let formats = FlowFormat::ALL.into_iter().filter(|format| *format != FlowFormat::KittiPng);
    files(dir, &formats.map(FlowFormat::extension).collect::<Vec<&str>>())
}

/// [`files`], or nothing if the folder does not exist.
pub fn files_if_there(dir: &Path, endings: &[&str]) -> Result<Vec<PathBuf>, FileError> {
    if dir.is_dir() { files(dir, endings) } else { Ok(Vec::new()) }
}

/// The folders in `dir`, in natural order. Hidden ones are skipped.
pub fn folders(dir: &Path) -> Result<Vec<PathBuf>, FileError> {
    Ok(visible(dir)?.into_iter().filter(|path| path.is_dir()).collect())
}

fn visible(dir: &Path) -> Result<Vec<PathBuf>, FileError> {
    let failed = |error| FileProblem::Io { doing: "listing the folder", error }.in_file(dir);
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

/// The last component of a path, as text.
pub fn name(path: &Path) -> String {
    path.file_name().map(|n| n.to_string_lossy().into_owned()).unwrap_or_default()
}

/// The last component of a path without its extension, as text.
pub fn stem(path: &Path) -> String {
    path.file_stem().map(|n| n.to_string_lossy().into_owned()).unwrap_or_default()
}

/// What a folder holds in place of pictures that can be read, with advice: `41 .gif files: convert them to PNG`. `None` if it holds none
/// or cannot be read.
pub fn unread_files(dir: &Path) -> Option<String> {
    const PICTURES: [&str; 11] =
        ["gif", "heic", "heif", "avif", "jp2", "jxl", "tga", "exr", "hdr", "dng", "raw"];
    let mut counts: BTreeMap<String, usize> = BTreeMap::new();
    for path in visible(dir).ok()?.iter().filter(|path| path.is_file()) {
        let ending = path.extension().and_then(|ending| ending.to_str()).unwrap_or_default().to_lowercase();
        if PICTURES.contains(&ending.as_str()) || VIDEOS.contains(&ending.as_str()) {
            *counts.entry(ending).or_default() += 1;
        }
    }
    let (ending, count) = counts.iter().max_by_key(|(_, count)| **count)?;
    let files = if *count == 1 { "file" } else { "files" };
    let advice = match VIDEOS.contains(&ending.as_str()) {
        true => "extract its frames as PNG",
        false => "convert to PNG",
    };
    Some(format!("{count} .{ending} {files}, which srflow does not read here: {advice}"))
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
    fn files_that_are_not_read_are_counted() {
        let folder = tempfile::tempdir().unwrap();
        assert_eq!(unread_files(folder.path()), None);
        for name in ["1.gif", "2.GIF", "a.mp4", "notes.txt", "1.png"] {
            std::fs::write(folder.path().join(name), "").unwrap();
        }
        let found = unread_files(folder.path()).unwrap();
        assert_eq!(found, "2 .gif files, which srflow does not read here: convert to PNG");
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
    }
}
