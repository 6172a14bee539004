//! KITTI 2012 and 2015: `training/image_2/000000_{10,11}.png` (2012: `colored_0`), `training/flow_occ/000000_10.png`,
//! optionally `training/flow_noc` with the visible pixels only, and `testing/` without ground truth.
//! Layout: ptlflow 0.4.2, data/datasets.py, `KittiDataset`.

use std::collections::BTreeSet;
use std::path::Path;

use super::gaps::Gaps;
use super::layout;
use super::{DatasetError, Entry, Kind, Occlusion, Request, Split, Truth, TruthDensity};
use crate::listing;

pub(super) const KIND: Kind = Kind {
    name: "kitti",
    options: &[&["2015", "2012"]],
    about: "KITTI flow of either year",
    default_split: Split::All,
    truth: Truth { max_flow: 512.0, density: TruthDensity::Sparse, ..Truth::USUAL },
    pairs,
};

fn pairs(request: &Request, gaps: &mut Gaps) -> Result<Vec<Entry>, DatasetError> {
    let Request { dir, split, .. } = *request;
    let part = match split {
        Split::Train | Split::All => "training",
        Split::Test => "testing",
        Split::Val => return Err(request.no_split("train (all), test (frames only)")),
    };
    let image_folder = if request.options[0] == "2012" { "colored_0" } else { "image_2" };
    let frame_dir = request.require(&format!("{part}/{image_folder}"))?;
    if split != Split::Test {
        request.require("training/flow_occ")?;
    }
    let root = dir.join(part);
    let entries = scenes(&frame_dir, gaps)?
        .iter()
        .filter_map(|scene| entry_of(&root, &frame_dir, scene, split != Split::Test, gaps))
        .collect();
    if split != Split::Test {
        flows_without_frames(&root, &frame_dir, gaps)?;
    }
    Ok(entries)
}

/// The numbers `SSSSSS` for which `SSSSSS_10.png` or `SSSSSS_11.png` exists. The 20 other frames of KITTI's multi-view
/// edition have no ground truth and are skipped.
fn scenes(frame_dir: &Path, gaps: &Gaps) -> Result<BTreeSet<String>, DatasetError> {
    let scene_of = |path: &Path| {
        let stem = listing::stem(path);
        stem.strip_suffix("_10").or_else(|| stem.strip_suffix("_11")).map(str::to_owned)
    };
    let scenes: BTreeSet<String> =
        listing::files(frame_dir, &["png"])?.iter().filter_map(|p| scene_of(p)).collect();
    if scenes.is_empty() {
        return Err(layout::nothing_fits(gaps.kind(), frame_dir, "*_10.png", ""));
    }
    Ok(scenes)
}

fn entry_of(root: &Path, frame_dir: &Path, scene: &str, with_flow: bool, gaps: &mut Gaps) -> Option<Entry> {
    let [frame1, frame2] = [10, 11].map(|frame| frame_dir.join(format!("{scene}_{frame}.png")));
    let truth = |folder: &str| root.join(folder).join(format!("{scene}_10.png"));
    let flow = truth("flow_occ");
    let needed = [Some(&frame1), Some(&frame2), with_flow.then_some(&flow)];
    let missing: Vec<_> = needed.into_iter().flatten().filter(|path| !path.is_file()).collect();
    for path in &missing {
        gaps.push(format!("{scene}: no {}", gaps.shown(path)));
    }
    let visible = truth("flow_noc");
    missing.is_empty().then(|| Entry {
        flow: with_flow.then(|| flow.into()),
        occlusion: (with_flow && visible.is_file()).then(|| Occlusion::VisibleFlow(visible.into())),
        ..Entry::bare(String::new(), frame1, frame2)
    })
}

fn flows_without_frames(root: &Path, frame_dir: &Path, gaps: &mut Gaps) -> Result<(), DatasetError> {
    for flow in listing::files(&root.join("flow_occ"), &["png"])? {
        let frame = frame_dir.join(listing::name(&flow));
        if !frame.is_file() {
            gaps.push(format!("{}: no frame {}", gaps.shown(&flow), gaps.shown(&frame)));
        }
    }
    Ok(())
}
