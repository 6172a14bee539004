//! Frames, dense flow and masks under a [`Geometry`]: only the crop is computed, interpolated as OpenCV's `resize` does with
//! `INTER_LINEAR`.

use srflow_field::resize::{LinearTap, sample_flow, sample_image, sample_mask};
use srflow_field::{FlowField, Image, Mask};

use super::geometry::Geometry;

impl Geometry {
    pub(super) fn frame(&self, frame: &Image) -> Image {
        sample_image(frame, &self.taps(0), &self.taps(1))
    }

    /// A flow known nearly everywhere, in pixels after scaling. What comes from an unknown pixel is unknown.
    pub(super) fn dense_flow(&self, flow: &FlowField) -> FlowField {
        sample_flow(flow, &self.taps(0), &self.taps(1), self.flow_factor())
    }

    /// A mask: true where its interpolation is above a half.
    pub(super) fn mask(&self, mask: &Mask) -> Mask {
        sample_mask(mask, &self.taps(0), &self.taps(1))
    }

    /// What a displacement is multiplied by, for u and v.
    pub(super) fn flow_factor(&self) -> [f32; 2] {
        [0, 1].map(|i| if self.flip[i] { -self.scale[i] as f32 } else { self.scale[i] as f32 })
    }

    /// What each column (axis 0) or row (axis 1) of the crop reads.
    fn taps(&self, axis: usize) -> Vec<LinearTap> {
        let step = 1.0 / self.scale[axis];
        let tap = |place: usize| {
            let place = self.corner[axis] + place;
            let place = if self.flip[axis] { self.scaled[axis] - 1 - place } else { place };
            LinearTap::at(((place as f64 + 0.5) * step - 0.5) as f32, self.size[axis])
        };
        (0..self.crop[axis]).map(tap).collect()
    }
}
