//! Frames, dense flow and masks under a [`Geometry`]: only the crop is computed. Interpolated as OpenCV's `resize` does with
//! `INTER_LINEAR`: pixel `x` after scaling sits at `(x + 0.5) / scale - 0.5` before, and the border pixel is repeated.

use srflow_field::{FlowField, Image, Mask};

use super::geometry::Geometry;

/// Where one pixel reads along one axis: between `near` and `far`, at `part` of the way. Where `part` is 0 the two are one.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Tap {
    near: usize,
    far: usize,
    part: f32,
}

/// Fixed-point one of OpenCV's weights for 8-bit pictures.
const ONE: i32 = 1 << 11;

impl Tap {
    /// The weights of near and far in fixed point.
    fn weights(self) -> [i32; 2] {
        [1.0 - self.part, self.part].map(|part| (part * ONE as f32).round_ties_even() as i32)
    }
}

impl Geometry {
    /// A frame, with OpenCV's fixed-point arithmetic.
    pub(super) fn frame(&self, frame: &Image) -> Image {
        let [columns, rows] = [self.taps(0), self.taps(1)];
        let columns: Vec<(usize, usize, [i32; 2])> =
            columns.iter().map(|tap| (tap.near, tap.far, tap.weights())).collect();
        let [width, height] = self.crop;
        let mut near = StretchedRow::new(width);
        let mut far = StretchedRow::new(width);
        let mut out = Image::new(width, height);
        for (out, tap) in out.pixels_mut().chunks_exact_mut(width).zip(&rows) {
            if far.row == Some(tap.near) || near.row == Some(tap.far) {
                std::mem::swap(&mut near, &mut far);
            }
            near.fill(frame, tap.near, &columns);
            far.fill(frame, tap.far, &columns);
            let [a, b] = tap.weights();
            let values = near.values.iter().zip(&far.values);
            for (out, (near, far)) in out.as_flattened_mut().iter_mut().zip(values) {
                *out = ((((a * (near >> 4)) >> 16) + ((b * (far >> 4)) >> 16) + 2) >> 2) as u8;
            }
        }
        out
    }

    /// A flow known nearly everywhere, in pixels after scaling. What comes from an unknown pixel is unknown.
    pub(super) fn dense_flow(&self, flow: &FlowField) -> FlowField {
        let [columns, rows] = [self.taps(0), self.taps(1)];
        let factor = self.flow_factor();
        FlowField::from_fn(self.crop[0], self.crop[1], |x, y| {
            let (column, row) = (columns[x], rows[y]);
            let along = |y: usize| {
                let (near, far) = (flow.get(column.near, y), flow.get(column.far, y));
                [0, 1].map(|c| near[c] * (1.0 - column.part) + far[c] * column.part)
            };
            let (near, far) = (along(row.near), along(row.far));
            let between = [0, 1].map(|c| (near[c] * (1.0 - row.part) + far[c] * row.part) * factor[c]);
            if between.iter().all(|c| c.is_finite()) { between } else { [f32::NAN; 2] }
        })
    }

    /// A mask: true where its interpolation is above a half.
    pub(super) fn mask(&self, mask: &Mask) -> Mask {
        let [columns, rows] = [self.taps(0), self.taps(1)];
        Mask::from_fn(self.crop[0], self.crop[1], |x, y| {
            let (column, row) = (columns[x], rows[y]);
            let along = |y: usize| {
                let [near, far] = [column.near, column.far].map(|x| f32::from(u8::from(mask.get(x, y))));
                near * (1.0 - column.part) + far * column.part
            };
            along(row.near) * (1.0 - row.part) + along(row.far) * row.part > 0.5
        })
    }

    /// What a displacement is multiplied by, for u and v.
    pub(super) fn flow_factor(&self) -> [f32; 2] {
        [0, 1].map(|i| if self.flip[i] { -self.scale[i] as f32 } else { self.scale[i] as f32 })
    }

    /// What each column (axis 0) or row (axis 1) of the crop reads.
    fn taps(&self, axis: usize) -> Vec<Tap> {
        let (last, step) = (self.size[axis] as i64 - 1, 1.0 / self.scale[axis]);
        let tap = |place: usize| {
            let place = self.corner[axis] + place;
            let place = if self.flip[axis] { self.scaled[axis] - 1 - place } else { place };
            let position = ((place as f64 + 0.5) * step - 0.5) as f32;
            let part = position - position.floor();
            let pixel = |place: i64| place.clamp(0, last) as usize;
            let near = position.floor() as i64;
            Tap { near: pixel(near), far: pixel(near + i64::from(part > 0.0)), part }
        };
        (0..self.crop[axis]).map(tap).collect()
    }
}

/// A row of a frame, resized along the row, in fixed point.
struct StretchedRow {
    row: Option<usize>,
    values: Vec<i32>,
}

impl StretchedRow {
    fn new(width: usize) -> Self {
        Self { row: None, values: vec![0; 3 * width] }
    }

    fn fill(&mut self, frame: &Image, row: usize, columns: &[(usize, usize, [i32; 2])]) {
        if self.row == Some(row) {
            return;
        }
        self.row = Some(row);
        let line = frame.row(row);
        for (out, (near, far, [a, b])) in self.values.as_chunks_mut::<3>().0.iter_mut().zip(columns) {
            let (near, far) = (line[*near], line[*far]);
            *out = std::array::from_fn(|c| i32::from(near[c]) * a + i32::from(far[c]) * b);
        }
    }
}
