//! Lists of apex frames, with the columns of the list published with CapsuleNet for micro-expressions.

use std::path::Path;

use srflow_files::write_atomically;

use super::{Clip, MicroExpressionError};

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
