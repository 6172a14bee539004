//! Spring: `{train,test}/0001/frame_{left,right}/frame_left_0001.png` at 1920x1080 and
//! `train/0001/flow_{FW,BW}_{left,right}/flow_FW_left_0001.flo5` at 3840x2160, in pixels of the 1920x1080 image; `test` has no
//! truth. The top left flow sample of each 2x2 block is used, which puts the truth on the image's grid.
//! Layout: ptlflow 0.4.2, data/datasets.py, `SpringDataset` (with `subsample`).

use super::gaps::Gaps;
use super::layout;
use super::sequence::{Direction, Sequence};
use super::{DatasetError, Entry, Kind, Request, Split, Truth};
use crate::listing;

pub(super) const KIND: Kind = Kind {
    name: "spring",
    options: &[Direction::CHOICES, &["left", "right"]],
    about: "Spring",
    default_split: Split::All,
    truth: Truth { samples_per_pixel: 2, ..Truth::USUAL },
    pairs,
};

fn pairs(request: &Request, gaps: &mut Gaps) -> Result<Vec<Entry>, DatasetError> {
    let split = request.split;
    let part = match split {
        Split::Train | Split::All => "train",
        Split::Test => "test",
        Split::Val => return Err(request.no_split("train (all), test (frames only)")),
    };
    let (direction, camera) = (Direction::of(request.options[0]), request.options[1]);
    let letters = match direction {
        Direction::Forward => "FW",
        Direction::Backward => "BW",
    };
    let mut entries = Vec::new();
    for folder in listing::folders(&request.require(part)?)? {
        let frame_dir = folder.join(format!("frame_{camera}"));
        if !frame_dir.is_dir() {
            gaps.push(format!("no folder {}", gaps.shown(&frame_dir)));
            continue;
        }
        let flow_dir = folder.join(format!("flow_{letters}_{camera}"));
        let sequence = Sequence {
            scene: listing::name(&folder),
            frames: layout::numbered(&frame_dir, &["png"], gaps)?,
            flows: match split {
                Split::Test => None,
                _ => Some(layout::numbered_if_there(&flow_dir, &["flo5"], gaps)?),
            },
            occlusions: layout::Numbered::new(),
            flow_dir: &flow_dir,
            flow_past_the_end: false,
        };
        entries.extend(sequence.pairs(direction, gaps));
    }
    Ok(entries)
}
