//! FlyingThings3D: `frames_{clean,final}pass/{TRAIN,TEST}/{A,B,C}/0000/{left,right}/0006.png` and
//! `optical_flow/…/{into_future,into_past}/{left,right}/OpticalFlowIntoFuture_0006_L.pfm`.
//! Layout: SKFlow, core/datasets.py, `FlyingThings3D`; ptlflow 0.4.2, data/datasets.py, `FlyingThings3DDataset`.

use std::path::Path;

use super::gaps::Gaps;
use super::layout;
use super::sequence::{Direction, Sequence};
use super::{DatasetError, Entry, Kind, Request, Split, Truth};

pub(super) const KIND: Kind = Kind {
    name: "things",
    options: &[&["clean", "final"], Direction::CHOICES, &["left", "right"]],
    about: "FlyingThings3D",
    default_split: Split::Test,
    truth: Truth { max_flow: 1000.0, ..Truth::USUAL },
    pairs,
};

fn pairs(request: &Request, gaps: &mut Gaps) -> Result<Vec<Entry>, DatasetError> {
    let Request { dir, split, .. } = *request;
    let parts: &[&str] = match split {
        Split::Train => &["TRAIN"],
        Split::Val | Split::Test => &["TEST"],
        Split::All => &["TRAIN", "TEST"],
    };
    let folders = [&format!("frames_{}pass", request.options[0]), "optical_flow"];
    let mut entries = Vec::new();
    for place in layout::places(&request.title, dir, parts, folders, gaps)? {
        entries.extend(sequence(request, &place, gaps)?);
    }
    Ok(entries)
}

/// The pairs of one sequence, e.g. `TRAIN/A/0000`.
fn sequence(request: &Request, place: &str, gaps: &mut Gaps) -> Result<Vec<Entry>, DatasetError> {
    let (dir, options) = (request.dir, &request.options);
    let (pass, direction, camera) = (options[0], Direction::of(options[1]), options[2]);
    let folder = match direction {
        Direction::Forward => "into_future",
        Direction::Backward => "into_past",
    };
    let inner = Path::new(place).join(folder).join(camera);
    let frame_dir = dir.join(format!("frames_{pass}pass")).join(place).join(camera);
    let flow_dir = dir.join("optical_flow").join(&inner);
    if !frame_dir.is_dir() {
        gaps.push(format!("no folder {}", gaps.shown(&frame_dir)));
        return Ok(Vec::new());
    }
    let sequence = Sequence {
        scene: format!("{place}/{camera}"),
        frames: layout::numbered(&frame_dir, &["png"], gaps)?,
        flows: Some(layout::numbered_if_there(&flow_dir, &["pfm"], gaps)?),
        // Published only with the "subset" edition.
        occlusions: layout::numbered_if_there(&dir.join("occlusions").join(&inner), &["png"], gaps)?,
        flow_dir: &flow_dir,
        flow_past_the_end: true,
    };
    Ok(sequence.pairs(direction, gaps))
}
