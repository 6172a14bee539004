//! DFME (Zhao et al. 2024).
//!
//! Spreadsheets `training_full_with_AU.xlsx`, `testA_full_with_AU.xlsx` and `testB_full_with_AU.xlsx`; frames `CLIP/FRAME.png`, from 0. A
//! third of the clips each has 200, 300 or 500 frames per second.

use std::path::{Path, PathBuf};

use super::coded::{self, Coding};
use super::forms;
use super::frames::{ClipFolders, below};
use super::{Annotation, ClipKind, ClipSource, MicroExpressionError};
use crate::listing;

pub(super) const KIND: ClipKind =
    ClipKind::new("dfme", "DFME", |source| coded::read(&CODING, source), folders);

const CODING: Coding = Coding {
    form: &forms::DFME,
    several_files: true,
    action_units: "AU",
    emotion: "Emotion",
    emotions: &["anger", "contempt", "disgust", "fear", "happiness", "sadness", "surprise"],
    emotions_called: "DFME's seven",
    ..Coding::COMMON
};

/// The archives of the training and test clips unpack into folders of their own, and into these again.
fn folders(source: &ClipSource, annotations: &[Annotation]) -> Result<ClipFolders, MicroExpressionError> {
    let dir = &source.dir;
    let holds_clips = |root: &PathBuf| annotations.iter().any(|a| root.join(&a.clip).is_dir());
    let mut roots = vec![dir.clone()];
    for _ in 0..2 {
        if roots.iter().any(holds_clips) {
            break;
        }
        let below = roots.iter().map(|root| listing::folders(root)).collect::<Result<Vec<_>, _>>()?;
        roots = below.into_iter().flatten().collect();
    }
    let place = |a: &Annotation| roots.iter().map(|root| root.join(&a.clip)).find(|folder| folder.is_dir());
    if annotations.iter().all(|a| place(a).is_none()) {
        return below("dfme", dir, &[("", "")], annotations, |root: &Path, a| [root.join(&a.clip)]);
    }
    let folders = annotations.iter().map(|a| place(a).unwrap_or_else(|| dir.join(&a.clip))).collect();
    Ok(ClipFolders { folders, root: dir.clone(), form: "", alone: false })
}
