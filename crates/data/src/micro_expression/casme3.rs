//! Micro-expressions of CAS(ME)³, part A (Li et al. 2022).
//!
//! Spreadsheet `cas(me)3_part_A_ME_label_JpgIndex_v2.xlsx`; frames `SUBJECT/VIDEO/color/FRAME.jpg`, from 1. Clips are excerpts of videos,
//! which are letters: the clip of video `e` from frame 62 on is `e_62`. The apex of 55 clips is their onset.

use std::path::Path;

use super::coded::{self, Coding, Objective, Repair};
use super::forms;
use super::frames::{ClipFolders, below};
use super::{Annotation, ClipKind, ClipSource, MicroExpressionError};

pub(super) const KIND: ClipKind = ClipKind::new(
    "casme3",
    "CAS(ME)³, micro-expressions of part A",
    |source| coded::read(&CODING, source),
    folders,
);

const CODING: Coding = Coding {
    form: &forms::CASME3_MICRO,
    onset: "Onset",
    apex: Some("Apex"),
    offset: "Offset",
    action_units: "AU",
    emotion: "emotion",
    of_videos: true,
    emotions: &["disgust", "surprise", "others", "fear", "anger", "sad", "happy"],
    emotions_called: "CAS(ME)³'s seven",
    objective: Objective::Roman("Objective class"),
    repairs: &REPAIRS,
    ..Coding::COMMON
};

/// Mistyped frames of the second edition. There is no frame 0.
const REPAIRS: [Repair; 6] = [
    Repair { subject: "spNO.149", clip: "d", wrong: [112, 83, 358], right: [112, 123, 358] },
    Repair { subject: "spNO.214", clip: "c", wrong: [5, 5, 3460], right: [5, 5, 34] },
    Repair { subject: "spNO.216", clip: "d", wrong: [3647, 2668, 2694], right: [2647, 2668, 2694] },
    Repair { subject: "spNO.216", clip: "e", wrong: [0, 0, 25], right: [1, 1, 25] },
    Repair { subject: "spNO.40", clip: "e", wrong: [1812, 1824, 0], right: [1812, 1824, 1845] },
    Repair { subject: "spNO.40", clip: "e", wrong: [2327, 2363, 0], right: [2327, 2363, 2403] },
];

fn folders(source: &ClipSource, annotations: &[Annotation]) -> Result<ClipFolders, MicroExpressionError> {
    let folders = |root: &Path, annotation: &Annotation| {
        let video = annotation.clip.rsplit_once('_').map_or(annotation.clip.as_str(), |(video, _)| video);
        let subject = root.join(&annotation.subject);
        // A row writes the letter of its video large.
        [video.to_lowercase(), video.to_uppercase()].map(|video| subject.join(video).join("color"))
    };
    below("casme3", &source.dir, &[("", ""), ("part_A", ""), ("ME_A", "")], annotations, folders)
}
