//! FlyingChairs: `data/00001_img1.ppm`, `data/00001_img2.ppm`, `data/00001_flow.flo`, and next to `data/` the file
//! `FlyingChairs_train_val.txt` with one line per pair in sorted order, 1 for training and 2 for validation.
//! Layout: SKFlow, core/datasets.py, `FlyingChairs`.

use std::path::Path;

use srflow_core::excerpt;
use srflow_files::{FileKind, read_text};

use super::gaps::Gaps;
use super::layout;
use super::triplets::triplets;
use super::{DatasetError, Entry, Kind, Request, Split, Truth};

const SPLIT_FILE: &str = "FlyingChairs_train_val.txt";

pub(super) const KIND: Kind = Kind {
    name: "chairs",
    options: &[],
    about: "FlyingChairs",
    default_split: Split::Val,
    truth: Truth::USUAL,
    pairs,
};

fn pairs(request: &Request, gaps: &mut Gaps) -> Result<Vec<Entry>, DatasetError> {
    let Request { dir, split, .. } = *request;
    let wanted = match split {
        Split::All => None,
        Split::Train => Some(1),
        Split::Val => Some(2),
        Split::Test => return Err(request.no_split("train, val, all")),
    };
    let data = request.require("data")?;
    let pairs = triplets(&data, gaps)?;
    if pairs.is_empty() && gaps.is_empty() {
        return Err(layout::nothing_fits("chairs", &data, "*_img1.ppm", ""));
    }
    for pair in pairs.iter().filter(|pair| pair.flow.is_none()) {
        gaps.push(format!("{} has no flow data/{}_flow.flo", gaps.shown(&pair.frame1.path()), pair.frame));
    }
    match wanted {
        Some(part) if gaps.is_empty() => chosen(dir, pairs, part),
        _ => Ok(pairs),
    }
}

/// The pairs whose line in the split file is `part`.
fn chosen(dir: &Path, pairs: Vec<Entry>, part: u8) -> Result<Vec<Entry>, DatasetError> {
    let path = dir.join(SPLIT_FILE);
    if !path.is_file() {
        let hint = "The list is a separate download; put it next to data/, or give `split` all, which does not need it";
        return Err(layout::nothing_fits("chairs", dir, SPLIT_FILE, hint));
    }
    let text = read_text(&path, FileKind::Table)?;
    let wrong = |reason| DatasetError::Format { path: path.clone(), reason };
    let mut parts = Vec::new();
    for (number, line) in text.lines().enumerate() {
        match line.trim() {
            "" => {}
            "1" => parts.push(1),
            "2" => parts.push(2),
            other => {
                let found = excerpt(other);
                return Err(wrong(format!("line {}: expected 1 or 2, found `{found}`", number + 1)));
            }
        }
    }
    if parts.len() != pairs.len() {
        let reason = format!(
            "{} lines for {} pairs in data/; expected one line per pair, in sorted order",
            parts.len(),
            pairs.len()
        );
        return Err(wrong(reason));
    }
    Ok(pairs.into_iter().zip(parts).filter(|(_, found)| *found == part).map(|(pair, _)| pair).collect())
}
