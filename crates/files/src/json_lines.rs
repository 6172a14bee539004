//! Logs in the JSON Lines format: one JSON object per line.
//!
//! Each object ends with a member `crc32`, the CRC-32 of the line without it in hexadecimal, by which a program that reads its own
//! log again detects changed lines. Lines without it, which earlier versions wrote, are read as they are.

use std::fs::{File, OpenOptions};
use std::io::{self, Write};
use std::path::{Path, PathBuf};

use serde::Serialize;
use serde::de::DeserializeOwned;

use srflow_core::excerpt;

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
    let mut line = sealed_json(record)?;
    line.push('\n');
    file.write_all(line.as_bytes())
}

/// A record as a line of JSON without a line break that [`parse_sealed_json`] verifies. It must be an object with members.
///
/// # Errors
/// When it cannot be written as JSON.
pub fn sealed_json(record: &impl Serialize) -> serde_json::Result<String> {
    let mut line = serde_json::to_string(record)?;
    let sum = crc32fast::hash(line.as_bytes());
    if let Some('}') = line.pop() {
        line += &format!("{SEAL}{sum:08x}\"}}");
        Ok(line)
    } else {
        Err(serde::ser::Error::custom("a record is an object"))
    }
}

/// Start of the last member of a sealed object.
const SEAL: &str = ",\"crc32\":\"";

/// Why a line is no record.
#[derive(Debug, thiserror::Error)]
pub enum RecordError {
    /// It is not what [`sealed_json`] wrote.
    #[error("the line has changed since it was written (CRC-32 {now}, then {written})")]
    Changed { now: String, written: String },
    #[error("{}", parse_error_in_words(.0))]
    Parse(#[from] serde_json::Error),
}

/// Reads a line of [`sealed_json`], or of plain JSON.
///
/// # Errors
/// When it has changed, or is not valid.
pub fn parse_sealed_json<R: DeserializeOwned>(line: &str) -> Result<R, RecordError> {
    let sealed = line.strip_suffix("\"}").and_then(|line| line.rsplit_once(SEAL));
    let Some((record, written)) = sealed.filter(|(_, sum)| sum.len() == 8) else {
        return Ok(serde_json::from_str(line)?);
    };
    let record = format!("{record}}}");
    let now = format!("{:08x}", crc32fast::hash(record.as_bytes()));
    if now != written {
        return Err(RecordError::Changed { now, written: excerpt(written) });
    }
    Ok(serde_json::from_str(&record)?)
}

/// Reads the records of a log. A last line without a line break, which a killed run may have left, is skipped.
///
/// # Errors
/// When the file cannot be read, or a line is not a valid record.
pub fn read_json_lines<R: DeserializeOwned>(path: &Path) -> Result<Vec<R>, FileError> {
    let text = read_text(path, FileKind::Log)?;
    let whole = text.rfind('\n').map_or("", |end| &text[..end]);
    let record = |(number, line): (usize, &str)| {
        parse_sealed_json(line).map_err(|error| {
            let found = format!("line {}: {error}", number + 1);
            FileProblem::field("log", "a record per line as this version writes them", found).in_file(path)
        })
    };
    whole.lines().enumerate().map(record).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[derive(Debug, PartialEq, serde::Serialize, serde::Deserialize)]
    #[serde(deny_unknown_fields)]
    struct Step {
        step: u32,
    }

    fn numbers(path: &Path) -> Vec<u32> {
        read_json_lines::<Step>(path).unwrap().iter().map(|record| record.step).collect()
    }

    #[test]
    fn a_truncated_log_continues_from_the_last_record_kept() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("log.jsonl");
        let mut log = JsonLines::open::<Step>(&path, |_| true).unwrap();
        (1..=15).for_each(|step| log.append(&Step { step }).unwrap());
        drop(log);
        let text = std::fs::read_to_string(&path).unwrap();
        std::fs::write(&path, &text[..text.len() - 2]).unwrap();
        assert_eq!(numbers(&path).len(), 14);
        let mut log = JsonLines::open(&path, |record: &Step| record.step <= 3).unwrap();
        log.append(&Step { step: 4 }).unwrap();
        assert_eq!(numbers(&path), [1, 2, 3, 4]);
    }

    #[test]
    fn a_broken_line_is_named() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("log.jsonl");
        std::fs::write(&path, "{\"step\":1}\n{\"step\":\"two\"}\n{\"step\":3}\n").unwrap();
        let error = read_json_lines::<Step>(&path).unwrap_err().to_string();
        assert!(error.contains("log.jsonl") && error.contains("line 2: string \"two\""), "{error}");
        std::fs::write(&path, "{\"step\":1}\n").unwrap();
        assert_eq!(numbers(&path), [1], "lines of earlier versions");
    }

    #[test]
    fn no_flipped_bit_changes_what_is_read() {
        let line = sealed_json(&Step { step: 41 }).unwrap();
        let json: serde_json::Value = serde_json::from_str(&line).unwrap();
        assert_eq!((&json["step"], json["crc32"].as_str().map(str::len)), (&41.into(), Some(8)));
        for bit in 0..8 * line.len() {
            let mut bytes = line.clone().into_bytes();
            bytes[bit / 8] ^= 1 << (bit % 8);
            if let Ok(text) = String::from_utf8(bytes)
                && let Ok(step) = parse_sealed_json::<Step>(&text)
            {
                assert_eq!(step, Step { step: 41 }, "{text}");
            }
        }
        let changed = parse_sealed_json::<Step>(&line.replace("41", "14")).unwrap_err().to_string();
        assert!(changed.contains("has changed since it was written"), "{changed}");
    }
}
