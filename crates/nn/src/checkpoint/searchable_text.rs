//! Text of a checkpoint that may identify its network: file name, hyper-parameters, keys next to the weights.

use std::io::{BufReader, Read};
use std::path::Path;

use srflow_files::{FileKind, open_file};
use zip::ZipArchive;

use crate::weights::WeightsError;

/// Bytes that are searched; text precedes the weights in every format.
const SEARCHED_BYTES: u64 = 4 << 20;

/// File name of a checkpoint, and the text of its pickle (PyTorch) or of its first bytes (other formats), in lower case: hyphens
/// and underscores are removed (`SEA-RAFT` becomes `searaft`), all other characters but ASCII letters and digits become spaces.
///
/// # Errors
/// When the file cannot be read.
pub fn searchable_text(path: &Path) -> Result<String, WeightsError> {
    let (file, _) = open_file(path, FileKind::Checkpoint)?;
    let read_error = |error| WeightsError::Read { path: path.to_owned(), error };
    let mut bytes = path.file_stem().unwrap_or_default().to_string_lossy().into_owned().into_bytes();
    bytes.push(b'\n');
    match ZipArchive::new(BufReader::new(&file)) {
        Ok(mut archive) => {
            let mut names = archive.file_names().filter_map(|name| name.ok().map(|name| name.into_owned()));
            let pickle = names.find(|name| name.ends_with("data.pkl"));
            drop(names);
            if let Some(Ok(pickle)) = pickle.map(|name| archive.by_name(&name)) {
                pickle.take(SEARCHED_BYTES).read_to_end(&mut bytes).map_err(read_error)?;
            }
        }
        Err(_) => {
            let (file, _) = open_file(path, FileKind::Checkpoint)?;
            file.take(SEARCHED_BYTES).read_to_end(&mut bytes).map_err(read_error)?;
        }
    }
    let kept = |byte: u8| match byte {
        b'-' | b'_' => None,
        byte if byte.is_ascii_alphanumeric() => Some(char::from(byte.to_ascii_lowercase())),
        _ => Some(' '),
    };
    Ok(bytes.into_iter().filter_map(kept).collect())
}
