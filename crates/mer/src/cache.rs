//! Features on disk, keyed by everything they depend on.

use std::path::{Path, PathBuf};

use sha2::{Digest, Sha256};
use srflow_files::{
    FileError, FileKind, create_folder, hexadecimal, read_npy, read_text, sha256_of_file, write_file,
    write_npy,
};

use crate::features::{FEATURE_SIDE, Features};
use crate::head_motion::{HeadMotion, SubtractedMotion};

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

    /// The features of a key, and the motion of the head that was subtracted, if both exist and are intact.
    pub fn get(
        &self,
        key: &FeatureKey,
        head_motion: HeadMotion,
    ) -> Option<(Features, Option<SubtractedMotion>)> {
        let array = read_npy(&self.file(key, "npy")).ok()?;
        if array.shape != [3, FEATURE_SIDE, FEATURE_SIDE] {
            return None;
        }
        let subtracted = match head_motion {
            HeadMotion::Keep => None,
            HeadMotion::Subtract => {
                let text = read_text(&self.file(key, "json"), FileKind::Json).ok()?;
                Some(serde_json::from_str(&text).ok()?)
            }
        };
        Some((Features::from_values(array.values).ok()?, subtracted))
    }

    /// Stores features under a key, and the motion of the head that was subtracted.
    ///
    /// # Errors
    /// When a file cannot be written.
    pub fn put(
        &self,
        key: &FeatureKey,
        features: &Features,
        subtracted: Option<&SubtractedMotion>,
    ) -> Result<(), FileError> {
        if let Some(subtracted) = subtracted {
            write_file(&self.file(key, "json"), serde_json::to_string(subtracted).expect("numbers"))?;
        }
        write_npy(&self.file(key, "npy"), &[3, FEATURE_SIDE, FEATURE_SIDE], features.values())
    }

    fn file(&self, key: &FeatureKey, extension: &str) -> PathBuf {
        self.folder.join(format!("{}.{extension}", key.0))
    }
}
