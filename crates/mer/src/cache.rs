//! Features on disk, keyed by everything they depend on.

use std::path::{Path, PathBuf};

use sha2::{Digest, Sha256};
use srflow_files::{FileError, FileKind, create_folder, hexadecimal, read_npy, sha256_of_file, write_npy};

use crate::features::{FEATURE_SIDE, Features};

/// Incremented when the same recipe gives other features.
const VERSION: u32 = 1;

/// A folder of features. File names are digests of the two pictures' bytes, the flow method with its parameters and weights,
/// the preparation, and this program's version of it: other inputs have other names, and nothing has to be invalidated.
#[derive(Debug, Clone)]
pub struct FeatureCache {
    folder: PathBuf,
}

/// Name of one clip's features.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct FeatureKey(String);

/// SHA-256 of a file in hexadecimal digits: identifies the weights of a method.
///
/// # Errors
/// When the file cannot be read.
pub fn file_digest(path: &Path) -> Result<String, FileError> {
    Ok(hexadecimal(sha256_of_file(path, FileKind::Checkpoint)?))
}

impl FeatureCache {
    /// Opens the cache in `folder`, which is created if necessary.
    ///
    /// # Errors
    /// When the folder cannot be created.
    pub fn open(folder: &Path) -> Result<Self, FileError> {
        create_folder(folder)?;
        Ok(Self { folder: folder.to_owned() })
    }

    /// The key of the features of two picture files and a recipe.
    ///
    /// # Errors
    /// When a file cannot be read.
    pub fn key(&self, onset: &Path, apex: &Path, recipe: &str) -> Result<FeatureKey, FileError> {
        let mut digest = Sha256::new();
        digest.update(format!("srflow features {VERSION}\n{recipe}\n"));
        for path in [onset, apex] {
            // A separate digest of each picture, so that bytes cannot move from one to the other.
            digest.update(sha256_of_file(path, FileKind::Image)?);
        }
        Ok(FeatureKey(hexadecimal(digest.finalize())))
    }

    /// The features of a key, if they exist and are intact.
    pub fn get(&self, key: &FeatureKey) -> Option<Features> {
        let array = read_npy(&self.file(key)).ok()?;
        if array.shape != [3, FEATURE_SIDE, FEATURE_SIDE] {
            return None;
        }
        Features::from_values(array.values).ok()
    }

    /// Stores features under a key.
    ///
    /// # Errors
    /// When the file cannot be written.
    pub fn put(&self, key: &FeatureKey, features: &Features) -> Result<(), FileError> {
        write_npy(&self.file(key), &[3, FEATURE_SIDE, FEATURE_SIDE], features.values())
    }

    fn file(&self, key: &FeatureKey) -> PathBuf {
        self.folder.join(format!("{}.npy", key.0))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn features(value: f32) -> Features {
        Features::from_values(vec![value; Features::LEN]).unwrap()
    }

    #[test]
    fn features_are_found_again_until_anything_changes() {
        let folder = tempfile::tempdir().unwrap();
        let (onset, apex) = (folder.path().join("a"), folder.path().join("b"));
        std::fs::write(&onset, "onset").unwrap();
        std::fs::write(&apex, "apex").unwrap();
        let cache = FeatureCache::open(&folder.path().join("cache")).unwrap();
        let key = cache.key(&onset, &apex, "farneback").unwrap();
        assert_eq!(cache.get(&key), None);
        cache.put(&key, &features(0.25)).unwrap();
        assert_eq!(cache.get(&key), Some(features(0.25)));

        assert_ne!(cache.key(&onset, &apex, "tvl1").unwrap(), key);
        assert_ne!(cache.key(&apex, &onset, "farneback").unwrap(), key);
        std::fs::write(&onset, "onseta").unwrap();
        std::fs::write(&apex, "pex").unwrap();
        assert_ne!(cache.key(&onset, &apex, "farneback").unwrap(), key, "the same bytes, cut elsewhere");
        std::fs::write(&onset, "onset").unwrap();
        std::fs::write(&apex, "apex").unwrap();
        assert_eq!(cache.key(&onset, &apex, "farneback").unwrap(), key);
    }

    #[test]
    fn a_broken_file_is_computed_again() {
        let folder = tempfile::tempdir().unwrap();
        let picture = folder.path().join("a");
        std::fs::write(&picture, "picture").unwrap();
        let cache = FeatureCache::open(folder.path()).unwrap();
        let key = cache.key(&picture, &picture, "r").unwrap();
        let file = cache.file(&key);
        cache.put(&key, &features(1.0)).unwrap();
        let whole = std::fs::read(&file).unwrap();
        std::fs::write(&file, &whole[..whole.len() / 2]).unwrap();
        assert_eq!(cache.get(&key), None);
        write_npy(&file, &[3, 2, 2], &[0.0; 12]).unwrap();
        assert_eq!(cache.get(&key), None);
        cache.put(&key, &features(1.0)).unwrap();
        assert_eq!(cache.get(&key), Some(features(1.0)));
    }

    #[test]
    fn a_picture_that_cannot_be_read_is_named() {
        let folder = tempfile::tempdir().unwrap();
        let cache = FeatureCache::open(folder.path()).unwrap();
        let gone = folder.path().join("gone.png");
        assert!(cache.key(&gone, &gone, "r").unwrap_err().to_string().contains("gone.png: opening"));
    }
}
