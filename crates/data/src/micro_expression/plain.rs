//! Users' own clips: a `clips.csv` with one row per clip, next to the clips' folders.
//!
//! Columns: `clip` (folder of the frames, or a video, relative to the CSV file), `subject`, `onset`, `apex`, `offset` (frame numbers as
//! in the pictures' names, or from 1 in a video; the apex may be empty) and `class` (a class's name or number, or an emotion that belongs
//! to one). Optional: `label`, `action_units` and `objective`.

use std::path::{Path, PathBuf};

use srflow_files::write_atomically;

use super::classes::Coded;
use super::frames::ClipFolders;
use super::sheet::{Row, read_csv};
use super::{Annotation, Classes, ClipKind, ClipSource, DropReason, Dropped, Labels, MicroExpressionError};
use crate::listing;

pub(super) const KIND: ClipKind = ClipKind {
    name: "clips",
    releases: &[],
    about: "your own clips, listed in a clips.csv",
    published: None,
    megc2019: None,
    takes_apex_list: false,
    labels: read,
    folders,
};

pub const PLAIN_NAME: &str = "clips.csv";

pub const PLAIN_COLUMNS: [&str; 6] = ["clip", "subject", "onset", "apex", "offset", "class"];

impl ClipSource {
    /// Plain clips in a folder.
    pub(crate) fn plain(dir: &Path) -> Self {
        Self::new(&KIND, dir)
    }

    /// Where the clips of these annotations are: folders, or videos. Empty if none is found.
    pub fn places(&self, annotations: &[Annotation]) -> Vec<PathBuf> {
        if self.kind != &KIND {
            let found = (self.kind.folders)(self, annotations);
            return found.map(|found| found.folders).unwrap_or_default();
        }
        let root = root_of(self);
        annotations.iter().map(|annotation| root.join(&annotation.clip)).collect()
    }
}

/// The CSV file of a source: the file itself, or `clips.csv` in its folder.
fn file_of(source: &ClipSource) -> PathBuf {
    match &source.annotations {
        Some(path) => path.clone(),
        None if source.dir.is_file() => source.dir.clone(),
        None => source.dir.join(PLAIN_NAME),
    }
}

fn read(source: &ClipSource) -> Result<Labels, MicroExpressionError> {
    let file = file_of(source);
    if !file.is_file() {
        return Err(MicroExpressionError::NoAnnotations {
            kind: "clips",
            dir: source.dir.clone(),
            expected: "clips.csv (columns clip, subject, onset, apex, offset, class)",
            found: listing::contents(&source.dir),
        });
    }
    let table = read_csv("clips", &file, &PLAIN_COLUMNS)?;
    let (mut annotations, mut dropped) = (Vec::new(), Vec::new());
    for row in table.rows() {
        let class = class_of(source, row)?;
        let (onset, offset) = (row.frame("onset")?, row.frame("offset")?);
        let apex = if row.text("apex").is_empty() { None } else { Some(row.frame("apex")?) };
        if onset >= offset || apex.is_some_and(|apex| apex <= onset || apex > offset) {
            let found = apex.map_or("none".to_owned(), |apex| apex.to_string());
            return Err(row.wrong(format!(
                "expected onset < apex <= offset, found onset {onset}, apex {found}, offset {offset}"
            )));
        }
        let (subject, clip) = (row.filled("subject")?.to_owned(), row.filled("clip")?.to_owned());
        let label = if row.text("label").is_empty() { row.text("class") } else { row.text("label") };
        let label = label.to_owned();
        let Some(class) = class else {
            dropped.push(Dropped { subject, clip, label, reason: DropReason::Label });
            continue;
        };
        annotations.push(Annotation {
            subject,
            clip,
            class,
            label,
            action_units: row.text("action_units").to_owned(),
            onset,
            apex,
            offset,
        });
    }
    Ok(Labels { dataset: name_of(&file), file: Some(file), annotations, dropped, notes: Vec::new() })
}

/// The class named by a row, or matched by the data of the clip. Every clip must have one of the default classes, so that a
/// misspelt one is noticed.
fn class_of(source: &ClipSource, row: Row) -> Result<Option<usize>, MicroExpressionError> {
    let classes = &source.classes;
    let text = row.text("class");
    let coded = |emotion| {
        let (action_units, objective) = (row.text("action_units"), row.text("objective"));
        classes.of(&Coded { kind: "clips", emotion, action_units, objective })
    };
    let class = classes.named(text).or_else(|| coded(text)).or_else(|| coded(row.text("label")));
    if class.is_none() && classes.are_default() {
        let text = row.filled("class")?;
        return Err(row.wrong(format!(
            "class: `{text}` is not a class; expected negative, positive or surprise, or its number 0, 1 or 2. Other \
             classes need `classes`"
        )));
    }
    Ok(class)
}

/// The folder's name: identifies a plain dataset among several.
fn name_of(file: &Path) -> String {
    let full = std::path::absolute(file).unwrap_or_else(|_| file.to_owned());
    full.parent().map(listing::name).filter(|name| !name.is_empty()).unwrap_or_else(|| "clips".to_owned())
}

fn root_of(source: &ClipSource) -> PathBuf {
    file_of(source).parent().unwrap_or(Path::new("")).to_owned()
}

fn folders(source: &ClipSource, annotations: &[Annotation]) -> Result<ClipFolders, MicroExpressionError> {
    let (root, folders) = (root_of(source), source.places(annotations));
    let found = |folder: &PathBuf| folder.is_dir() || source.frames_of_videos.contains_key(folder);
    if let Some(first) = folders.first()
        && !folders.iter().any(found)
    {
        return Err(MicroExpressionError::NoFolders {
            kind: "clips",
            looked_for: first.display().to_string(),
            found: format!(
                "{}. Clips are folders of frames, relative to the CSV file",
                listing::contents(&root)
            ),
        });
    }
    Ok(ClipFolders { folders, root, form: "", alone: false })
}

/// Writes a CSV file for the kind `clips`, whole or not at all.
///
/// # Errors
/// When it cannot be written.
pub fn write_plain(path: &Path, classes: &Classes, rows: &[Annotation]) -> Result<(), MicroExpressionError> {
    let header = PLAIN_COLUMNS.into_iter().chain(["label", "action_units"]);
    write_atomically(path, |writer| {
        let mut table = csv::Writer::from_writer(writer);
        table.write_record(header)?;
        for row in rows {
            table.write_record([
                row.clip.as_str(),
                &row.subject,
                &row.onset.to_string(),
                &row.apex.map(|apex| apex.to_string()).unwrap_or_default(),
                &row.offset.to_string(),
                &classes.names()[row.class],
                &row.label,
                &row.action_units,
            ])?;
        }
        table.flush()
    })?;
    Ok(())
}
