use super::file::EntryFile;
use crate::listing::stem;

/// One pair of frames of a dataset: its name and its files, not decoded.
#[derive(Debug, Clone, PartialEq)]
pub struct Entry {
    /// The sequence that the pair belongs to, e.g. `alley_1`; empty for single pairs.
    pub scene: String,
    /// Name of the pair within its scene: usually the stem of frame 1's file, e.g. `frame_0001`.
    pub frame: String,
    pub frame1: EntryFile,
    pub frame2: EntryFile,
    /// File of the true flow from frame 1 to frame 2, if published.
    pub flow: Option<EntryFile>,
    /// File of the true flow with the head moving alone, if there is one: see [`Entry::read_head_flow`]. In a box, since few datasets
    /// have it.
    pub head_flow: Option<Box<EntryFile>>,
    /// File of what the expression adds to it, if there is one: see [`Entry::read_expression_flow`].
    pub expression_flow: Option<Box<EntryFile>>,
    /// File of the mask of the head in frame 1, if there is one.
    pub mask: Option<EntryFile>,
    /// Source of the occlusions of frame 1, if there is one.
    pub occlusion: Option<Occlusion>,
    /// File of the [region map](crate::region_map) of frame 1, if there is one.
    pub regions: Option<EntryFile>,
    /// File of the depth of frame 1, if there is one: see [`Entry::read_depth`].
    pub depth: Option<EntryFile>,
}

impl Entry {
    /// A pair of frames alone, named after the first.
    pub(super) fn bare(scene: String, frame1: impl Into<EntryFile>, frame2: impl Into<EntryFile>) -> Self {
        let frame1 = frame1.into();
        Self {
            scene,
            frame: stem(&frame1.path()),
            frame1,
            frame2: frame2.into(),
            flow: None,
            head_flow: None,
            expression_flow: None,
            mask: None,
            occlusion: None,
            regions: None,
            depth: None,
        }
    }

    /// `scene/frame`, or the frame alone without a scene: unique within the dataset.
    pub fn id(&self) -> String {
        if self.scene.is_empty() { self.frame.clone() } else { format!("{}/{}", self.scene, self.frame) }
    }

    /// The files of the pair.
    pub fn files(&self) -> impl Iterator<Item = &EntryFile> {
        let occlusion = self.occlusion.as_ref().map(Occlusion::file);
        let optional = [
            self.flow.as_ref(),
            self.head_flow.as_deref(),
            self.expression_flow.as_deref(),
            self.mask.as_ref(),
            occlusion,
            self.regions.as_ref(),
            self.depth.as_ref(),
        ];
        [&self.frame1, &self.frame2].into_iter().chain(optional.into_iter().flatten())
    }
}

/// The source of the pixels of frame 1 that are occluded in frame 2.
#[derive(Debug, Clone, PartialEq)]
pub enum Occlusion {
    /// A picture, white where a pixel is occluded.
    Picture(EntryFile),
    /// A flow file with the visible pixels only: pixels known only in the entry's own flow are occluded (KITTI).
    VisibleFlow(EntryFile),
}

impl Occlusion {
    pub(super) fn file(&self) -> &EntryFile {
        match self {
            Self::Picture(file) | Self::VisibleFlow(file) => file,
        }
    }
}

#[cfg(test)]
mod tests {
    use std::path::PathBuf;

    use super::super::file::Folders;
    use super::*;

    /// A list of a million pairs is in memory at once.
    #[test]
    fn pairs_are_small() {
        assert!(size_of::<Entry>() <= 288, "{}", size_of::<Entry>());
        let mut folders = Folders::default();
        let [one, other] = ["d/e/1.png", "d/e/2.png"].map(|path| folders.file(path.into()));
        let (EntryFile::OnDisk { folder, .. }, EntryFile::OnDisk { folder: same, .. }) = (&one, &other)
        else {
            panic!("{one:?}")
        };
        assert!(std::sync::Arc::ptr_eq(folder, same));
        assert_eq!((one.path(), &other), (PathBuf::from("d/e/1.png"), &PathBuf::from("d/e/2.png").into()));
        assert_eq!(EntryFile::from(PathBuf::from("..")).path(), PathBuf::from(".."));
    }
}
