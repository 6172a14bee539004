//! Sequences of numbered frames with one flow file per frame: shared by Sintel, FlyingThings3D, HD1K and Spring.

use std::path::Path;

use super::gaps::Gaps;
use super::layout::Numbered;
use super::{Entry, Occlusion};

/// Temporal direction of a pair.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Direction {
    /// From frame n to frame n + 1.
    Forward,
    /// From frame n + 1 to frame n, with the flow file of frame n + 1.
    Backward,
}

impl Direction {
    /// The options that a kind of dataset offers.
    pub const CHOICES: &[&str] = &["forward", "backward"];

    /// The direction for one of [`CHOICES`](Self::CHOICES).
    pub fn of(chosen: &str) -> Self {
        if chosen == "backward" { Self::Backward } else { Self::Forward }
    }
}

/// The numbered files of one sequence.
pub struct Sequence<'a> {
    pub scene: String,
    pub frames: Numbered,
    /// The flow files by the number of the frame they start from; `None` when no truth is published.
    pub flows: Option<Numbered>,
    /// Occlusion pictures, numbered like the flow; often empty.
    pub occlusions: Numbered,
    /// The folder in which a missing flow was expected.
    pub flow_dir: &'a Path,
    /// Whether the dataset also has a flow for the frame at its end, which leaves the sequence and is ignored.
    pub flow_past_the_end: bool,
}

impl Sequence<'_> {
    /// Pairs each frame with its neighbour. A frame or flow without a counterpart is a gap.
    pub fn pairs(mut self, direction: Direction, gaps: &mut Gaps) -> Vec<Entry> {
        let mut entries = Vec::new();
        let mut unused = self.flows.clone().unwrap_or_default();
        for ((&number, earlier), (&next, later)) in self.frames.iter().zip(self.frames.iter().skip(1)) {
            if next - number != 1 {
                gaps.push(format!(
                    "{}: the next frame is number {next}, not {}",
                    gaps.shown(earlier),
                    number + 1
                ));
                continue;
            }
            let (start, frame1, frame2) = match direction {
                Direction::Forward => (number, earlier, later),
                Direction::Backward => (next, later, earlier),
            };
            let flow = unused.remove(&start);
            if self.flows.is_some() && flow.is_none() {
                gaps.push(format!(
                    "{} has no flow of number {start} in {}",
                    gaps.shown(frame1),
                    gaps.shown(self.flow_dir)
                ));
            }
            entries.push(Entry {
                flow: flow.map(Into::into),
                occlusion: self.occlusions.remove(&start).map(|path| Occlusion::Picture(path.into())),
                ..Entry::bare(self.scene.clone(), frame1.clone(), frame2.clone())
            });
        }
        let end = match direction {
            Direction::Forward => self.frames.last_key_value(),
            Direction::Backward => self.frames.first_key_value(),
        };
        if self.flow_past_the_end
            && let Some((number, _)) = end
        {
            unused.remove(number);
        }
        for flow in unused.values() {
            gaps.push(format!("{}: no pair of frames for this flow", gaps.shown(flow)));
        }
        entries
    }
}
