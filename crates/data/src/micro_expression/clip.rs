use std::collections::BTreeMap;
use std::fmt;
use std::path::{Path, PathBuf};

use super::Annotation;

/// One clip and its frames.
#[derive(Debug, Clone, PartialEq)]
pub struct Clip {
    pub dataset: String,
    pub annotation: Annotation,
    /// The folder of its frames, or its video.
    pub folder: PathBuf,
    /// The existing frames from onset to offset, by number.
    pub frames: BTreeMap<u64, PathBuf>,
}

impl Clip {
    /// `dataset/subject/clip`: unique among all datasets.
    pub fn id(&self) -> String {
        format!("{}/{}/{}", self.dataset, self.annotation.subject, self.annotation.clip)
    }

    /// The file of a frame between onset and offset, if it exists.
    pub fn frame(&self, number: u64) -> Option<&Path> {
        self.frames.get(&number).map(PathBuf::as_path)
    }
}

/// The missing frames of one clip.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct MissingFrames {
    pub subject: String,
    pub clip: String,
    /// The folder, or the video, that was searched.
    pub folder: PathBuf,
    /// Their numbers, as inclusive ranges.
    pub numbers: Vec<(u64, u64)>,
    /// Whether onset and apex exist, so that the clip can be used with key frames alone.
    pub holds_key_frames: bool,
    /// Whether onset or apex is missing, so that the clip cannot be used.
    pub dropped: bool,
    /// Files of the folder that are not read but may be the frames, with advice.
    pub unread: Option<String>,
}

impl MissingFrames {
    /// The number of missing frames.
    pub fn count(&self) -> u64 {
        let counts = self.numbers.iter().map(|(first, last)| (last - first).saturating_add(1));
        counts.fold(0, u64::saturating_add)
    }
}

impl fmt::Display for MissingFrames {
    /// `006/006_1_2: 3 frames: 5562, 5570-5571`.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        const NAMED: usize = 6;
        let plural = if self.count() == 1 { "" } else { "s" };
        write!(f, "{}/{}: {} frame{plural}: ", self.subject, self.clip, self.count())?;
        for (at, (first, last)) in self.numbers.iter().take(NAMED).enumerate() {
            let comma = if at == 0 { "" } else { ", " };
            if first == last { write!(f, "{comma}{first}")? } else { write!(f, "{comma}{first}-{last}")? }
        }
        if self.numbers.len() > NAMED {
            write!(f, " and {} more gaps", self.numbers.len() - NAMED)?;
        }
        if !self.folder.exists() {
            write!(f, " (no folder {})", self.folder.display())?;
        }
        if let Some(unread) = &self.unread {
            write!(f, " (the folder has {unread})")?;
        }
        Ok(())
    }
}
