//! A flow field cut into strips of columns, each with its own memory, so each task can write its own strip.

use std::ops::Range;

use srflow_core::{Plane, Size};

use crate::planar::PlanarFlow;

/// The least width of a strip, except for the last: neighbouring strips both compute the overlap of the window.
const NARROWEST: usize = 96;

#[derive(Debug, Clone)]
pub struct StripedFlow {
    pub width: usize,
    pub height: usize,
    pub strips: Vec<Strip>,
    /// Columns of every strip but the last.
    strip_width: usize,
}

/// The columns from `start` to `start + width` of a flow field, row-major.
#[derive(Debug, Clone)]
pub struct Strip {
    pub start: usize,
    pub width: usize,
    pub u: Vec<f32>,
    pub v: Vec<f32>,
}

impl Strip {
    pub fn columns(&self) -> Range<usize> {
        self.start..self.start + self.width
    }
}

impl StripedFlow {
    /// Cuts a flow into about `count` strips.
    pub fn cut(flow: &PlanarFlow, count: usize) -> Self {
        let Size { width, height } = flow.u.size();
        let strip_width = width.div_ceil(count.max(1)).max(NARROWEST);
        let strip = |start: usize| {
            let width = strip_width.min(width - start);
            let cut = |plane: &Plane| plane.crop(start, 0, width, height).into_pixels();
            Strip { start, width, u: cut(&flow.u), v: cut(&flow.v) }
        };
        Self { width, height, strips: (0..width).step_by(strip_width).map(strip).collect(), strip_width }
    }

    /// `u` and `v` of a row's `columns`.
    pub fn copy_row(&self, y: usize, columns: Range<usize>, u: &mut [f32], v: &mut [f32]) {
        for strip in &self.strips[columns.start / self.strip_width..columns.end.div_ceil(self.strip_width)] {
            let start = strip.start.max(columns.start);
            let end = strip.columns().end.min(columns.end);
            let from = y * strip.width + start - strip.start..y * strip.width + end - strip.start;
            let to = start - columns.start..end - columns.start;
            u[to.clone()].copy_from_slice(&strip.u[from.clone()]);
            v[to].copy_from_slice(&strip.v[from]);
        }
    }
}

impl From<&StripedFlow> for PlanarFlow {
    fn from(flow: &StripedFlow) -> Self {
        let mut whole = Self::zero(flow.width, flow.height);
        let (u, v) = (whole.u.pixels_mut(), whole.v.pixels_mut());
        for y in 0..flow.height {
            let row = y * flow.width..(y + 1) * flow.width;
            flow.copy_row(y, 0..flow.width, &mut u[row.clone()], &mut v[row]);
        }
        whole
    }
}
