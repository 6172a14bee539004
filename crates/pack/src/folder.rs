//! The folder of a packed dataset, and what is in it while tars are missing.

use std::path::{Path, PathBuf};
use std::{fs, io};

use serde_json::json;
use srflow_core::{SettingError, excerpt};
use srflow_files::{
    FileError, FileKind, FileProblem, SHA256SUMS, create_folder, read_file, read_json_lines, write_file,
};

use crate::error::{PackError, ReadError};
use crate::index::INDEX_NAME;
use crate::packed::{Shard, WholeTar};
use crate::settings::PackSettings;
use crate::source::Source;
use crate::split::SceneSplit;
use crate::{card, croissant};

/// Name of the file with the arguments in a packed dataset.
pub(crate) const ARGUMENTS_NAME: &str = "pack.json";
/// Name of the file with a line for each tar, which is written last.
pub(crate) const TARS_NAME: &str = "tars.jsonl";
/// Folder of the parts of the index while tars are missing.
pub(crate) const PARTS: &str = ".index";
const PACK_VERSION: u32 = 1;

/// The tars of a dataset that is packed already; `None` while it is not.
pub(crate) fn finished(out: &Path) -> Result<Option<Vec<WholeTar>>, PackError> {
    let path = out.join(TARS_NAME);
    if !path.exists() {
        return Ok(None);
    }
    let tars: Vec<WholeTar> = read_json_lines(&path)?;
    for tar in &tars {
        let path = out.join(&tar.name);
        let found = fs::metadata(&path).map_or(0, |metadata| metadata.len());
        if found != tar.size {
            let reason = format!(
                "expected {} bytes, found {found}; copy it again, or give `force` to pack everything again",
                tar.size
            );
            return Err(ReadError::Content { path, reason }.into());
        }
    }
    Ok(Some(tars))
}

/// Makes the folder ready: its arguments are the same, or it is empty.
pub(crate) fn prepare(
    source: &Source,
    settings: PackSettings,
    out: &Path,
    force: bool,
) -> Result<(), PackError> {
    create_folder(out)?;
    let arguments = json!({
        "pack_version": PACK_VERSION,
        "srflow_version": env!("CARGO_PKG_VERSION"),
        "flow": settings.flow.name(),
        "shard_size": settings.shard_size.bytes,
        "command": source.command,
        "dataset": source.description,
    });
    let mut arguments = serde_json::to_string_pretty(&arguments).unwrap_or_default();
    arguments.push('\n');
    let path = out.join(ARGUMENTS_NAME);
    let existing = if path.exists() { Some(read_file(&path, FileKind::Json)?) } else { None };
    let same = existing.as_deref() == Some(arguments.as_bytes());
    if force || !same {
        clear(out, force)?;
        write_file(&path, &arguments)?;
    }
    Ok(())
}

/// Deletes a packed dataset if `force` allows it. Nothing else may be in the folder.
fn clear(out: &Path, force: bool) -> Result<(), PackError> {
    let failed = |doing, path: &Path| {
        let path = path.to_owned();
        move |error| PackError::File(FileProblem::Io { doing, error }.in_file(&path))
    };
    let mut own = Vec::new();
    for entry in fs::read_dir(out).map_err(failed("listing the folder", out))? {
        let path = entry.map_err(failed("listing the folder", out))?.path();
        let name = path.file_name().map(|name| name.to_string_lossy().into_owned()).unwrap_or_default();
        let is_own = [
            ARGUMENTS_NAME,
            SHA256SUMS,
            INDEX_NAME,
            TARS_NAME,
            PARTS,
            card::NAME,
            croissant::NAME,
            card::PICTURES,
        ]
        .contains(&name.as_str())
            || SceneSplit::ALL
                .iter()
                .any(|split| name.starts_with(&format!("{split}-")) && name.ends_with(".tar"));
        match is_own {
            true => own.push(path),
            // Version control of those who publish datasets.
            false if name.starts_with('.') => {}
            false => {
                let name = excerpt(&name);
                return Err(PackError::Setting(SettingError {
                    field: "out",
                    found: format!("{name} in {}", out.display()),
                    expected: "an empty folder, or one with a packed dataset".to_owned(),
                }));
            }
        }
    }
    if !own.is_empty() && !force {
        let found = "it has files of a dataset that was packed with other arguments".to_owned();
        return Err(PackError::Occupied { dir: out.to_owned(), found });
    }
    for path in own {
        let removed = if path.is_dir() { fs::remove_dir_all(&path) } else { fs::remove_file(&path) };
        removed.map_err(failed("removing", &path))?;
    }
    Ok(())
}

/// The file with the part of the index for a tar.
pub(crate) fn part_of(out: &Path, shard: &Shard) -> PathBuf {
    out.join(PARTS).join(format!("{}.jsonl", shard.name()))
}

/// The file that says that a tar is whole.
pub(crate) fn note_of(out: &Path, shard: &Shard) -> PathBuf {
    out.join(PARTS).join(format!("{}.json", shard.name()))
}

/// What is known of a tar, if it is whole.
pub(crate) fn whole(out: &Path, shard: &Shard) -> Result<Option<WholeTar>, PackError> {
    let note = note_of(out, shard);
    if !note.exists() || !part_of(out, shard).exists() {
        return Ok(None);
    }
    let tar = read_json_lines::<WholeTar>(&note)?.pop();
    let size = fs::metadata(out.join(shard.name())).map(|metadata| metadata.len());
    Ok(tar.filter(|tar| tar.pairs == shard.count && size.is_ok_and(|size| size == tar.size)))
}

pub(crate) fn remove_parts(parts: &Path) -> Result<(), FileError> {
    match fs::remove_dir_all(parts) {
        Err(error) if error.kind() != io::ErrorKind::NotFound => {
            Err(FileProblem::Io { doing: "removing the folder", error }.in_file(parts))
        }
        _ => Ok(()),
    }
}
