//! SRFlow as written by `srflow render`: `dataset.json` lists the scenes, their splits and their files (see
//! [`crate::manifest`]).

use std::path::{Path, PathBuf};

use super::file::Folders;
use super::gaps::Gaps;
use super::sequence::Direction;
use super::{DatasetError, Entry, EntryFile, Kind, Occlusion, Request, Split, Truth};
use crate::listing;
use crate::manifest::{MANIFEST_NAME, Manifest, SceneEntry, SceneSplit};

pub(super) const KIND: Kind = Kind {
    name: "srflow",
    options: &[Direction::CHOICES],
    about: "SRFlow, as `srflow render` makes it",
    default_split: Split::Test,
    truth: Truth::USUAL,
    pairs,
};

fn pairs(request: &Request, gaps: &mut Gaps) -> Result<Vec<Entry>, DatasetError> {
    let Request { dir, split, .. } = *request;
    let direction = Direction::of(request.options[0]);
    request.require(MANIFEST_NAME)?;
    let manifest = Manifest::read(dir)?;
    if direction == Direction::Backward && !manifest.arguments.backward {
        let reason = "this dataset has no backward flow; `srflow render --backward` writes one".to_owned();
        return Err(DatasetError::Format { path: dir.join(MANIFEST_NAME), reason });
    }
    let wanted = split.of_scenes();
    let chosen = |scene: &&SceneEntry| wanted.is_none_or(|split| scene.split == split);
    if !manifest.scenes.iter().any(|scene| chosen(&scene)) {
        return Err(request.no_split(&splits_of(&manifest)));
    }
    let mut complete = Vec::new();
    for scene in manifest.scenes.iter().filter(chosen) {
        // A pair's record is written last, so the records count the complete pairs.
        let records = dir.join(scene.split.to_string()).join("pairs").join(&scene.name);
        let whole = listing::files_if_there(&records, &["json"])?.len();
        if u64::from(scene.pairs) > whole as u64 {
            let advice = "run `srflow render` with the same arguments to render the rest";
            gaps.push(format!("{}: {whole} of {} pairs exist; {advice}", scene.name, scene.pairs));
        } else {
            complete.push(scene);
        }
    }
    let mut entries = Vec::new();
    // A list that grows is in memory twice.
    _ = entries.try_reserve_exact(complete.iter().map(|scene| scene.pairs as usize).sum());
    let mut folders = Folders::default();
    for scene in complete {
        for pair in 0..scene.pairs {
            let entry = entry(direction, &manifest, dir, scene, pair, &mut folders);
            let record = manifest.files(dir, scene, pair).record;
            let needed = entry.files().filter_map(EntryFile::on_disk).chain([record]);
            let missing: Vec<PathBuf> = needed.filter(|path| !path.is_file()).collect();
            for path in &missing {
                gaps.push(format!("no {}", gaps.shown(path)));
            }
            if missing.is_empty() {
                entries.push(entry);
            }
            gaps.listed(1);
        }
    }
    Ok(entries)
}

fn entry(
    direction: Direction,
    manifest: &Manifest,
    dir: &Path,
    scene: &SceneEntry,
    pair: u32,
    folders: &mut Folders,
) -> Entry {
    let files = manifest.files(dir, scene, pair);
    let (frames, flow, occlusion) = match direction {
        Direction::Forward => ([pair, pair.saturating_add(1)], Some(files.flow), Some(files.occlusion)),
        Direction::Backward => ([pair.saturating_add(1), pair], files.flow_backward, None),
    };
    // They are of frame 1's pixels alone.
    let [head_flow, expression_flow] =
        [files.head_flow, files.expression_flow].map(|path| path.filter(|_| direction == Direction::Forward));
    let [first, second] = frames.map(|frame| manifest.frame_files(dir, scene, frame));
    Entry {
        scene: scene.name.clone(),
        frame: listing::stem(&first.frame),
        frame1: folders.file(first.frame),
        frame2: folders.file(second.frame),
        flow: flow.map(|path| folders.file(path)),
        head_flow: head_flow.map(|path| folders.file(path).into()),
        expression_flow: expression_flow.map(|path| folders.file(path).into()),
        mask: Some(folders.file(first.mask)),
        occlusion: occlusion.map(|path| Occlusion::Picture(folders.file(path))),
        regions: first.regions.map(|path| folders.file(path)),
        depth: first.depth.map(|path| folders.file(path)),
    }
}

/// The splits that have scenes, with their numbers of pairs.
fn splits_of(manifest: &Manifest) -> String {
    let mut parts = Vec::new();
    for split in SceneSplit::ALL {
        let pairs: u64 = manifest.scenes_of(split).map(|scene| u64::from(scene.pairs)).sum();
        if pairs > 0 {
            parts.push(format!("{split} ({pairs} pairs)"));
        }
    }
    if parts.is_empty() { "none".to_owned() } else { parts.join(", ") }
}
