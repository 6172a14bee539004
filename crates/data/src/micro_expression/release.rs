//! Datasets with a raw and a cropped release.

use std::path::{Path, PathBuf};

use super::frames::{ClipFolders, below};
use super::{Annotation, ClipSource, MicroExpressionError};
use crate::listing;

/// The folders of clips in the release that `source` names, or in the one that is there: the first of `places` that has any. Names of
/// cropped frames start with `cropped`.
pub fn below_release<const N: usize>(
    source: &ClipSource,
    places: &[(&str, &'static str)],
    cropped: &str,
    annotations: &[Annotation],
    folders: impl Fn(&Path, &Annotation) -> [PathBuf; N],
) -> Result<ClipFolders, MicroExpressionError> {
    let ClipSource { kind, dir, .. } = source;
    let kind = kind.name;
    let found = |places: &[(&str, &'static str)]| below(kind, dir, places, annotations, &folders);
    if let Some(release) = source.release {
        let places: Vec<_> =
            places.iter().copied().filter(|(_, of)| *of == release).chain([("", release)]).collect();
        return found(&places);
    }
    let there = |release| places.iter().any(|(name, of)| *of == release && dir.join(name).is_dir());
    if there("raw") && there("cropped") {
        return Err(MicroExpressionError::NoFolders {
            kind,
            looked_for: "one release".to_owned(),
            found: format!("{0} holds both: give {kind}-raw:{0} or {kind}-cropped:{0}", dir.display()),
        });
    }
    let places: Vec<_> = places.iter().copied().chain([("", "")]).collect();
    let mut found = found(&places)?;
    if found.form.is_empty() {
        let first = found.folders.iter().find(|folder| folder.is_dir());
        let pictures = first.and_then(|folder| listing::pictures(folder).ok()).unwrap_or_default();
        let is_cropped = pictures.first().is_some_and(|picture| listing::name(picture).starts_with(cropped));
        found.form = if is_cropped { "cropped" } else { "raw" };
    }
    Ok(found)
}
