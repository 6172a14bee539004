//! Paths between folders.

use std::path::{Component, Path, PathBuf};

use anyhow::{Context as _, bail};

/// The path from a folder to another one, both of which exist: relative, so that the two can be moved together.
pub fn from_to(from: &Path, to: &Path) -> anyhow::Result<PathBuf> {
    let whole =
        |path: &Path| path.canonicalize().with_context(|| format!("{}: finding the folder", path.display()));
    let (from, to) = (whole(from)?, whole(to)?);
    let (from, to): (Vec<Component>, Vec<Component>) =
        (from.components().collect(), to.components().collect());
    if from.first() != to.first() {
        bail!("the pictures and the output are on different drives; choose a folder beside the pictures");
    }
    let shared = from.iter().zip(&to).take_while(|(a, b)| a == b).count();
    let up = std::iter::repeat_n(Component::ParentDir, from.len() - shared);
    Ok(up.chain(to[shared..].iter().copied()).collect())
}
