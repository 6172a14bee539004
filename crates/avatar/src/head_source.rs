//! Where head models come from: a table of kinds, one line each.

use std::fmt;
use std::path::{Path, PathBuf};
use std::str::FromStr;

use srflow_core::random::Key;

use crate::avatar::AvatarError;
use crate::capture::HeadRecord;
use crate::{Avatar, AvatarFiles, HeadModel, files, flame, gltf, gnm, ict};

/// A kind of head, as in `--head KIND:PATH`.
pub struct HeadKind {
    /// Its name, e.g. `flame`.
    pub name: &'static str,
    /// What comes after the colon, e.g. `FILE`; empty for a kind without files.
    pub path: &'static str,
    /// Title in the help.
    pub about: &'static str,
    /// Files beside the one that is named, of which those that exist are read too.
    companions: &'static [&'static str],
    /// Reads the model; the seed matters to heads that are made from one.
    load: fn(&Path, u64) -> Result<HeadModel, AvatarError>,
}

/// The kinds of head. The first two are the built-in head and ICT-FaceKit.
pub static HEAD_KINDS: [HeadKind; 8] = [
    HeadKind {
        name: "builtin",
        path: "",
        about: "a head sculpted by code from a seed",
        companions: &[],
        load: |_, seed| Ok(HeadModel::builtin(seed)),
    },
    HeadKind {
        name: "ict",
        path: "DIR",
        about: "ICT-FaceKit's FaceXModel folder",
        companions: &[],
        load: |dir, _| ict::load(dir),
    },
    HeadKind {
        name: "builtin-average",
        path: "",
        about: "the average built-in head, whose identity basis are the traits of persons",
        companions: &[],
        load: |_, _| Ok(HeadModel::builtin_average()),
    },
    HeadKind {
        name: "flame",
        path: "FILE",
        about: "FLAME 2020 or 2023 (.pkl or .npz) with VHAP's teeth",
        companions: &flame::COMPANIONS,
        load: |file, _| flame::load(file, true),
    },
    HeadKind {
        name: "flame-toothless",
        path: "FILE",
        about: "FLAME as published",
        companions: &flame::COMPANIONS,
        load: |file, _| flame::load(file, false),
    },
    HeadKind {
        name: "gnm",
        path: "FILE",
        about: "GNM Head 3 (gnm_head.npz)",
        companions: &gnm::COMPANIONS,
        load: |file, _| gnm::load(file),
    },
    HeadKind {
        name: "gltf",
        path: "FILE",
        about: "any rigged head as .glb or .gltf",
        companions: &gltf::COMPANIONS,
        load: |file, _| gltf::load(file),
    },
    HeadKind {
        name: AVATAR,
        path: "DIR",
        about: "a trained avatar: point_cloud.ply and flame_param.npz; DIR@HEAD where no head.json names its head model",
        companions: &[],
        load: |dir, _| Ok(AvatarPath::parse(dir).open()?.1),
    },
];

/// The kind of the files of an avatar, which have Gaussians of their own.
const AVATAR: &str = "avatar";

/// A head to read or make: `builtin`, or a kind and a path, as `flame:FILE`. [`HEAD_KINDS`] lists the kinds.
#[derive(Clone)]
pub struct HeadSource {
    kind: &'static HeadKind,
    path: PathBuf,
}

impl HeadSource {
    /// The built-in head.
    pub fn builtin() -> Self {
        Self { kind: &HEAD_KINDS[0], path: PathBuf::new() }
    }

    /// ICT-FaceKit in this folder.
    pub fn ict(dir: &Path) -> Self {
        Self { kind: &HEAD_KINDS[1], path: dir.to_owned() }
    }

    /// Name of the kind.
    pub fn kind(&self) -> &'static str {
        self.kind.name
    }

    /// A source of the kind with this name whose path is not known; `None` for an unknown kind.
    pub fn of_kind(name: &str) -> Option<Self> {
        let kind = HEAD_KINDS.iter().find(|kind| kind.name == name)?;
        Some(Self { kind, path: PathBuf::new() })
    }

    /// Whether it is made without files.
    pub fn is_builtin(&self) -> bool {
        self.kind.path.is_empty()
    }

    /// The file or folder; empty for the built-in head.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// The file and those beside it that are read, or the folder; none for the built-in head.
    pub fn paths(&self) -> Vec<PathBuf> {
        if self.is_builtin() {
            return Vec::new();
        }
        if self.kind.name == AVATAR {
            return AvatarPath::parse(&self.path).paths();
        }
        let beside = self.kind.companions.iter().map(|name| self.path.with_file_name(name));
        std::iter::once(self.path.clone()).chain(beside.filter(|path| path.exists())).collect()
    }

    /// For the help of an argument: all kinds and what their paths are.
    pub fn help() -> String {
        let kinds = HEAD_KINDS.iter().map(|kind| match kind.path {
            "" => format!("`{}` ({})", kind.name, kind.about),
            path => format!("`{}:{path}` ({})", kind.name, kind.about),
        });
        kinds.collect::<Vec<_>>().join(", ")
    }

    /// The head model. The seed determines the shape of a built-in head, and nothing of the others.
    ///
    /// # Errors
    /// Names the file that is missing or malformed.
    pub fn model(&self, seed: u64) -> Result<HeadModel, AvatarError> {
        (self.kind.load)(&self.path, seed)
    }

    /// A person on this head. The seed determines shape, skin, hair and eyes, but nothing of a trained avatar.
    ///
    /// # Errors
    /// As [`HeadSource::model`], and when the model has no landmarks or does not fit a trained avatar.
    pub fn avatar(&self, seed: u64) -> Result<Avatar, AvatarError> {
        if self.kind.name == AVATAR {
            let (files, model) = AvatarPath::parse(&self.path).open()?;
            return files.on(model);
        }
        let model = self.model(seed)?;
        let mut stream = Key::new(seed).stream("identity");
        // Principal components: standard normal, clamped.
        let identity: Vec<f32> =
            model.identities.iter().map(|_| stream.normal().clamp(-1.8, 1.8) * 0.8).collect();
        Avatar::of(model, &identity, seed)
    }
}

impl HeadSource {
    /// The record of the head model `model`, which this source made for `seed`, for files of its parameters.
    ///
    /// # Errors
    /// When the files of an avatar cannot be read.
    pub fn record(&self, seed: u64, model: &HeadModel) -> Result<HeadRecord, AvatarError> {
        if self.kind.name != AVATAR {
            return Ok(HeadRecord::new(self.to_string(), seed, model));
        }
        let path = AvatarPath::parse(&self.path);
        let files = AvatarFiles::read(&path.dir)?;
        let (head, seed) = path.head(&files)?;
        Ok(HeadRecord::new(head.to_string(), seed, model))
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
    fn head(&self, files: &AvatarFiles) -> Result<(HeadSource, u64), AvatarError> {
        let named = |reason| AvatarError::HeadName { dir: files.dir.clone(), reason };
        let head = match (&self.on, &files.head) {
            (Some(on), _) => on.clone(),
            (None, Some(record)) => record.head.parse().map_err(named)?,
            (None, None) => return Err(AvatarError::NoHeadName(files.dir.clone())),
        };
        if head.kind.name == AVATAR {
            return Err(named(format!("`{head}`: an avatar is no head model")));
        }
        Ok((head, files.head.as_ref().map_or(0, |record| record.subject)))
    }

    fn paths(&self) -> Vec<PathBuf> {
        let dir = files::last_iteration(&self.dir).unwrap_or_else(|_| self.dir.clone());
        let [gaussians, others @ ..] = files::NAMES.map(|name| dir.join(name));
        let on = self.on.iter().flat_map(HeadSource::paths);
        std::iter::once(gaussians).chain(others.into_iter().filter(|path| path.exists())).chain(on).collect()
    }
}

impl PartialEq for HeadSource {
    fn eq(&self, other: &Self) -> bool {
        self.kind.name == other.kind.name && self.path == other.path
    }
}

impl Eq for HeadSource {}

impl fmt::Debug for HeadSource {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "HeadSource({self})")
    }
}

impl fmt::Display for HeadSource {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.kind.name)?;
        if self.is_builtin() { Ok(()) } else { write!(f, ":{}", self.path.display()) }
    }
}

impl FromStr for HeadSource {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let (name, path) = text.split_once(':').unwrap_or((text, ""));
        let known =
            HEAD_KINDS.iter().find(|kind| kind.name == name && kind.path.is_empty() != text.contains(':'));
        match known {
            Some(kind) if kind.path.is_empty() == path.is_empty() => Ok(Self { kind, path: path.into() }),
            _ => {
                let forms = HEAD_KINDS.iter().map(|kind| match kind.path {
                    "" => format!("`{}`", kind.name),
                    path => format!("`{}:{path}`", kind.name),
                });
                Err(format!("`{text}`: expected {}", forms.collect::<Vec<_>>().join(", ")))
            }
        }
    }
}

srflow_core::serialize_as_text!(HeadSource);

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_of_heads_are_read_and_written() {
        for text in [
            "builtin",
            "ict:/a:b",
            "flame:generic_model.pkl",
            "flame-toothless:a.npz",
            "gnm:a.npz",
            "gltf:a.glb",
        ] {
            let source: HeadSource = text.parse().unwrap();
            assert_eq!(source.to_string(), text);
            assert_eq!(source.is_builtin(), text == "builtin");
        }
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
        for text in ["flame", "ict:", "builtin:", "builtin:a", "other:a", ""] {
            let error = text.parse::<HeadSource>().unwrap_err();
            assert!(error.contains("`builtin`, `ict:DIR`, `builtin-average`, `flame:FILE`"), "{error}");
        }
        let names: std::collections::BTreeSet<&str> = HEAD_KINDS.iter().map(|kind| kind.name).collect();
        assert_eq!(names.len(), HEAD_KINDS.len());
    }
}
