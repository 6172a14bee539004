//! Where head models come from: a table of kinds, one line each.

use std::fmt;
use std::path::{Path, PathBuf};
use std::str::FromStr;

use crate::{HeadError, HeadModel, Look, flame, found_head, gltf, gnm, ict, lam, scan};

/// A kind of head model, as in `--head KIND:PATH`.
struct Kind {
    /// Its name, e.g. `flame`.
    name: &'static str,
    /// What comes after the colon, e.g. `FILE`; empty for a kind without files.
    path: &'static str,
    /// Title in the help.
    about: &'static str,
    /// Files that are read if they exist beside the one that is named.
    companions: &'static [&'static str],
    /// That of them which lists the landmarks; empty where they are part of the model.
    landmarks: &'static str,
    /// Reads the model; the seed matters to heads that are sculpted, and the look also to units that they lend to others.
    load: fn(&Path, u64, Look) -> Result<HeadModel, HeadError>,
}

/// The kinds of head models. The first is the built-in head.
static KINDS: [Kind; 9] = [
    Kind {
        name: "builtin",
        path: "",
        about: "a head sculpted by code from a seed",
        companions: &[],
        landmarks: "",
        load: |_, seed, look| Ok(HeadModel::builtin_with(seed, look)),
    },
    Kind {
        name: "ict",
        path: "DIR",
        about: "ICT-FaceKit's FaceXModel folder",
        companions: &[],
        landmarks: "",
        load: |dir, _, _| ict::load(dir),
    },
    Kind {
        name: "builtin-average",
        path: "",
        about: "the average built-in head, whose identity basis are the traits of persons",
        companions: &[],
        landmarks: "",
        load: |_, _, look| Ok(HeadModel::builtin_average_with(look)),
    },
    Kind {
        name: "flame",
        path: "FILE",
        about: "FLAME 2020 or 2023 (.pkl or .npz) with VHAP's teeth",
        companions: &flame::COMPANIONS,
        landmarks: flame::LANDMARKS[0],
        load: |file, _, look| flame::load(file, true, look),
    },
    Kind {
        name: "flame-toothless",
        path: "FILE",
        about: "FLAME as published",
        companions: &flame::COMPANIONS,
        landmarks: flame::LANDMARKS[0],
        load: |file, _, look| flame::load(file, false, look),
    },
    Kind {
        name: "gnm",
        path: "FILE",
        about: "GNM Head 3 (gnm_head.npz)",
        companions: &gnm::COMPANIONS,
        landmarks: gnm::LANDMARKS[0],
        load: |file, _, look| gnm::load(file, look),
    },
    Kind {
        name: "gltf",
        path: "FILE",
        about: "any head as .glb or .gltf",
        companions: &found_head::COMPANIONS,
        landmarks: found_head::LANDMARKS,
        load: |file, _, look| gltf::load(file, look),
    },
    Kind {
        name: "obj",
        path: "FILE",
        about: "any mesh as Wavefront .obj, such as a scan",
        companions: &found_head::COMPANIONS,
        landmarks: found_head::LANDMARKS,
        load: |file, _, look| scan::load(file, look),
    },
    Kind {
        name: "lam",
        path: "DIR|ZIP",
        about: "an avatar of LAM: skin.glb and offset.ply",
        companions: &[],
        landmarks: "",
        load: |path, _, _| lam::load(path),
    },
];

/// The file that lists the landmarks of models of this kind; empty where they are part of the model.
pub(crate) fn landmark_file(kind: &str) -> &'static str {
    KINDS.iter().find(|known| known.name == kind).map_or("", |kind| kind.landmarks)
}

/// A head model to read or make, `builtin`, or a kind and a path, as `flame:FILE`; and the [`Look`] of the head, the latest unless another is asked
/// for.
#[derive(Clone)]
pub struct ModelSource {
    kind: &'static Kind,
    path: PathBuf,
    look: Look,
}

impl ModelSource {
    /// The built-in head.
    pub fn builtin() -> Self {
        Self { kind: &KINDS[0], path: PathBuf::new(), look: Look::default() }
    }

    /// Name of the kind.
    pub fn kind(&self) -> &'static str {
        self.kind.name
    }

    /// A source of the kind with this name whose path is not known; `None` for an unknown kind.
    pub fn of_kind(name: &str) -> Option<Self> {
        let kind = KINDS.iter().find(|kind| kind.name == name)?;
        Some(Self { kind, path: PathBuf::new(), look: Look::default() })
    }

    /// This kind of head model at another path.
    pub fn with_path(&self, path: PathBuf) -> Self {
        Self { path, ..self.clone() }
    }

    /// This head with another look.
    #[must_use]
    pub fn with_look(&self, look: Look) -> Self {
        Self { look, ..self.clone() }
    }

    /// How the head looks.
    pub fn look(&self) -> Look {
        self.look
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
        let beside = self.kind.companions.iter().map(|name| self.path.with_file_name(name));
        let named = match self.kind.name {
            "obj" => scan::files_named_in(&self.path),
            "gltf" => gltf::files_named_in(&self.path),
            _ => Vec::new(),
        };
        std::iter::once(self.path.clone()).chain(beside.filter(|path| path.exists())).chain(named).collect()
    }

    /// For the help of an argument: all kinds and what their paths are.
    pub fn help() -> String {
        let kinds = KINDS.iter().map(|kind| match kind.path {
            "" => format!("`{}` ({})", kind.name, kind.about),
            path => format!("`{}:{path}` ({})", kind.name, kind.about),
        });
        kinds.collect::<Vec<_>>().join(", ")
    }

    /// The head model. The seed determines the shape of a built-in head, and nothing of the others.
    ///
    /// # Errors
    /// Names the file that is missing or malformed.
    pub fn model(&self, seed: u64) -> Result<HeadModel, HeadError> {
        (self.kind.load)(&self.path, seed, self.look)
    }
}

impl PartialEq for ModelSource {
    fn eq(&self, other: &Self) -> bool {
        self.kind.name == other.kind.name && self.path == other.path && self.look == other.look
    }
}

impl Eq for ModelSource {}

impl fmt::Debug for ModelSource {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "ModelSource({self})")
    }
}

impl fmt::Display for ModelSource {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.kind.name)?;
        if self.is_builtin() { Ok(()) } else { write!(f, ":{}", self.path.display()) }
    }
}

impl FromStr for ModelSource {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let (name, path) = text.split_once(':').unwrap_or((text, ""));
        let known = KINDS.iter().find(|kind| kind.name == name && kind.path.is_empty() != text.contains(':'));
        match known {
            Some(kind) if kind.path.is_empty() == path.is_empty() => {
                Ok(Self { kind, path: path.into(), look: Look::default() })
            }
            _ => {
                let forms = KINDS.iter().map(|kind| match kind.path {
                    "" => format!("`{}`", kind.name),
                    path => format!("`{}:{path}`", kind.name),
                });
                Err(format!("`{text}`: expected {}", forms.collect::<Vec<_>>().join(", ")))
            }
        }
    }
}

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
            "obj:a.obj",
            "lam:a.zip",
        ] {
            let source: ModelSource = text.parse().unwrap();
            assert_eq!(source.to_string(), text);
            assert_eq!(source.is_builtin(), text == "builtin");
        }
        for text in ["flame", "ict:", "builtin:", "builtin:a", "other:a", ""] {
            let error = text.parse::<ModelSource>().unwrap_err();
            assert!(error.contains("`builtin`, `ict:DIR`, `builtin-average`, `flame:FILE`"), "{error}");
        }
        let names: std::collections::BTreeSet<&str> = KINDS.iter().map(|kind| kind.name).collect();
        assert_eq!(names.len(), KINDS.len());
    }
}
