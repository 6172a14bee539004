//! Published weights by name: downloaded once, cached in a folder, verified by SHA-256.

use std::env;
use std::path::{Path, PathBuf};

use srflow_fetch::{DownloadError, download_if_missing};

use crate::facts::PublishedWeights;
use crate::table::Architecture;

/// Errors of finding weights.
#[derive(Debug, thiserror::Error)]
pub enum PublishedError {
    #[error("{given}: not a file, nor the name of published weights; expected one of {}", published_names().join(", "))]
    Unknown { given: String },
    #[error("found no cache folder for downloaded weights: set SRFLOW_CACHE to a folder")]
    NoFolder,
    #[error(transparent)]
    Download(#[from] DownloadError),
}

/// Names of all published weights, such as `skflow-things`.
pub fn published_names() -> Vec<String> {
    let of = |architecture: Architecture| {
        let published = architecture.facts().published.iter();
        published.map(move |weights| format!("{}-{}", architecture.name(), weights.trained_on))
    };
    Architecture::ALL.into_iter().flat_map(of).collect()
}

/// Published weights by name, such as `skflow-things`, or `things` if the network is given, and their network.
pub fn published(
    architecture: Option<Architecture>,
    name: &str,
) -> Option<(Architecture, &'static PublishedWeights)> {
    let of = |owner: Architecture| {
        let trained_on = match name.strip_prefix(owner.name()).and_then(|rest| rest.strip_prefix('-')) {
            Some(trained_on) => trained_on,
            None if architecture == Some(owner) => name,
            None => return None,
        };
        let mut published = owner.facts().published.iter();
        Some((owner, published.find(|weights| weights.trained_on == trained_on)?))
    };
    Architecture::ALL.into_iter().find_map(of)
}

/// Folder of downloaded weights: `weights` in the folder of the environment variable `SRFLOW_CACHE`, or `srflow/weights` in the
/// user's cache (`XDG_CACHE_HOME`, `~/.cache`, on Windows `LOCALAPPDATA`).
pub fn weights_folder() -> Option<PathBuf> {
    let folder = |name: &str| env::var_os(name).filter(|value| !value.is_empty()).map(PathBuf::from);
    if let Some(cache) = folder("SRFLOW_CACHE") {
        return Some(cache.join("weights"));
    }
    let cache = folder("XDG_CACHE_HOME")
        .or_else(|| folder("LOCALAPPDATA"))
        .or_else(|| Some(folder("HOME")?.join(".cache")))?;
    Some(cache.join("srflow").join("weights"))
}

/// The path of a file of weights: `given` itself if the file exists, else that of the [published](published) weights of this
/// name in `folder` (see [`weights_folder`]), downloaded if missing. `progress` is called with the bytes downloaded so far, and
/// the total if known.
///
/// # Errors
/// When `given` is neither, the download fails, or the SHA-256 of the file does not match.
pub fn find_weights(
    given: &Path,
    architecture: Option<Architecture>,
    folder: Option<&Path>,
    progress: &mut dyn FnMut(u64, Option<u64>),
) -> Result<PathBuf, PublishedError> {
    if given.exists() {
        return Ok(given.to_owned());
    }
    let found = given.to_str().and_then(|name| published(architecture, name));
    let Some((_, weights)) = found else {
        return Err(PublishedError::Unknown { given: given.display().to_string() });
    };
    let path = folder.ok_or(PublishedError::NoFolder)?.join(weights.file_name());
    download_if_missing(weights.url, weights.sha256, &path, progress)?;
    Ok(path)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn weights_are_found_by_full_or_short_names() {
        let file = |architecture, name| Some(published(architecture, name)?.1.file_name());
        assert_eq!(file(None, "skflow-things"), Some("skflow-things-f84e6538.ckpt"));
        assert_eq!(file(None, "raft-small-things"), Some("raft_small-things-b7d9f997.ckpt"));
        assert_eq!(file(Some(Architecture::Gma), "kitti"), Some("gma-kitti-8ca3ec80.ckpt"));
        assert_eq!(file(None, "things"), None);
        assert_eq!(file(Some(Architecture::SkFlow), "chairs"), None);
        for name in published_names() {
            assert!(published(None, &name).is_some(), "{name}");
        }
        let error = find_weights("nothing.pth".as_ref(), None, None, &mut |_, _| ()).unwrap_err();
        assert!(error.to_string().contains("raft-chairs, raft-things"), "{error}");
    }
}
