//! Locating the frames of clips, and finding missing ones.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use srflow_core::excerpt;

use super::{Annotation, Clip, DropReason, Dropped, MicroExpressionError, MissingFrames};
use crate::{FrameNames, listing};

/// The folders of a dataset's clips, or the videos, in the annotations' order; they need not exist.
pub struct ClipFolders {
    pub folders: Vec<PathBuf>,
    /// The parent of the subjects' folders.
    pub root: PathBuf,
    /// The published form of the dataset.
    pub form: &'static str,
    /// Whether a folder holds the frames of its clip alone. If they are as many as from onset to offset but numbered otherwise, the first
    /// is the onset.
    pub alone: bool,
}

/// The first of `places` below `dir` (name and form) that contains the folder of any clip. `folders` are where a clip may be below such a
/// place; the first that exists counts.
pub fn below<const N: usize>(
    kind: &'static str,
    dir: &Path,
    places: &[(&str, &'static str)],
    annotations: &[Annotation],
    folders: impl Fn(&Path, &Annotation) -> [PathBuf; N],
) -> Result<ClipFolders, MicroExpressionError> {
    let folder = |root: &Path, annotation: &Annotation| {
        let folders = folders(root, annotation);
        folders.iter().find(|folder| folder.exists()).unwrap_or(&folders[0]).clone()
    };
    for &(place, form) in places {
        let root = if place.is_empty() { dir.to_owned() } else { dir.join(place) };
        let folders: Vec<PathBuf> = annotations.iter().map(|annotation| folder(&root, annotation)).collect();
        if folders.iter().any(|folder| folder.exists()) {
            return Ok(ClipFolders { folders, root, form, alone: false });
        }
    }
    let first = annotations.first().map(|annotation| folder(Path::new(""), annotation)).unwrap_or_default();
    let hint = match listing::elsewhere(dir, &first.display().to_string()) {
        Some(place) => format!("It is under {0}: give {kind}:{0}", place.display()),
        None => "Give the folder that contains the subjects' folders".to_owned(),
    };
    Err(MicroExpressionError::NoFolders {
        kind,
        looked_for: dir.join(first).display().to_string(),
        found: format!("{}. {hint}", listing::contents(dir)),
    })
}

/// Pictures of a folder by the numbers in their names (see [`FrameNames`]). Pictures without a number, with a negative one, and copies are
/// not part of the recording.
pub fn numbered_frames(folder: &Path) -> Result<BTreeMap<u64, PathBuf>, MicroExpressionError> {
    let names = FrameNames::new(listing::pictures(folder)?);
    names.notes().for_each(|note| log::warn!("{note}"));
    let mut frames = BTreeMap::new();
    let numbered: Vec<(i64, &PathBuf)> = names
        .numbers()
        .into_iter()
        .zip(names.files())
        .filter_map(|(number, path)| Some((number?, path)))
        .collect();
    if let [(number, first), .., (_, last)] = &numbered[..]
        && numbered.iter().all(|(other, _)| other == number)
        && numbered.len() > 2
    {
        let reason = format!(
            "expected names with the number of the frame, found {number} in all {} from {} to {}; number the files",
            numbered.len(),
            excerpt(&listing::name(first)),
            excerpt(&listing::name(last))
        );
        return Err(MicroExpressionError::Table { path: folder.to_owned(), reason });
    }
    for (number, path) in numbered {
        let Ok(number) = u64::try_from(number) else { continue };
        if let Some(other) = frames.insert(number, path.clone()) {
            let other = excerpt(&listing::name(&other)).to_string();
            let reason = format!("frame {number} exists twice, also as {other}; keep one of the two");
            return Err(MicroExpressionError::Table { path: path.clone(), reason });
        }
    }
    Ok(frames)
}

/// The clips found, dropped, and missing.
pub struct Located {
    pub clips: Vec<Clip>,
    pub dropped: Vec<Dropped>,
    pub missing: Vec<MissingFrames>,
}

/// Finds the frames of each annotation in its folder, or in that of its video. With `only_key_frames`, only onset and apex are required.
pub fn locate(
    dataset: &str,
    annotations: Vec<Annotation>,
    found: &ClipFolders,
    only_key_frames: bool,
    frames_of_videos: &BTreeMap<PathBuf, PathBuf>,
) -> Result<Located, MicroExpressionError> {
    let mut located = Located { clips: Vec::new(), dropped: Vec::new(), missing: Vec::new() };
    for (mut annotation, folder) in annotations.into_iter().zip(&found.folders) {
        let place = frames_of_videos.get(folder).unwrap_or(folder);
        let mut frames = if place.is_dir() { numbered_frames(place)? } else { BTreeMap::new() };
        if found.alone {
            frames = counted_from(frames, annotation.onset, annotation.offset);
        }
        frames.retain(|number, _| (annotation.onset..=annotation.offset).contains(number));
        if only_key_frames && annotation.apex.is_none() {
            annotation.apex = only_frame_between(&frames, annotation.onset, annotation.offset);
        }
        let essential: Vec<u64> = [Some(annotation.onset), annotation.apex].into_iter().flatten().collect();
        let gaps = match (only_key_frames, annotation.apex) {
            (true, Some(_)) => {
                let absent = essential.iter().filter(|number| !frames.contains_key(number));
                absent.map(|&number| (number, number)).collect()
            }
            // An unknown apex has to be spotted among all frames.
            _ => gaps(&frames, annotation.onset, annotation.offset),
        };
        let whole = essential.iter().all(|number| frames.contains_key(number));
        let usable = whole && frames.len() > 1;
        if !gaps.is_empty() {
            located.missing.push(MissingFrames {
                subject: annotation.subject.clone(),
                clip: annotation.clip.clone(),
                folder: folder.clone(),
                numbers: gaps,
                holds_key_frames: usable
                    && (annotation.apex.is_some()
                        || only_frame_between(&frames, annotation.onset, annotation.offset).is_some()),
                dropped: !usable,
                unread: listing::unread_files(folder),
            });
        }
        if usable {
            located.clips.push(Clip {
                dataset: dataset.to_owned(),
                annotation,
                folder: folder.clone(),
                frames,
            });
        } else {
            let Annotation { subject, clip, label, .. } = annotation;
            located.dropped.push(Dropped { subject, clip, label, reason: DropReason::FramesMissing });
        }
    }
    Ok(located)
}

/// The frames of one clip, numbered from the onset if their own numbers are others and they are as many as the clip has.
fn counted_from(frames: BTreeMap<u64, PathBuf>, onset: u64, offset: u64) -> BTreeMap<u64, PathBuf> {
    let as_many = u64::try_from(frames.len()) == Ok((offset - onset).saturating_add(1));
    match as_many && frames.range(onset..=offset).next().is_none() {
        true => (onset..).zip(frames.into_values()).collect(),
        false => frames,
    }
}

/// The only frame between two others; `None` if there are more or none.
fn only_frame_between(frames: &BTreeMap<u64, PathBuf>, onset: u64, offset: u64) -> Option<u64> {
    let mut between = frames.range(onset.saturating_add(1)..offset.max(onset.saturating_add(1)));
    let first = between.next()?;
    between.next().is_none().then_some(*first.0)
}

/// The missing numbers from `first` to `last`, as inclusive ranges: a huge range in a table is never enumerated.
fn gaps(frames: &BTreeMap<u64, PathBuf>, first: u64, last: u64) -> Vec<(u64, u64)> {
    let mut gaps = Vec::new();
    let mut next = first;
    for &number in frames.range(first..=last).map(|(number, _)| number) {
        if number > next {
            gaps.push((next, number - 1));
        }
        next = number.saturating_add(1);
    }
    if next <= last && !frames.contains_key(&last) {
        gaps.push((next, last));
    }
    gaps
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    proptest! {
        #[test]
        fn gaps_and_frames_are_all_numbers(present in prop::collection::btree_set(0_u64..40, 0..40), first in 0_u64..30, length in 0_u64..20) {
            let last = first + length;
            let frames: BTreeMap<u64, PathBuf> = present.iter().map(|&number| (number, PathBuf::new())).collect();
            let missing: Vec<u64> = gaps(&frames, first, last).into_iter().flat_map(|(a, b)| a..=b).collect();
            let expected: Vec<u64> = (first..=last).filter(|number| !present.contains(number)).collect();
            prop_assert_eq!(missing, expected);
        }
    }

    #[test]
    fn a_table_that_claims_too_much_takes_no_time() {
        let gaps = gaps(&BTreeMap::from([(u64::MAX, PathBuf::new())]), 0, u64::MAX);
        assert_eq!(gaps, [(0, u64::MAX - 1)]);
    }
}
