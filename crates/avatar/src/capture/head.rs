//! `head.json`: the head that parameters belong to. Files of VHAP and GaussianAvatars, which know FLAME alone, have none.

use std::path::Path;

use serde::{Deserialize, Serialize};
use srflow_files::{FileError, FileKind, parse_error_in_words, read_text, write_file};

use super::problem;
use crate::HeadSource;
use srflow_head::{HeadModel, Look};

/// Name of the file.
pub const HEAD_NAME: &str = "head.json";

/// The head that the parameters of a capture or an avatar belong to.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct HeadRecord {
    /// As after `--head`, e.g. `builtin` or `ict:FaceXModel`.
    pub head: String,
    /// The seed of the person, which determines the shape of a built-in head.
    pub subject: u64,
    /// How the head looks.
    #[serde(default = "Look::unrecorded", skip_serializing_if = "Look::is_unrecorded")]
    pub look: Look,
    /// Vertices and triangles of the model, to recognize it.
    pub vertices: usize,
    pub triangles: usize,
    /// Names of the expressions, in the order of `expr`.
    pub expressions: Vec<String>,
}

impl HeadRecord {
    /// The record of a model that was made from `head`, with the latest look, for the person `subject`.
    pub fn new(head: String, subject: u64, model: &HeadModel) -> Self {
        Self {
            head,
            subject,
            look: Look::default(),
            vertices: model.template.len(),
            triangles: model.triangles.len(),
            expressions: model.expressions.iter().map(|shape| shape.name.clone()).collect(),
        }
    }

    /// The head that it names.
    ///
    /// # Errors
    /// When there is no such kind of head.
    pub fn source(&self) -> Result<HeadSource, String> {
        Ok(self.head.parse::<HeadSource>()?.with_look(self.look))
    }

    /// Reads the record in `dir`; `None` if it has none.
    ///
    /// # Errors
    /// When the file cannot be read or is malformed.
    pub fn read(dir: &Path) -> Result<Option<Self>, FileError> {
        let path = dir.join(HEAD_NAME);
        let text = match read_text(&path, FileKind::Json) {
            Err(error) if error.is_not_found() => return Ok(None),
            text => text?,
        };
        serde_json::from_str(&text).map(Some).map_err(|error| {
            let expected = "head, subject, vertices, triangles and expressions, as srflow writes them";
            FileError { path, problem: problem("head", expected, parse_error_in_words(&error)) }
        })
    }

    /// Writes the record into `dir`.
    ///
    /// # Errors
    /// When the file cannot be written.
    pub fn write(&self, dir: &Path) -> Result<(), FileError> {
        let text = serde_json::to_string_pretty(self).expect("numbers and text");
        write_file(&dir.join(HEAD_NAME), text + "\n")
    }

    /// Checks that `model` is the one that the record in `dir` describes.
    ///
    /// # Errors
    /// When vertices, triangles or expressions differ.
    pub fn check(&self, dir: &Path, model: &HeadModel) -> Result<(), FileError> {
        let names = || model.expressions.iter().map(|shape| shape.name.as_str());
        let same = self.vertices == model.template.len()
            && self.triangles == model.triangles.len()
            && names().eq(self.expressions.iter().map(String::as_str));
        if same {
            return Ok(());
        }
        let words = |vertices, triangles, expressions| {
            format!("{vertices} vertices, {triangles} triangles and {expressions} expressions")
        };
        let expected = format!(
            "the head model {}, which has {}",
            model.name,
            words(model.template.len(), model.triangles.len(), model.expressions.len())
        );
        let found = format!("one of {}", words(self.vertices, self.triangles, self.expressions.len()));
        Err(FileError { path: dir.join(HEAD_NAME), problem: problem("head", expected, found) })
    }

    /// Whether `model`, which [`HeadRecord::check`] accepts, may have the shape of this head. That of a built-in head is a person's; the
    /// others tell no shape.
    pub fn may_be(&self, model: &HeadModel) -> bool {
        let builtin = self.source().ok().filter(HeadSource::is_builtin);
        let own = builtin.and_then(|head| head.model(self.subject).ok());
        own.is_none_or(|own| own.template == model.template)
    }
}
