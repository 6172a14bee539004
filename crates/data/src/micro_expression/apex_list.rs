//! Lists of apex frames, with the columns of the list published with CapsuleNet for micro-expressions.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use srflow_files::write_atomically;

use super::sheet::read_csv;
use super::{Clip, ClipSource, DropReason, MicroExpressionError};

/// A list of apex frames of one dataset.
#[derive(Default)]
pub struct ApexList {
    path: PathBuf,
    /// Row and apex, by subject and clip without leading zeros: SMIC's clips are `s01_ne_02` in some lists and `s1_ne_02` in others, and
    /// subjects `sub01`, `01` or `1`.
    rows: BTreeMap<(String, String), (usize, u64)>,
}

impl ApexList {
    /// The list of `source`, or the first of these files in its folder; empty without one.
    ///
    /// # Errors
    /// When it lacks a column (data, subject, clip, apex_frame), or an apex of this dataset is no frame number.
    pub fn of(source: &ClipSource, beside: &[&str]) -> Result<Self, MicroExpressionError> {
        let beside = || beside.iter().map(|name| source.dir.join(name)).find(|path| path.is_file());
        let Some(path) = source.apex_list.clone().or_else(beside) else { return Ok(Self::default()) };
        let kind = source.kind.name;
        let table = read_csv(kind, &path, &["data", "subject", "clip", "apex_frame"])?;
        let mut rows = BTreeMap::new();
        for row in table.rows().filter(|row| row.text("data").eq_ignore_ascii_case(kind)) {
            let key = key(row.filled("subject")?, row.filled("clip")?);
            rows.insert(key, (row.number(), row.frame("apex_frame")?));
        }
        Ok(Self { path, rows })
    }

    /// The apex of a clip, if it is listed.
    ///
    /// # Errors
    /// When it is not after the onset, or after the offset.
    pub fn apex(
        &self,
        subject: &str,
        clip: &str,
        [onset, offset]: [u64; 2],
    ) -> Result<Option<u64>, MicroExpressionError> {
        let Some(&(row, apex)) = self.rows.get(&key(subject, clip)) else { return Ok(None) };
        if apex <= onset || apex > offset {
            let reason = format!(
                "apex_frame: expected a frame after the onset {onset} and not after the offset {offset} of {clip}, found {apex}"
            );
            return Err(MicroExpressionError::Row { path: self.path.clone(), row, reason });
        }
        Ok(Some(apex))
    }

    /// The listed apex of a clip whose annotated one cannot be used, for this reason; `None` if it is to be spotted.
    ///
    /// # Errors
    /// Those of [`Self::apex`]. Within, the reason, if the clip has to be dropped.
    pub fn instead(
        &self,
        source: &ClipSource,
        subject: &str,
        clip: &str,
        frames: [u64; 2],
        reason: DropReason,
    ) -> Result<Result<Option<u64>, DropReason>, MicroExpressionError> {
        if source.published_list() {
            return Ok(Err(reason));
        }
        Ok(match self.apex(subject, clip, frames)? {
            None if !source.spots_apexes => Err(reason),
            apex => Ok(apex),
        })
    }
}

fn key(subject: &str, clip: &str) -> (String, String) {
    let number = subject.trim_start_matches(|c: char| !c.is_ascii_digit());
    let subject = if number.is_empty() { subject } else { number };
    (without_zeros(subject), without_zeros(clip))
}

/// Lower case, and every number in its shortest form.
fn without_zeros(name: &str) -> String {
    let mut short = String::new();
    for c in name.trim().chars() {
        let after_zero = short.ends_with('0')
            && !short[..short.len() - 1].ends_with(|before: char| before.is_ascii_digit());
        if c.is_ascii_digit() && after_zero {
            short.pop();
        }
        short.push(c.to_ascii_lowercase());
    }
    short
}

/// A clip and its spotted apex.
#[derive(Debug, Clone, Copy)]
pub struct ApexRow<'a> {
    pub clip: &'a Clip,
    /// Number of the frame.
    pub apex: u64,
}

/// Writes a list of apex frames, whole or not at all. Rows of SMIC can be read back with the clips.
///
/// # Errors
/// When the file cannot be written.
pub fn write_apex_list(path: &Path, rows: &[ApexRow]) -> Result<(), MicroExpressionError> {
    write_atomically(path, |writer| {
        let mut table = csv::Writer::from_writer(writer);
        table.write_record([
            "data",
            "subject",
            "clip",
            "label",
            "onset_frame",
            "apex_frame",
            "offset_frame",
        ])?;
        for ApexRow { clip, apex } in rows {
            let a = &clip.annotation;
            table.write_record([
                clip.dataset.as_str(),
                &a.subject,
                &a.clip,
                &a.class.to_string(),
                &a.onset.to_string(),
                &apex.to_string(),
                &a.offset.to_string(),
            ])?;
        }
        table.flush()
    })?;
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn zeros_before_numbers_do_not_count() {
        assert_eq!(key("sub01", "EP02_01f"), key("1", "ep2_1F"));
        assert_eq!(key("01", "s01_ne_02"), ("1".to_owned(), "s1_ne_2".to_owned()));
        assert_eq!(key("anna", "100_000"), ("anna".to_owned(), "100_0".to_owned()));
        assert_ne!(key("1", "a_10"), key("1", "a_1"));
    }
}
