//! The heads of datasets: where they are, and what is recorded of their files.

use std::path::Path;

use glam::DVec3;
use serde::de::DeserializeOwned;
use serde_json::Value;
use srflow_avatar::{Avatar, HeadSource};
use srflow_core::random::Key;
use srflow_head::Look;

use crate::RenderError;
use crate::error::require;
use crate::record::{malformed, read_record};
use crate::setting_files::{files_at, fingerprint};

/// Reads the settings that a set recorded. Those of before heads had several looks name none.
///
/// # Errors
/// When the file cannot be read or has other contents.
pub(crate) fn read_settings<T: DeserializeOwned>(path: &Path) -> Result<T, RenderError> {
    let mut record: Value = read_record(path)?;
    name_look(&mut record);
    serde_json::from_value(record).map_err(|error| malformed(path, &error))
}

/// Adds the look that is meant where settings name none.
pub(crate) fn name_look(settings: &mut Value) {
    if let Some(fields) = settings.as_object_mut() {
        fields.entry("look").or_insert_with(|| u8::from(Look::unrecorded()).into());
    }
}

/// These heads with a look.
pub(crate) fn with_look(heads: &[HeadSource], look: Look) -> Vec<HeadSource> {
    heads.iter().map(|head| head.with_look(look)).collect()
}

/// A point between chin and crown, independent of the subject, metres.
pub(crate) fn centre(head: &HeadSource) -> DVec3 {
    match head.kind() {
        "ict" => DVec3::new(0.0, 0.035, 0.02),
        _ => DVec3::new(0.0, 0.03, 0.01),
    }
}

/// The help of the setting of heads that subjects show in turn.
#[cfg(feature = "clap")]
pub(crate) fn heads_help() -> String {
    format!("Head model; may be repeated, and the subjects show them in turn: {}", HeadSource::help())
}

/// The head as recorded with a dataset, independent of where its files are.
///
/// # Errors
/// When its files cannot be read.
pub(crate) fn recorded(head: &HeadSource) -> Result<String, RenderError> {
    match head.is_builtin() {
        true => Ok(head.kind().to_owned()),
        false => Ok(format!("{}, {}", head.kind(), fingerprint(&head_files(head)?))),
    }
}

/// The heads of a set of clips or videos, whose subjects show them in turn: as recorded with the set, with the fingerprint of the files in
/// place of their path.
///
/// # Errors
/// When there is none, or its files cannot be read.
pub(crate) fn recorded_in_turn(heads: &[HeadSource]) -> Result<Vec<HeadSource>, RenderError> {
    require("head", "none", "at least one", !heads.is_empty())?;
    let recorded = |head: &HeadSource| match head.is_builtin() {
        true => Ok(head.clone()),
        false => Ok(head.with_path(fingerprint(&head_files(head)?))),
    };
    heads.iter().map(recorded).collect()
}

/// Whether these are the heads of a set that names none.
pub(crate) fn is_default(heads: &[HeadSource]) -> bool {
    heads == [HeadSource::builtin()]
}

/// The avatar of a subject in a set of this seed, whose subjects show these heads in turn.
///
/// # Errors
/// When its files cannot be read, or it lacks the landmarks by which a camera frames a face.
pub(crate) fn of_subject(
    heads: &[HeadSource],
    seed: u64,
    subject: u32,
    who: &str,
) -> Result<Avatar, RenderError> {
    let head = &heads[subject as usize % heads.len()];
    let refused = |reason: String| RenderError::Head { who: who.to_owned(), reason };
    let seed = u64::from(Key::new(seed).scene(subject).stream("subject").bits());
    let avatar = head.avatar(seed).map_err(|error| refused(error.to_string()))?;
    match avatar.model().landmarks.len() {
        68.. => Ok(avatar),
        found => {
            Err(refused(format!("{head} has {found} landmarks; a camera frames a face by the 68 of dlib")))
        }
    }
}

/// Names and sizes of the files of a head that is not made by code.
fn head_files(head: &HeadSource) -> Result<Vec<(String, u64)>, RenderError> {
    const EXPECTED: &str = "the file or folder of a head model or avatar (docs/reference/avatar-files.md); `srflow avatar from-video` makes one of a video";
    let files = head.paths().into_iter().map(|path| files_at(&path, "head", EXPECTED));
    Ok(files.collect::<Result<Vec<_>, _>>()?.concat())
}
