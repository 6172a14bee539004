//! MPI Sintel: `training/{clean,final,flow,occlusions}/SCENE/frame_0001.{png,flo}`, and `test/{clean,final}` without truth.
//! Layout: ptlflow 0.4.2, data/datasets.py, `SintelDataset`.

use super::gaps::Gaps;
use super::layout;
use super::sequence::{Direction, Sequence};
use super::{DatasetError, Entry, Kind, Request, Split, Truth};
use crate::listing;

/// The scenes of the training set that ptlflow uses for validation (data/Sintel_val.txt).
const VALIDATION_SCENES: [&str; 6] = ["ambush_2", "bamboo_2", "cave_2", "market_2", "shaman_2", "temple_2"];

pub(super) const KIND: Kind = Kind {
    name: "sintel",
    options: &[&["clean", "final"]],
    about: "MPI Sintel",
    default_split: Split::All,
    truth: Truth::USUAL,
    pairs,
};

fn pairs(request: &Request, gaps: &mut Gaps) -> Result<Vec<Entry>, DatasetError> {
    let Request { dir, split, .. } = *request;
    let part = if split == Split::Test { "test" } else { "training" };
    let frames = request.require(&format!("{part}/{}", request.options[0]))?;
    let root = dir.join(part);
    if split != Split::Test {
        request.require("training/flow")?;
    }
    if split == Split::All {
        layout::folders_without(&root.join("flow"), &frames, gaps)?;
    }
    let mut entries = Vec::new();
    for folder in listing::folders(&frames)? {
        let scene = listing::name(&folder);
        let chosen = match split {
            Split::Train => !VALIDATION_SCENES.contains(&scene.as_str()),
            Split::Val => VALIDATION_SCENES.contains(&scene.as_str()),
            Split::Test | Split::All => true,
        };
        if !chosen {
            continue;
        }
        let flow_dir = root.join("flow").join(&scene);
        let sequence = Sequence {
            frames: layout::numbered(&folder, &["png"], gaps)?,
            flows: match split {
                Split::Test => None,
                _ => Some(layout::numbered_if_there(&flow_dir, &["flo"], gaps)?),
            },
            occlusions: layout::numbered_if_there(&root.join("occlusions").join(&scene), &["png"], gaps)?,
            flow_dir: &flow_dir,
            flow_past_the_end: false,
            scene,
        };
        entries.extend(sequence.pairs(Direction::Forward, gaps));
    }
    Ok(entries)
}
