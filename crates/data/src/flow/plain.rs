//! A plain folder of pairs, for users' own data. Three layouts:
//!
//! - `NAME_img1.png NAME_img2.png NAME_flow.flo` side by side, as FlyingChairs has them;
//! - `frames/*.png`, consecutive frames of one sequence in natural order, and `flow/` with a flow of the same name as the
//!   first frame of each pair;
//! - the same with a folder per scene: `frames/SCENE/*.png`, `flow/SCENE/*.flo`.
//!
//! `mask/`, `occlusion/` and `regions/` (or `_mask`, `_occlusion`, `_regions`) may accompany `flow/` in the same way. Without any flow the pairs have
//! no ground truth. A split `train`, `val` or `test` is a subfolder of that name with such a layout.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use super::gaps::Gaps;
use super::layout;
use super::triplets::triplets;
use super::{DatasetError, Entry, Kind, Occlusion, Request, Split, Truth};
use crate::{FrameNames, listing};

pub(super) const KIND: Kind = Kind {
    name: "folder",
    options: &[],
    about: "a plain folder of image pairs",
    default_split: Split::All,
    truth: Truth::USUAL,
    pairs,
};

fn pairs(request: &Request, gaps: &mut Gaps) -> Result<Vec<Entry>, DatasetError> {
    let Request { dir, split, .. } = *request;
    let dir = match split {
        Split::All => dir.to_owned(),
        _ => request.require(&split.to_string())?,
    };
    if dir.join("frames").is_dir() {
        return scenes(&dir, gaps);
    }
    let pairs = if dir.is_dir() { triplets(&dir, gaps)? } else { Vec::new() };
    if pairs.is_empty() && gaps.is_empty() {
        return Err(layout::nothing_fits("folder", &dir, "*_img1.* or frames/", &hint(&dir)));
    }
    Ok(pairs)
}

/// Advice for a folder that contains no pairs.
fn hint(dir: &Path) -> String {
    if dir.join("train").is_dir() || dir.join("test").is_dir() {
        return "It has splits: choose one with `split`".to_owned();
    }
    match listing::elsewhere(dir, "frames") {
        Some(place) => format!("frames/ is under {0}: give folder:{0}", place.display()),
        None => "A folder of pairs holds NAME_img1.png, NAME_img2.png, NAME_flow.flo, or frames/ and flow/"
            .to_owned(),
    }
}

fn scenes(dir: &Path, gaps: &mut Gaps) -> Result<Vec<Entry>, DatasetError> {
    let frames = dir.join("frames");
    let mut scenes = vec![String::new()];
    scenes.extend(listing::folders(&frames)?.iter().map(|folder| listing::name(folder)));
    let with_flow = dir.join("flow").is_dir();
    for part in ["flow", "mask", "occlusion", "regions"] {
        layout::folders_without(&dir.join(part), &frames, gaps)?;
    }
    let mut entries = Vec::new();
    for scene in &scenes {
        entries.extend(pairs_of_scene(dir, scene, with_flow, gaps)?);
    }
    if entries.is_empty() && gaps.is_empty() {
        let hint = "A sequence needs at least two frames, in frames/ or in frames/SCENE/";
        return Err(layout::nothing_fits("folder", &frames, "*.png", hint));
    }
    Ok(entries)
}

/// Consecutive frames of one scene, in natural order; the other files have the name of the first frame.
fn pairs_of_scene(
    dir: &Path,
    scene: &str,
    with_flow: bool,
    gaps: &mut Gaps,
) -> Result<Vec<Entry>, DatasetError> {
    let mut by_stem = |part: &str, endings: &[&str]| {
        let folder = dir.join(part).join(scene);
        if folder.is_dir() { files_by_stem(&folder, endings, gaps) } else { Ok(BTreeMap::new()) }
    };
    let mut flows = by_stem("flow", listing::FLOWS)?;
    let mut masks = by_stem("mask", listing::MASKS)?;
    let mut occlusions = by_stem("occlusion", listing::IMAGES)?;
    let mut regions = by_stem("regions", listing::IMAGES)?;
    let frames = FrameNames::new(listing::files(&dir.join("frames").join(scene), listing::IMAGES)?);
    layout::copies_are_gaps(&frames, gaps);
    let frames = frames.files();

    let mut entries = Vec::new();
    for pair in frames.windows(2) {
        let [frame1, frame2] = pair else { continue };
        let frame = listing::stem(frame1);
        let flow = flows.remove(&frame);
        if with_flow && flow.is_none() {
            let expected = Path::new("flow").join(scene).join(&frame);
            gaps.push(format!("{} has no flow {}.*", gaps.shown(frame1), expected.display()));
        }
        entries.push(Entry {
            flow: flow.map(Into::into),
            mask: masks.remove(&frame).map(Into::into),
            occlusion: occlusions.remove(&frame).map(|path| Occlusion::Picture(path.into())),
            regions: regions.remove(&frame).map(Into::into),
            ..Entry::bare(scene.to_owned(), frame1.clone(), frame2.clone())
        });
    }
    for flow in flows.values() {
        gaps.push(format!("{}: no frame of that name with a next frame after it", gaps.shown(flow)));
    }
    let last = frames.last().map(|frame| listing::stem(frame));
    let unpaired = masks.iter().chain(&occlusions).chain(&regions);
    for (name, file) in unpaired.filter(|(name, _)| Some(*name) != last.as_ref()) {
        gaps.push(format!("{}: no frame of the name {name}", gaps.shown(file)));
    }
    Ok(entries)
}

fn files_by_stem(
    dir: &Path,
    endings: &[&str],
    gaps: &mut Gaps,
) -> Result<BTreeMap<String, PathBuf>, DatasetError> {
    let mut found = BTreeMap::new();
    for path in listing::files(dir, endings)? {
        layout::insert_once(&mut found, listing::stem(&path), path, gaps);
    }
    Ok(found)
}
