//! Where heads come from: head models, which are dressed, and trained avatars.

use std::fmt;
use std::path::{Path, PathBuf};
use std::str::FromStr;

use srflow_core::random::Key;
use srflow_head::{HeadModel, Look, ModelSource};

use crate::avatar::AvatarError;
use crate::capture::HeadRecord;
use crate::{Avatar, AvatarFiles, files};

/// A head to read or make: a head model, as [`ModelSource`] reads it, or `avatar:DIR`, a trained avatar with Gaussians of its own.
#[derive(Clone, PartialEq, Eq)]
pub enum HeadSource {
    /// A head model, dressed by a seed.
    Model(ModelSource),
    /// `DIR`, the files of an avatar, or `DIR@HEAD` with its head model.
    Avatar(PathBuf),
}

/// The kind of [`HeadSource::Avatar`].
const AVATAR: &str = "avatar";

impl HeadSource {
    /// The built-in head.
    pub fn builtin() -> Self {
        Self::Model(ModelSource::builtin())
    }

    /// Name of the kind.
    pub fn kind(&self) -> &'static str {
        match self {
            Self::Model(model) => model.kind(),
            Self::Avatar(_) => AVATAR,
        }
    }

    /// A source of the kind with this name whose path is not known; `None` for an unknown kind.
    pub fn of_kind(name: &str) -> Option<Self> {
        match name {
            AVATAR => Some(Self::Avatar(PathBuf::new())),
            name => ModelSource::of_kind(name).map(Self::Model),
        }
    }

    /// This kind of head at another path.
    pub fn with_path(&self, path: impl Into<PathBuf>) -> Self {
        match self {
            Self::Model(model) => Self::Model(model.with_path(path.into())),
            Self::Avatar(_) => Self::Avatar(path.into()),
        }
    }

    /// This head with another look; a trained avatar has its own.
    #[must_use]
    pub fn with_look(&self, look: Look) -> Self {
        match self {
            Self::Model(model) => Self::Model(model.with_look(look)),
            Self::Avatar(_) => self.clone(),
        }
    }

    fn look(&self) -> Look {
        match self {
            Self::Model(model) => model.look(),
            Self::Avatar(_) => Look::default(),
        }
    }

    /// Whether it is made without files.
    pub fn is_builtin(&self) -> bool {
        matches!(self, Self::Model(model) if model.is_builtin())
    }

    /// The file or folder; empty for the built-in head.
    pub fn path(&self) -> &Path {
        match self {
            Self::Model(model) => model.path(),
            Self::Avatar(path) => path,
        }
    }

    /// The file and those beside it that are read, or the folder; none for the built-in head.
    pub fn paths(&self) -> Vec<PathBuf> {
        match self {
            Self::Model(model) => model.paths(),
            Self::Avatar(path) => AvatarPath::parse(path).paths(),
        }
    }

    /// For the help of an argument: all kinds and what their paths are.
    pub fn help() -> String {
        let files = "a trained avatar: point_cloud.ply and flame_param.npz; DIR@HEAD where no head.json names its head model";
        format!("{}, `{AVATAR}:DIR` ({files})", ModelSource::help())
    }

    /// The head model. The seed determines the shape of a built-in head, and nothing of the others.
    ///
    /// # Errors
    /// Names the file that is missing or malformed.
    pub fn model(&self, seed: u64) -> Result<HeadModel, AvatarError> {
        match self {
            Self::Model(model) => Ok(model.model(seed)?),
            Self::Avatar(path) => Ok(AvatarPath::parse(path).open()?.1),
        }
    }

    /// A person on this head. The seed determines shape, skin, hair and eyes, but nothing of a trained avatar.
    ///
    /// # Errors
    /// As [`HeadSource::model`], and when the model has no landmarks or does not fit a trained avatar.
    pub fn avatar(&self, seed: u64) -> Result<Avatar, AvatarError> {
        let model = match self {
            Self::Model(model) => model.model(seed)?,
            Self::Avatar(path) => {
                let (files, model) = AvatarPath::parse(path).open()?;
                return files.on(model);
            }
        };
        let mut stream = Key::new(seed).stream("identity");
        // Principal components: standard normal, clamped.
        let identity: Vec<f32> =
            model.identities.iter().map(|_| stream.normal().clamp(-1.8, 1.8) * 0.8).collect();
        Avatar::of(model, &identity, seed, self.look())
    }

    /// The record of the head model `model`, which this source made for `seed`, for files of its parameters.
    ///
    /// # Errors
    /// When the files of an avatar cannot be read.
    pub fn record(&self, seed: u64, model: &HeadModel) -> Result<HeadRecord, AvatarError> {
        let (head, seed) = match self {
            Self::Model(head) => (head.clone(), seed),
            Self::Avatar(path) => {
                let path = AvatarPath::parse(path);
                path.head(&AvatarFiles::read(&path.dir)?)?
            }
        };
        let look = head.look();
        Ok(HeadRecord { look, ..HeadRecord::new(head.to_string(), seed, model) })
    }
}

/// What follows `avatar:`: a folder, or a folder and its head model.
struct AvatarPath {
    dir: PathBuf,
    on: Option<HeadSource>,
}

impl AvatarPath {
    fn parse(path: &Path) -> Self {
        // A folder may have an @ in its name: only one before a head counts.
        let named = path.to_str().and_then(|text| text.rsplit_once('@'));
        let named = named.filter(|(dir, _)| !dir.is_empty());
        match named.and_then(|(dir, on)| Some((dir, on.parse().ok()?))) {
            Some((dir, on)) => Self { dir: dir.into(), on: Some(on) },
            None => Self { dir: path.to_owned(), on: None },
        }
    }

    /// The files, and the head model that the Gaussians are bound to.
    fn open(&self) -> Result<(AvatarFiles, HeadModel), AvatarError> {
        let files = AvatarFiles::read(&self.dir)?;
        let (head, seed) = self.head(&files)?;
        let model = head.model(seed)?;
        Ok((files, model))
    }

    /// The given head model, or the one that the files name; and the seed of its shape.
    fn head(&self, files: &AvatarFiles) -> Result<(ModelSource, u64), AvatarError> {
        let named = |reason| AvatarError::HeadName { dir: files.dir.clone(), reason };
        let head = match (&self.on, &files.head) {
            (Some(on), record) => {
                on.with_look(record.as_ref().map_or(Look::unrecorded(), |record| record.look))
            }
            (None, Some(record)) => record.source().map_err(named)?,
            (None, None) => return Err(AvatarError::NoHeadName(files.dir.clone())),
        };
        match head {
            HeadSource::Model(model) => Ok((model, files.head.as_ref().map_or(0, |record| record.subject))),
            HeadSource::Avatar(_) => Err(named(format!("`{head}`: an avatar is no head model"))),
        }
    }

    fn paths(&self) -> Vec<PathBuf> {
        let dir = files::last_iteration(&self.dir).unwrap_or_else(|_| self.dir.clone());
        let [gaussians, others @ ..] = files::NAMES.map(|name| dir.join(name));
        let on = self.on.iter().flat_map(HeadSource::paths);
        std::iter::once(gaussians).chain(others.into_iter().filter(|path| path.exists())).chain(on).collect()
    }
}

impl fmt::Debug for HeadSource {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "HeadSource({self})")
    }
}

impl fmt::Display for HeadSource {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Model(model) => model.fmt(f),
            Self::Avatar(path) => write!(f, "{AVATAR}:{}", path.display()),
        }
    }
}

impl FromStr for HeadSource {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        match text.split_once(':') {
            Some((AVATAR, path)) if !path.is_empty() => Ok(Self::Avatar(path.into())),
            _ => text.parse().map(Self::Model).map_err(|error| format!("{error}, `{AVATAR}:DIR`")),
        }
    }
}

srflow_core::serialize_as_text!(HeadSource);

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn paths_of_avatars_are_read_and_written() {
        for (text, dir, on) in [
            ("avatar:/a@b", "/a@b", None),
            ("avatar:/a@b@builtin", "/a@b", Some("builtin")),
            ("avatar:a@ict:/c", "a", Some("ict:/c")),
        ] {
            let source: HeadSource = text.parse().unwrap();
            assert_eq!(source.to_string(), text);
            let path = AvatarPath::parse(source.path());
            assert_eq!(
                (path.dir.as_path(), path.on.map(|on| on.to_string()).as_deref()),
                (Path::new(dir), on)
            );
        }
        for text in ["avatar", "avatar:"] {
            let error = text.parse::<HeadSource>().unwrap_err();
            assert!(error.contains("`builtin`, `ict:DIR`, ") && error.ends_with(", `avatar:DIR`"), "{error}");
        }
    }
}
