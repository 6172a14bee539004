//! Frames, dense flow and masks under a [`Geometry`]: computes only the crop, with the interpolation of OpenCV's `resize`
//! with `INTER_LINEAR`.

use srflow_core::resize::{LinearTap, sample_flow, sample_image, sample_mask};
use srflow_core::{FlowField, Image, Mask};

use super::geometry::Geometry;

impl Geometry {
    pub(super) fn frame(&self, frame: &Image) -> Image {
        sample_image(frame, &self.taps(0), &self.taps(1))
    }

    /// A mostly known flow, in pixels after scaling. A pixel with an unknown source is unknown.
    pub(super) fn dense_flow(&self, flow: &FlowField) -> FlowField {
        sample_flow(flow, &self.taps(0), &self.taps(1), self.flow_factor())
    }

    /// A mask: true where its interpolation is above one half.
    pub(super) fn mask(&self, mask: &Mask) -> Mask {
        sample_mask(mask, &self.taps(0), &self.taps(1))
    }

    /// The factor of a displacement, for u and v.
    pub(super) fn flow_factor(&self) -> [f32; 2] {
        [0, 1].map(|i| if self.flip[i] { -self.scale[i] as f32 } else { self.scale[i] as f32 })
    }

    /// The sources of each column (axis 0) or row (axis 1) of the crop.
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
