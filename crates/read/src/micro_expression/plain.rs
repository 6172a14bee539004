//! Anybody's clips: a `clips.csv` with a row per clip, beside the clips' folders.
//!
//! Columns: `clip` (folder of the frames, relative to the CSV file), `subject`, `onset`, `apex`, `offset` (frame numbers:
//! the last number in a picture's name; the apex may be empty) and `class` (negative, positive or surprise). `label` and
//! `action_units` may be there too.

use std::path::{Path, PathBuf};

use srflow_field::write_atomically;

use super::frames::ClipFolders;
use super::sheet::read_csv;
use super::{Annotation, ClipKind, ClipSource, Labels, MicroExpressionError};
use crate::flow::listing;

pub(super) const KIND: ClipKind = ClipKind {
    name: "clips",
    releases: &[],
    about: "anybody's clips, listed in a clips.csv",
    published: None,
    form: None,
    labels: read,
    folders,
};

/// Name of the CSV file.
pub const PLAIN_NAME: &str = "clips.csv";

/// The columns that the CSV file must have.
pub const PLAIN_COLUMNS: [&str; 6] = ["clip", "subject", "onset", "apex", "offset", "class"];

/// The CSV file that a source names: the file itself, or `clips.csv` in its folder.
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
    let mut annotations = Vec::new();
    for row in table.rows() {
        let class = row.filled("class")?.parse().map_err(|reason| row.wrong(format!("class: {reason}")))?;
        let (onset, offset) = (row.frame("onset")?, row.frame("offset")?);
        let apex = if row.text("apex").is_empty() { None } else { Some(row.frame("apex")?) };
        if onset >= offset || apex.is_some_and(|apex| apex <= onset || apex > offset) {
            let found = apex.map_or("none".to_owned(), |apex| apex.to_string());
            return Err(row.wrong(format!(
                "expected onset < apex <= offset, found onset {onset}, apex {found}, offset {offset}"
            )));
        }
        let label = row.text("label");
        annotations.push(Annotation {
            subject: row.filled("subject")?.to_owned(),
            clip: row.filled("clip")?.to_owned(),
            class,
            label: if label.is_empty() { row.text("class") } else { label }.to_owned(),
            action_units: row.text("action_units").to_owned(),
            onset,
            apex,
            offset,
        });
    }
    Ok(Labels { dataset: name_of(&file), file: Some(file), annotations, dropped: Vec::new() })
}

/// The folder's name: it tells several plain datasets apart.
fn name_of(file: &Path) -> String {
    let full = std::path::absolute(file).unwrap_or_else(|_| file.to_owned());
    full.parent().map(listing::name).filter(|name| !name.is_empty()).unwrap_or_else(|| "clips".to_owned())
}

fn folders(source: &ClipSource, annotations: &[Annotation]) -> Result<ClipFolders, MicroExpressionError> {
    let root = file_of(source).parent().unwrap_or(Path::new("")).to_owned();
    let folders: Vec<PathBuf> = annotations.iter().map(|annotation| root.join(&annotation.clip)).collect();
    if let Some(first) = folders.first()
        && !folders.iter().any(|folder| folder.is_dir())
    {
        return Err(MicroExpressionError::NoFolders {
            kind: "clips",
            looked_for: first.display().to_string(),
            found: format!("{}. Clips are folders relative to the CSV file", listing::contents(&root)),
        });
    }
    Ok(ClipFolders { folders, root, form: "" })
}

/// Writes a CSV file that the kind `clips` reads, whole or not at all.
///
/// # Errors
/// When it cannot be written.
pub fn write_plain(path: &Path, rows: &[Annotation]) -> Result<(), MicroExpressionError> {
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
                row.class.name(),
                &row.label,
                &row.action_units,
            ])?;
        }
        table.flush()
    })?;
    Ok(())
}
