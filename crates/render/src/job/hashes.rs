//! `SHA256SUMS`: the SHA-256 of every file of a complete dataset, as `sha256sum` writes and checks them.

use std::io::{self, Write};
use std::path::{Path, PathBuf};

use rayon::prelude::*;
use srflow_files::{FileKind, SHA256SUMS, hexadecimal, sha256_of_file, sha256sums_line, write_atomically};

use super::layout::Layout;
use crate::RenderError;

/// Units whose files are hashed at once.
const AT_ONCE: u32 = 256;

/// Writes [`SHA256SUMS`] into the folder of a complete dataset. Calls `on_units` with the number of units that are done.
pub(crate) fn write_hashes<L: Layout>(
    dir: &Path,
    layout: &L,
    on_units: &dyn Fn(u64),
) -> Result<(), RenderError> {
    let mut failed = None;
    let result = write_atomically(&dir.join(SHA256SUMS), |writer| {
        let mut write = |files: Vec<PathBuf>| {
            let hashes: Result<Vec<_>, _> = files.into_par_iter().map(|file| line(dir, &file)).collect();
            match hashes {
                Ok(lines) => lines.iter().try_for_each(|line| writer.write_all(line.as_bytes())),
                Err(error) => {
                    failed = Some(error);
                    Err(io::Error::other("a file of the dataset could not be read"))
                }
            }
        };
        write(
            [L::MANIFEST.into()]
                .into_iter()
                .chain(layout.others())
                .map(|name: PathBuf| dir.join(name))
                .collect(),
        )?;
        let mut done = 0;
        for (group, units) in (0..).zip(layout.groups()) {
            for first in (0..units).step_by(AT_ONCE as usize) {
                let some = first..units.min(first.saturating_add(AT_ONCE));
                done += some.len() as u64;
                write(some.flat_map(|unit| layout.files(dir, group, unit)).collect())?;
                on_units(done);
            }
        }
        Ok(())
    });
    failed.map_or(Ok(()), Err)?;
    Ok(result?)
}

/// The line of a file.
fn line(dir: &Path, file: &Path) -> Result<String, RenderError> {
    let hash = sha256_of_file(file, FileKind::OfDataset)?;
    let name = file.strip_prefix(dir).unwrap_or(file).components();
    let name: Vec<_> = name.map(|part| part.as_os_str().to_string_lossy()).collect();
    Ok(sha256sums_line(&hexadecimal(hash), &name.join("/")))
}
