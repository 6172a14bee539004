//! FlyingThings3D: `frames_{clean,final}pass/{TRAIN,TEST}/{A,B,C}/0000/{left,right}/0006.png` and
//! `optical_flow/…/{into_future,into_past}/{left,right}/OpticalFlowIntoFuture_0006_L.pfm`.
//! Layout: SKFlow, core/datasets.py, `FlyingThings3D`; ptlflow 0.4.2, data/datasets.py, `FlyingThings3DDataset`.

use std::path::Path;

use super::gaps::Gaps;
use super::layout;
use super::sequence::{Direction, Sequence};
use super::{DatasetError, Entry, Kind, Reader, Split, Truth};

pub(super) const KIND: Kind = Kind {
    name: "things",
    options: &[&["clean", "final"], Direction::CHOICES, &["left", "right"]],
    about: "FlyingThings3D",
    default_split: Split::Test,
    truth: Truth { max_flow: 1000.0, ..Truth::USUAL },
    reader: |chosen| {
        Box::new(FlyingThings3D { pass: chosen[0], direction: Direction::of(chosen[1]), camera: chosen[2] })
    },
};

pub struct FlyingThings3D {
    /// Rendering pass: `clean` or `final`.
    pub pass: &'static str,
    /// Camera: `left` or `right`.
    pub camera: &'static str,
    /// `into_future` or, backward, `into_past`.
    pub direction: Direction,
}

impl Reader for FlyingThings3D {
    fn name(&self) -> String {
        let right = if self.camera == "right" { "-right" } else { "" };
        format!("things-{}{}{right}", self.pass, self.direction.suffix())
    }

    fn pairs(&self, dir: &Path, split: Split, gaps: &mut Gaps) -> Result<Vec<Entry>, DatasetError> {
        let parts: &[&str] = match split {
            Split::Train => &["TRAIN"],
            Split::Val | Split::Test => &["TEST"],
            Split::All => &["TRAIN", "TEST"],
        };
        let folders = [&format!("frames_{}pass", self.pass), "optical_flow"];
        let mut entries = Vec::new();
        for place in layout::places(&self.name(), dir, parts, folders, gaps)? {
            entries.extend(self.sequence(dir, &place, gaps)?);
        }
        Ok(entries)
    }
}

impl FlyingThings3D {
    /// The pairs of one sequence, e.g. `TRAIN/A/0000`.
    fn sequence(&self, dir: &Path, place: &str, gaps: &mut Gaps) -> Result<Vec<Entry>, DatasetError> {
        let direction = match self.direction {
            Direction::Forward => "into_future",
            Direction::Backward => "into_past",
        };
        let inner = Path::new(place).join(direction).join(self.camera);
        let frame_dir = dir.join(format!("frames_{}pass", self.pass)).join(place).join(self.camera);
        let flow_dir = dir.join("optical_flow").join(&inner);
        if !frame_dir.is_dir() {
            gaps.push(format!("no folder {}", gaps.shown(&frame_dir)));
            return Ok(Vec::new());
        }
        let sequence = Sequence {
            scene: format!("{place}/{}", self.camera),
            frames: layout::numbered(&frame_dir, &["png"], gaps)?,
            flows: Some(layout::numbered_if_there(&flow_dir, &["pfm"], gaps)?),
            // Published only with the "subset" edition.
            occlusions: layout::numbered_if_there(&dir.join("occlusions").join(&inner), &["png"], gaps)?,
            flow_dir: &flow_dir,
            flow_past_the_end: true,
        };
        Ok(sequence.pairs(self.direction, gaps))
    }
}
