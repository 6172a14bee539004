//! The two parts of a flow: that of the head, and that of the expression.
//!
//! The flow of the head is exact for a head that moves, with its camera, while its face stays as in the first frame. The flow of the expression
//! is what the motion of the face adds to it, so the two add up to the whole. In perspective, and where the head turns, two motions that
//! are each rendered alone do not: the expression moves with the head. What is left of a flow without the motion of the
//! head is this one.

use srflow_avatar::{Avatar, PosedHead};
use srflow_core::FlowField;
use srflow_head::HeadPose;
use srflow_splat::{Camera, DeviceRasterizer, Frame, Gaussians, Next, Options, Outputs, RasterizeError};

/// A head as a camera sees it.
#[derive(Clone, Copy)]
pub(crate) struct Seen<'a> {
    pub pose: &'a HeadPose,
    pub camera: &'a Camera,
}

/// The parts of a flow. Keeps its buffers.
#[derive(Debug, Default)]
pub(crate) struct FlowParts {
    posed: PosedHead,
    moved: Gaussians,
    head: Frame,
}

impl FlowParts {
    /// The flow of the head and that of the expression, of the `whole` flow from a frame to the next. `gaussians` are those of the first
    /// frame.
    ///
    /// # Errors
    /// When the Gaussians or a camera are refused.
    pub fn of(
        &mut self,
        whole: &FlowField,
        rasterizer: &mut DeviceRasterizer,
        avatar: &Avatar,
        gaussians: &Gaussians,
        [first, next]: [Seen<'_>; 2],
    ) -> Result<(&FlowField, FlowField), RasterizeError> {
        let moved = avatar.model().with_head_of(first.pose, next.pose);
        avatar.gaussians_into(&moved, &mut self.posed, &mut self.moved);
        let options = Options { outputs: Outputs { flow: true, ..Outputs::NONE }, ..Options::default() };
        let next = Next { gaussians: &self.moved, camera: next.camera };
        rasterizer.render(gaussians, first.camera, Some(next), &options, &mut self.head)?;
        let head = &self.head.flow;
        let pixels = whole.pixels().iter().zip(head.pixels());
        let rest = pixels.map(|(whole, head)| [whole[0] - head[0], whole[1] - head[1]]).collect();
        Ok((head, FlowField::from_buffer(whole.width(), whole.height(), rest)))
    }
}
