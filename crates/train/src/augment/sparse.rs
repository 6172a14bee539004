//! Sparse flow under a [`Geometry`].

use srflow_core::FlowField;

use super::geometry::Geometry;

impl Geometry {
    /// Moves each known pixel to the nearest new one. If several meet, the last in row order wins; a new pixel that none moves to
    /// is unknown (core/utils/augmentor.py, `resize_sparse_flow_map`, which also drops the first row and column).
    pub(super) fn sparse_flow(&self, flow: &FlowField) -> FlowField {
        let mut out = FlowField::filled(self.crop[0], self.crop[1], [f32::NAN; 2]);
        let factor = self.flow_factor();
        let [columns, rows] = [self.destinations(0), self.destinations(1)];
        for (y, row) in rows.iter().enumerate() {
            let Some(row) = *row else { continue };
            for (pixel, column) in flow.row(y).iter().zip(&columns) {
                if let Some(column) = *column
                    && pixel.iter().all(|c| c.is_finite())
                {
                    out.set(column, row, [pixel[0] * factor[0], pixel[1] * factor[1]]);
                }
            }
        }
        out
    }

    /// The target column (axis 0) or row (axis 1) of the crop for each one before.
    fn destinations(&self, axis: usize) -> Vec<Option<usize>> {
        let destination = |place: usize| {
            let place = (place as f64 * self.scale[axis]).round_ties_even() as usize;
            let place = if self.flip[axis] { (self.scaled[axis] - 1).checked_sub(place)? } else { place };
            place.checked_sub(self.corner[axis]).filter(|place| *place < self.crop[axis])
        };
        (0..self.size[axis]).map(destination).collect()
    }
}
