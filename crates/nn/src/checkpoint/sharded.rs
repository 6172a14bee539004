//! Checkpoints in several files, with an index that says which tensor is in which: `model.safetensors.index.json` of Hugging
//! Face's libraries.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::{Read, Seek};
use std::path::Path;

use serde::Deserialize;
use srflow_core::excerpt;

use super::{Contents, Format, contents_of, recognized};
use crate::weights::WeightsError;

/// Largest index. That of a network of ten thousand tensors has a megabyte.
const MAX_INDEX_BYTES: u64 = 16 << 20;

#[derive(Deserialize)]
struct Index {
    /// The file of each tensor.
    weight_map: BTreeMap<String, String>,
}

/// The tensors of all files of an index, which are in its folder.
pub(super) fn contents(path: &Path, mut file: File) -> Result<Contents, WeightsError> {
    let broken = |problem: String| WeightsError::broken(path, Format::Sharded, &problem);
    let mut text = String::new();
    file.rewind().map_err(|error| broken(error.to_string()))?;
    file.take(MAX_INDEX_BYTES).read_to_string(&mut text).map_err(|error| broken(error.to_string()))?;
    let index: Index = serde_json::from_str(&text).map_err(|error| {
        broken(format!("its JSON is wrong: {}", srflow_files::parse_error_in_words(&error)))
    })?;
    let mut names_of_files = BTreeMap::<&str, Vec<&str>>::new();
    for (name, file) in &index.weight_map {
        names_of_files.entry(file).or_default().push(name);
    }
    let mut all = Contents::from(BTreeMap::new());
    for (file, names) in names_of_files {
        if file.contains(['/', '\\']) || file.starts_with('.') {
            return Err(broken(format!(
                "it places tensors in {}, which is no file beside it",
                excerpt(file)
            )));
        }
        let path = path.with_file_name(file);
        let (part, len, format) = recognized(&path)?;
        if format == Format::Sharded {
            return Err(broken(format!("it places tensors in {}, which is an index itself", excerpt(file))));
        }
        let mut part = contents_of(&path, part, len, format)?;
        for name in names {
            match part.tensors.remove(name) {
                Some(tensor) => _ = all.tensors.insert(name.to_owned(), tensor),
                None if !part.others.contains_key(name) => {
                    let (file, name) = (excerpt(file), excerpt(name));
                    return Err(broken(format!("it places {name} in {file}, which has no such tensor")));
                }
                None => {}
            }
        }
        all.others.append(&mut part.others);
        all.shard_bytes = all.shard_bytes.saturating_add(len).saturating_add(part.shard_bytes);
    }
    Ok(all)
}
