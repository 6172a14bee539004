//! HD1K: `hd1k_input/image_2/000000_0010.png` (sequence and frame), `hd1k_flow_gt/flow_occ/` with the same names, and
//! `hd1k_challenge/image_2/` without ground truth.
//! Layout: SKFlow, core/datasets.py, `HD1K`; ptlflow 0.4.2, data/datasets.py, `Hd1kDataset`.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use super::gaps::Gaps;
use super::layout::{self, Numbered};
use super::sequence::{Direction, Sequence};
use super::{DatasetError, Entry, Kind, Request, Split, Truth, TruthDensity};
use crate::listing;

/// First of the sequences that ptlflow uses for validation (data/Hd1k_val.txt).
const FIRST_VALIDATION_SEQUENCE: u64 = 30;

pub(super) const KIND: Kind = Kind {
    name: "hd1k",
    options: &[],
    about: "HD1K",
    default_split: Split::All,
    truth: Truth { max_flow: 512.0, density: TruthDensity::Sparse, ..Truth::USUAL },
    pairs,
};

fn pairs(request: &Request, gaps: &mut Gaps) -> Result<Vec<Entry>, DatasetError> {
    let split = request.split;
    let part = if split == Split::Test { "hd1k_challenge" } else { "hd1k_input" };
    let mut frames = by_sequence(&request.require(&format!("{part}/image_2"))?, gaps)?;
    let mut flow_dir = PathBuf::new();
    let mut flows = BTreeMap::new();
    if split != Split::Test {
        flow_dir = request.require("hd1k_flow_gt/flow_occ")?;
        flows = by_sequence(&flow_dir, gaps)?;
        for &sequence in flows.keys() {
            frames.entry(sequence).or_default(); // so that flows without any frame are reported
        }
    }
    let mut entries = Vec::new();
    for (number, frames) in frames {
        let chosen = match split {
            Split::Train => number < FIRST_VALIDATION_SEQUENCE,
            Split::Val => number >= FIRST_VALIDATION_SEQUENCE,
            Split::Test | Split::All => true,
        };
        if !chosen {
            continue;
        }
        let sequence = Sequence {
            scene: format!("{number:06}"),
            frames,
            flows: (split != Split::Test).then(|| flows.remove(&number).unwrap_or_default()),
            occlusions: Numbered::new(),
            flow_dir: &flow_dir,
            flow_past_the_end: true,
        };
        entries.extend(sequence.pairs(Direction::Forward, gaps));
    }
    Ok(entries)
}

/// The files `SSSSSS_FFFF.png` of a folder by sequence and frame.
fn by_sequence(dir: &Path, gaps: &mut Gaps) -> Result<BTreeMap<u64, Numbered>, DatasetError> {
    let mut found: BTreeMap<u64, Numbered> = BTreeMap::new();
    for path in listing::files(dir, &["png"])? {
        let stem = listing::stem(&path);
        let numbers = stem.split_once('_').and_then(|(s, f)| Some((s.parse().ok()?, f.parse().ok()?)));
        let Some((sequence, frame)) = numbers else {
            gaps.push(format!("{}: expected a name like 000000_0010.png", gaps.shown(&path)));
            continue;
        };
        layout::insert_once(found.entry(sequence).or_default(), frame, path, gaps);
    }
    Ok(found)
}
