use srflow_field::{FlowField, Image, Mask};

/// One pair of frames of a dataset, decoded; everything is of the frames' size.
#[derive(Debug, Clone, PartialEq)]
pub struct Sample {
    /// Frame 1.
    pub frame1: Image,
    /// Frame 2.
    pub frame2: Image,
    /// True flow from frame 1 to frame 2 in pixels, NaN where it is unknown; none where no truth is published.
    pub flow: Option<FlowField>,
    /// `true` on the head in frame 1, where the dataset has masks.
    pub mask: Option<Mask>,
    /// `true` where a pixel of frame 1 is hidden in frame 2 or leaves the image, where the dataset says so.
    pub occlusion: Option<Mask>,
}
