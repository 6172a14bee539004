//! Logs in the JSON Lines format: one JSON object per line.

use std::fs::{File, OpenOptions};
use std::io::{self, Write};
use std::path::{Path, PathBuf};

use serde::Serialize;
use serde::de::DeserializeOwned;

use crate::{FileError, FileKind, FileProblem, parse_error_in_words, read_text, write_atomically};

/// A log of records, open for appending.
#[derive(Debug)]
pub struct JsonLines {
    path: PathBuf,
    file: File,
}

impl JsonLines {
    /// Opens the log at `path`, creating it if it does not exist. Of the records of an earlier run only those that `keep` are left:
    /// a run that continues from a checkpoint drops those after it.
    ///
    /// # Errors
    /// When the file cannot be read or written, or a line is not a valid record.
    pub fn open<R: Serialize + DeserializeOwned>(
        path: &Path,
        keep: impl Fn(&R) -> bool,
    ) -> Result<Self, FileError> {
        if path.exists() {
            let kept: Vec<R> = read_json_lines(path)?.into_iter().filter(keep).collect();
            write_atomically(path, |file| kept.iter().try_for_each(|record| write_line(file, record)))?;
        }
        let opened = OpenOptions::new().create(true).append(true).open(path);
        let file =
            opened.map_err(|error| FileProblem::Io { doing: "opening the log", error }.in_file(path))?;
        Ok(Self { path: path.to_owned(), file })
    }

    /// Appends a record.
    ///
    /// # Errors
    /// When the file cannot be written.
    pub fn append(&mut self, record: &impl Serialize) -> Result<(), FileError> {
        write_line(&mut self.file, record)
            .map_err(|error| FileProblem::Io { doing: "writing the log", error }.in_file(&self.path))
    }
}

fn write_line(file: &mut impl Write, record: &impl Serialize) -> io::Result<()> {
    let mut line = serde_json::to_string(record)?;
    line.push('\n');
    file.write_all(line.as_bytes())
}

/// Reads the records of a log. A last line without a line break, which a killed run may have left, is skipped.
///
/// # Errors
/// When the file cannot be read, or a line is not a valid record.
pub fn read_json_lines<R: DeserializeOwned>(path: &Path) -> Result<Vec<R>, FileError> {
    let text = read_text(path, FileKind::Log)?;
    let whole = text.rfind('\n').map_or("", |end| &text[..end]);
    let record = |(number, line): (usize, &str)| {
        serde_json::from_str(line).map_err(|error| {
            let found = format!("line {}: {}", number + 1, parse_error_in_words(&error));
            FileProblem::field("log", "a record per line as this version writes them", found).in_file(path)
        })
    };
    whole.lines().enumerate().map(record).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_truncated_log_continues_from_the_last_record_kept() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("log.jsonl");
        let mut log = JsonLines::open::<u32>(&path, |_| true).unwrap();
        (1..=15).for_each(|number| log.append(&number).unwrap());
        drop(log);
        let text = std::fs::read_to_string(&path).unwrap();
        std::fs::write(&path, &text[..text.len() - 2]).unwrap();
        assert_eq!(read_json_lines::<u32>(&path).unwrap().len(), 14);
        let mut log = JsonLines::open(&path, |record: &u32| *record <= 3).unwrap();
        log.append(&4).unwrap();
        assert_eq!(read_json_lines::<u32>(&path).unwrap(), [1, 2, 3, 4]);
    }

    #[test]
    fn a_broken_line_is_named() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("log.jsonl");
        std::fs::write(&path, "1\n\"two\"\n3\n").unwrap();
        let error = read_json_lines::<u32>(&path).unwrap_err().to_string();
        assert!(error.contains("log.jsonl") && error.contains("line 2: string \"two\""), "{error}");
    }
}
