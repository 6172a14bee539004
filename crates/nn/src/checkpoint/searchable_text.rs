//! What a checkpoint says of itself in words: its file's name, hyper-parameters, keys beside the weights.

use std::io::{BufReader, Read};
use std::path::Path;

use srflow_field::{FileKind, open_file};
use zip::ZipArchive;

use crate::weights::WeightsError;

/// Words stand before the weights, within so many bytes.
const MOST: u64 = 4 << 20;

/// Name and words of a checkpoint file in lower case, of ASCII letters and digits alone: `SEA-RAFT` is `searaft`. The words
/// are those of the pickle of a PyTorch file and of what stands before the weights in others.
///
/// # Errors
/// When the file cannot be read.
pub fn words(path: &Path) -> Result<String, WeightsError> {
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
                pickle.take(MOST).read_to_end(&mut bytes).map_err(read_error)?;
            }
        }
        Err(_) => {
            let (file, _) = open_file(path, FileKind::Checkpoint)?;
            file.take(MOST).read_to_end(&mut bytes).map_err(read_error)?;
        }
    }
    let kept = |byte: u8| match byte {
        b'-' | b'_' => None,
        byte if byte.is_ascii_alphanumeric() => Some(char::from(byte.to_ascii_lowercase())),
        _ => Some(' '),
    };
    Ok(bytes.into_iter().filter_map(kept).collect())
}
