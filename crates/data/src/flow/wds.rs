//! WebDataset tars, on disk or on the web: as `srflow pack` writes them, and any with the same fields.
//!
//! With `index.jsonl` beside them, a pair is read by its place in its tar; without one, the headers of all tars are read to list
//! the pairs.

use std::collections::HashSet;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use srflow_core::excerpt;
use srflow_pack::{INDEX_NAME, Listing, Member, Place, SampleMembers, expand, read_index, scan};

use super::gaps::Gaps;
use super::layout;
use super::sequence::Direction;
use super::{DatasetError, Entry, EntryFile, Kind, Occlusion, Request, Split, Truth};
use crate::listing;
use crate::manifest::SceneSplit;

pub(super) const KIND: Kind = Kind {
    name: "wds",
    options: &[Direction::CHOICES],
    about: "WebDataset tars of `srflow pack`: a folder, an http(s) address, or tars such as DIR/train-{000000..000009}.tar",
    default_split: Split::Test,
    truth: Truth::USUAL,
    pairs,
};

/// The fields that a pair is made of; others are left out of the listing.
const FIELDS: [&str; 9] =
    ["depth", "expression_flow", "flow", "frame1", "frame2", "head_flow", "mask", "occlusion", "regions"];
/// Those of a pair from the second frame to the first: a sample has masks and depth of its first frame alone.
const BACKWARD_FIELDS: [&str; 3] = ["flow_backward", "frame1", "frame2"];

fn pairs(request: &Request, gaps: &mut Gaps) -> Result<Vec<Entry>, DatasetError> {
    let Request { dir, split, .. } = *request;
    let direction = Direction::of(request.options[0]);
    let fields: &[&str] = match direction {
        Direction::Forward => &FIELDS,
        Direction::Backward => &BACKWARD_FIELDS,
    };
    let mut pairs = Pairs { split, direction, counts: [0; 4], entries: Vec::new() };
    let place = Place::of(dir);
    match tars(dir, &place)? {
        None => read_index(&place, fields, &mut |pair, about| {
            // A list that grows is in memory twice.
            if pairs.entries.is_empty() {
                _ = pairs.entries.try_reserve_exact(about);
            }
            pairs.add(pair, gaps);
        })?,
        Some(tars) => {
            for tar in tars {
                let split = split_of(&tar);
                let mut broken = None;
                let path = tar.path();
                scan(tar, &mut |members| match named(members, split) {
                    Ok(pair) => pairs.add(pair, gaps),
                    Err(reason) => broken = broken.take().or(Some(reason)),
                })?;
                if let Some(reason) = broken {
                    return Err(DatasetError::Format { path, reason });
                }
            }
        }
    }
    pairs.finish(request, gaps)
}

/// The tars whose headers must be read; `None` when there is an index.
fn tars(dir: &Path, place: &Place) -> Result<Option<Vec<Place>>, DatasetError> {
    let text = dir.to_string_lossy();
    if text.split('?').next().unwrap_or_default().ends_with(".tar") {
        let names = expand(&text).map_err(|reason| DatasetError::Format { path: dir.to_owned(), reason })?;
        return Ok(Some(names.iter().map(|name| Place::of(name.as_ref())).collect()));
    }
    let Place::Disk(folder) = place else { return Ok(None) };
    if folder.join(INDEX_NAME).exists() {
        return Ok(None);
    }
    let found = if folder.is_dir() { listing::files(folder, &["tar"])? } else { Vec::new() };
    if found.is_empty() {
        let hint = format!("A folder of `srflow pack` has {INDEX_NAME} and tars");
        return Err(layout::nothing_fits(KIND.name, folder, "*.tar", &hint));
    }
    Ok(Some(found.into_iter().map(Place::Disk).collect()))
}

/// The split of the pairs of a tar, by the first word of its name.
fn split_of(tar: &Place) -> Option<SceneSplit> {
    let path: PathBuf = tar.path();
    let name = listing::name(&path);
    match name.split(['-', '_', '.']).next()? {
        "train" | "training" => Some(SceneSplit::Train),
        "val" | "valid" | "validation" | "dev" => Some(SceneSplit::Val),
        "test" | "testing" => Some(SceneSplit::Test),
        _ => None,
    }
}

/// A sample of a tar without an index: its key is `SCENE_FRAME` or `FRAME`, in folders if it has them.
fn named(members: SampleMembers, split: Option<SceneSplit>) -> Result<Listing, String> {
    // `tar -cf a.tar .` begins every name so.
    let key = members.key.trim_start_matches("./");
    let is_safe = |part: &str| !part.is_empty() && part != "." && part != ".." && part.len() <= 200;
    let strange = |c: char| c.is_control() || matches!(c, '\\' | ':');
    if key.contains(strange) || !key.split('/').all(is_safe) {
        let key = excerpt(key);
        return Err(format!(
            "expected members with names such as scene-0003_00000.frame1.png, found `{key}`"
        ));
    }
    let is_number = |text: &str| !text.is_empty() && text.bytes().all(|byte| byte.is_ascii_digit());
    let (folder, name) = key.rsplit_once('/').map_or(("", key), |(folder, name)| (folder, name));
    let (scene, frame) = match name.rsplit_once('_') {
        Some((scene, frame)) if !scene.is_empty() && is_number(frame) => (scene, frame),
        _ => ("", name),
    };
    let parts: Vec<&str> = [folder, scene].into_iter().filter(|part| !part.is_empty()).collect();
    let (scene, frame) = (parts.join("/"), frame.to_owned());
    Ok(Listing { split, scene, frame, members })
}

/// The pairs that are found, and how many there are in each split: train, val, test, without one.
struct Pairs {
    split: Split,
    direction: Direction,
    counts: [u64; 4],
    entries: Vec<Entry>,
}

impl Pairs {
    fn add(&mut self, pair: Listing, gaps: &mut Gaps) {
        let Listing { split, scene, frame, members } = pair;
        let number = split.map_or(3, |split| split as usize);
        let chosen = self.split.of_scenes();
        // Other samples may lie beside pairs in tars that others made.
        if !members.fields().any(|field| FIELDS.contains(&field)) {
            return;
        }
        self.counts[number] += 1;
        gaps.listed(1);
        if chosen.is_some() && chosen != split {
            return;
        }
        let members = Arc::new(members);
        let file = |field| Member::of(&members, field).map(EntryFile::Member);
        let (Some(frame1), Some(frame2)) = (file("frame1"), file("frame2")) else {
            let tar = gaps.shown(&members.tar.place.path());
            gaps.push(format!("{tar}: {} has no frame1 or no frame2", excerpt(&members.key)));
            return;
        };
        self.entries.push(match self.direction {
            Direction::Forward => Entry {
                scene,
                frame,
                frame1,
                frame2,
                flow: file("flow"),
                head_flow: file("head_flow").map(Box::new),
                expression_flow: file("expression_flow").map(Box::new),
                mask: file("mask"),
                occlusion: file("occlusion").map(Occlusion::Picture),
                regions: file("regions"),
                depth: file("depth"),
            },
            Direction::Backward => {
                Entry { frame, flow: file("flow_backward"), ..Entry::bare(scene, frame2, frame1) }
            }
        });
    }

    fn finish(self, request: &Request, gaps: &mut Gaps) -> Result<Vec<Entry>, DatasetError> {
        if self.counts == [0; 4] {
            let reason = "expected pairs with members such as NAME.frame1.png, NAME.frame2.png and NAME.flow.npy, found none";
            return Err(DatasetError::Format { path: request.dir.to_owned(), reason: reason.to_owned() });
        }
        if self.entries.is_empty() && gaps.is_empty() {
            let names = ["train", "val", "test", "all, without a split"];
            let some = names.iter().zip(self.counts).filter(|(_, count)| *count > 0);
            let available: Vec<String> =
                some.map(|(name, count)| format!("{name} ({count} pairs)")).collect();
            return Err(request.no_split(&available.join(", ")));
        }
        let with_flow = self.entries.iter().any(|entry| entry.flow.is_some());
        if self.direction == Direction::Backward && !with_flow {
            let reason = "expected pairs with flow_backward, found none; `srflow pack` writes it for datasets of `srflow render --backward`";
            return Err(DatasetError::Format { path: request.dir.to_owned(), reason: reason.to_owned() });
        }
        fn name(entry: &Entry) -> (&str, &str) {
            (&entry.scene, &entry.frame)
        }
        // A set of all names takes memory, which pairs in order do not need.
        let sorted = self.entries.is_sorted_by(|a, b| name(a) < name(b));
        let mut seen = HashSet::new();
        for entry in &self.entries {
            if !sorted && !seen.insert(name(entry)) {
                gaps.push(format!("{} exists twice", excerpt(&entry.id())));
            }
            if with_flow && entry.flow.is_none() {
                gaps.push(format!("{} has no flow", excerpt(&entry.id())));
            }
        }
        Ok(self.entries)
    }
}
