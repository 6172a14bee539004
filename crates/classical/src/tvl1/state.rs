//! The unknowns and the data of one scale, interleaved by row: all quantities of a row are contiguous, and so is a band of
//! rows.

use rayon::prelude::*;
use srflow_core::Plane;

use crate::planar::PlanarFlow;

/// Padding before a line's first pixel and after its last, so that reading neighbours needs no bounds checks.
pub const MARGIN: usize = 8;

/// The memory layout of a scale's quantities.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Layout {
    pub width: usize,
    pub height: usize,
    /// Unknown functions: `u`, `v`, and the brightness change when it is estimated.
    pub components: usize,
    /// Numbers from one line to the next.
    pub stride: usize,
}

impl Layout {
    pub fn new(width: usize, height: usize, brightness: bool) -> Self {
        let stride = (width + 2 * MARGIN).next_multiple_of(16);
        Self { width, height, components: if brightness { 3 } else { 2 }, stride }
    }

    /// Numbers in a row's unknowns: for each component its value and the two parts of its dual variable.
    pub fn unknowns(&self) -> usize {
        3 * self.components * self.stride
    }

    /// Numbers in a row's data.
    pub fn data(&self) -> usize {
        4 * self.stride
    }
}

/// Fewest rows of a task: fewer are done before another thread has woken up.
pub fn rows_per_task(width: usize) -> usize {
    const PIXELS: usize = 1 << 13;
    PIXELS.div_ceil(width.max(1))
}

/// The lines of one row's unknowns. Each line starts with [`MARGIN`] numbers of padding.
pub fn value_line(component: usize) -> usize {
    component
}

/// The line of a component's dual variable along the row (`part` 0) or down the column (`part` 1).
pub fn dual_line(components: usize, component: usize, part: usize) -> usize {
    components + 2 * component + part
}

/// The flow and its dual variables.
#[derive(Debug, Clone)]
pub struct State {
    pub layout: Layout,
    pub rows: Vec<f32>,
}

impl State {
    /// The initial state: the given flow, with all dual variables zero.
    pub fn new(layout: Layout, flow: &PlanarFlow, brightness: Option<&Plane>) -> Self {
        let mut rows = vec![0.0; layout.unknowns() * layout.height];
        let planes = [Some(&flow.u), Some(&flow.v), brightness];
        let lines = rows.par_chunks_exact_mut(layout.unknowns()).enumerate();
        lines.with_min_len(rows_per_task(layout.width)).for_each(|(y, row)| {
            for (line, plane) in row.chunks_exact_mut(layout.stride).zip(planes.iter().flatten()) {
                line[MARGIN..MARGIN + layout.width].copy_from_slice(plane.row(y));
            }
        });
        Self { layout, rows }
    }

    pub fn row(&self, y: usize) -> &[f32] {
        &self.rows[y * self.layout.unknowns()..(y + 1) * self.layout.unknowns()]
    }

    /// The values of a component in row `y`.
    pub fn values(&self, y: usize, component: usize) -> &[f32] {
        let start = value_line(component) * self.layout.stride + MARGIN;
        &self.row(y)[start..start + self.layout.width]
    }

    /// The flow, and the brightness change when it is estimated.
    pub fn into_planes(self) -> (PlanarFlow, Option<Plane>) {
        let (width, height) = (self.layout.width, self.layout.height);
        let plane = |component: usize| {
            let mut plane = Plane::new(width, height);
            let lines = plane.pixels_mut().par_chunks_exact_mut(width).enumerate();
            lines.with_min_len(rows_per_task(width)).for_each(|(y, out)| {
                out.copy_from_slice(self.values(y, component));
            });
            plane
        };
        let brightness = (self.layout.components == 3).then(|| plane(2));
        (PlanarFlow { u: plane(0), v: plane(1) }, brightness)
    }
}

/// The residual of the data term as a linear function of the flow: `constant + x u + y v`.
#[derive(Debug, Clone)]
pub struct Linearized {
    pub layout: Layout,
    /// Each row holds the lines `x`, `y`, `constant` and `inverse_square`, the inverse of the squared length of `(x, y)`.
    pub rows: Vec<f32>,
}

impl Linearized {
    pub fn new(layout: Layout) -> Self {
        Self { layout, rows: vec![0.0; layout.data() * layout.height] }
    }

    /// The lines of row `y`.
    pub fn lines(&self, y: usize) -> [&[f32]; 4] {
        let row = &self.rows[y * self.layout.data()..(y + 1) * self.layout.data()];
        [0, 1, 2, 3].map(|line| &row[line * self.layout.stride..(line + 1) * self.layout.stride])
    }
}
