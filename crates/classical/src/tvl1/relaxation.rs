//! The iterations between two warps, which alternate between the data term and smoothness.
//!
//! An iteration reads and writes the whole state, which fits in no cache. So several iterations go down the image together,
//! each one row behind the previous one, and each row is read once for all of them. The image is cut into bands for the
//! threads; a band is extended on both sides by as many rows as there are iterations, since an iteration reaches one row up
//! and down. Neither the cut into bands nor the grouping of iterations changes a bit of the result.

use rayon::prelude::*;

use super::median;
use super::parameters::TvL1Parameters;
use super::state::{Layout, Linearized, MARGIN, State, dual_line, value_line};
use crate::block::block;
use srflow_simd::multiversioned;

/// Bytes of the rows that a group of iterations touches: well within a core's second-level cache.
const CACHE: usize = 640 << 10;

/// Bands per thread: more than one, to balance the load.
const BANDS_PER_THREAD: usize = 4;
/// Fewest rows of a band, in iterations: the rows of its neighbours, which it computes too, are at most a third as many.
const ROWS_PER_ITERATION: usize = 3;

/// Constants of an iteration, in OpenCV's precision.
#[derive(Debug, Clone, Copy)]
pub struct Constants {
    /// `lambda * theta`.
    pub threshold: f32,
    pub theta: f32,
    /// `tau / theta`.
    pub step: f32,
    pub gamma: f32,
}

impl Constants {
    pub fn new(parameters: &TvL1Parameters) -> Self {
        Self {
            threshold: (parameters.lambda * parameters.theta) as f32,
            theta: parameters.theta as f32,
            step: (parameters.tau / parameters.theta) as f32,
            gamma: parameters.gamma as f32,
        }
    }
}

/// The flow of one scale while it is being computed.
pub struct Relaxation {
    pub state: State,
    pub linearized: Linearized,
    next: State,
    constants: Constants,
}

impl Relaxation {
    pub fn new(state: State, parameters: &TvL1Parameters) -> Self {
        let linearized = Linearized::new(state.layout);
        Self { next: state.clone(), linearized, state, constants: Constants::new(parameters) }
    }

    /// Median filter of every component except the brightness change.
    pub fn filter(&mut self, side: usize) {
        median::filter(&mut self.next, &self.state, side);
        std::mem::swap(&mut self.state, &mut self.next);
    }

    /// Runs `iterations` iterations, or stops when the squared change of the flow summed over the image is `limit` or less.
    /// Takes and returns the change of the latest iteration.
    pub fn run(&mut self, iterations: usize, limit: f64, mut change: f64) -> f64 {
        let mut left = iterations;
        while left > 0 {
            let together = self.iterations_together(limit, change).min(left);
            let changes = self.advance(together);
            let end = changes.iter().position(|change| *change <= limit);
            let done = end.map_or(together, |end| end + 1);
            if done < together {
                self.advance(done); // from the same state, which `advance` does not modify
            }
            std::mem::swap(&mut self.state, &mut self.next);
            change = changes[done - 1];
            if end.is_some() {
                return change;
            }
            left -= done;
        }
        change
    }

    /// How many iterations to group: few near the end, since iterations past it are wasted.
    fn iterations_together(&self, limit: f64, change: f64) -> usize {
        let layout = &self.state.layout;
        let row = size_of::<f32>() * (layout.unknowns() + layout.data());
        let most = (CACHE / row).saturating_sub(2).max(1);
        let wanted = if change.is_infinite() || change < 4.0 * limit { 2 } else { 10 };
        wanted.min(most)
    }

    /// Writes the state after `iterations` more into `next`, and returns the squared change of each.
    fn advance(&mut self, iterations: usize) -> Vec<f64> {
        let layout = self.state.layout;
        let bands = BANDS_PER_THREAD * rayon::current_num_threads();
        let band_height = layout.height.div_ceil(bands).max(ROWS_PER_ITERATION * iterations);
        let (state, linearized, constants) = (&self.state, &self.linearized, self.constants);
        let bands = self.next.rows.par_chunks_mut(band_height * layout.unknowns()).enumerate();
        let changes: Vec<Vec<f64>> = bands
            .map(|(band, out)| {
                let start = band * band_height;
                Band::new(state, linearized, constants, iterations, start).run(out)
            })
            .collect();
        // Summed row by row: independent of the bands.
        (0..iterations)
            .map(|i| changes.iter().flat_map(|rows| rows.iter().skip(i).step_by(iterations)).sum())
            .collect()
    }
}

/// A band of rows while a group of iterations passes over it.
struct Band<'a> {
    state: &'a State,
    linearized: &'a Linearized,
    constants: Constants,
    iterations: usize,
    /// The first row of the band.
    start: usize,
    /// Row `y` is at `y % capacity`.
    rows: Vec<f32>,
    capacity: usize,
    /// One line: how far the data term moves each pixel.
    pull: Vec<f32>,
    gamma_line: Vec<f32>,
    zeros: Vec<f32>,
}

impl<'a> Band<'a> {
    fn new(
        state: &'a State,
        linearized: &'a Linearized,
        constants: Constants,
        iterations: usize,
        start: usize,
    ) -> Self {
        let layout = state.layout;
        let capacity = iterations + 2;
        Self {
            state,
            linearized,
            constants,
            iterations,
            start,
            rows: vec![0.0; capacity * layout.unknowns()],
            capacity,
            pull: vec![0.0; layout.stride],
            gamma_line: vec![constants.gamma; layout.stride],
            zeros: vec![0.0; layout.stride],
        }
    }

    /// Writes the band's rows after all iterations into `out`. Returns, row by row, the squared change of each iteration.
    fn run(mut self, out: &mut [f32]) -> Vec<f64> {
        let layout = self.state.layout;
        let end = self.start + out.len() / layout.unknowns();
        let first = self.start.saturating_sub(self.iterations);
        let last = (end + self.iterations).min(layout.height);
        let mut changes = vec![0.0; (end - self.start) * self.iterations];
        let rows = layout.unknowns();
        // A row depends on its neighbours of the iteration before: each iteration needs a row less beyond the band, to either side.
        let rows_of = |i: usize| {
            let low = if first == 0 { 0 } else { first + i };
            let high = if last == layout.height { last } else { last - i };
            low..high
        };
        // At step `y` iteration `i` computes the values of row `y - i` and the dual variables of the row above it.
        for y in first..last + self.iterations {
            if y < last {
                let slot = y % self.capacity * rows;
                self.rows[slot..slot + rows].copy_from_slice(self.state.row(y));
            }
            for i in 0..self.iterations {
                let Some(row) = y.checked_sub(i).filter(|row| *row >= first) else { break };
                let needed = rows_of(i);
                if needed.contains(&row) {
                    let change = self.update_values(row, row == first);
                    if (self.start..end).contains(&row) {
                        changes[(row - self.start) * self.iterations + i] = change;
                    }
                }
                if row > needed.start && (row < needed.end || row == layout.height) {
                    self.update_duals(row - 1, row == layout.height);
                }
            }
            let Some(done) = y.checked_sub(self.iterations) else { continue };
            if (self.start..end).contains(&done) {
                let slot = done % self.capacity * rows;
                out[(done - self.start) * rows..][..rows].copy_from_slice(&self.rows[slot..slot + rows]);
            }
        }
        changes
    }

    fn line(&self, y: usize, line: usize) -> &[f32] {
        let start = y % self.capacity * self.state.layout.unknowns() + line * self.state.layout.stride;
        &self.rows[start..start + self.state.layout.stride]
    }

    /// Updates the values of row `y` from its data and dual variables. Returns their squared change.
    fn update_values(&mut self, y: usize, no_row_above: bool) -> f64 {
        let Layout { width, components, stride, .. } = self.state.layout;
        let [along, down, constant, inverse_square] = self.linearized.lines(y);
        let mut pull = std::mem::take(&mut self.pull);
        let brightness = (components == 3).then(|| self.line(y, value_line(2)));
        find_pull(
            &mut pull[..MARGIN + width],
            (along, down, constant, inverse_square),
            (self.line(y, value_line(0)), self.line(y, value_line(1)), brightness),
            self.constants,
        );
        let mut lanes = [0.0_f32; LANES];
        for component in 0..components {
            let gradient = [along, down, &self.gamma_line][component];
            let line = value_line(component) * stride;
            let (dual_along, dual_down) =
                (dual_line(components, component, 0) * stride, dual_line(components, component, 1) * stride);
            let row_len = self.state.layout.unknowns();
            let slot = y % self.capacity * row_len;
            let above_slot = (y + self.capacity - 1) % self.capacity * row_len;
            let (row, above) = two_rows(&mut self.rows, row_len, slot, above_slot);
            let above = if no_row_above { &self.zeros[..] } else { &above[dual_down..dual_down + stride] };
            let (values, duals) = row.split_at_mut(components * stride);
            let duals_start = components * stride;
            let along = &duals[dual_along - duals_start..][..stride];
            let down = &duals[dual_down - duals_start..][..stride];
            let values = &mut values[line..line + stride];
            move_values(
                values,
                width,
                (&pull, gradient),
                [along, down, above],
                self.constants.theta,
                &mut lanes,
            );
        }
        self.pull = pull;
        lanes.iter().map(|lane| f64::from(*lane)).sum()
    }

    /// Updates the dual variables of row `y` from its values and those of the row below.
    fn update_duals(&mut self, y: usize, no_row_below: bool) {
        let Layout { width, components, stride, .. } = self.state.layout;
        let row_len = self.state.layout.unknowns();
        let slot = y % self.capacity * row_len;
        let below_slot = (y + 1) % self.capacity * row_len;
        let (row, below) = two_rows(&mut self.rows, row_len, slot, below_slot);
        let (values, duals) = row.split_at_mut(components * stride);
        for component in 0..components {
            let value = &values[component * stride..][..stride];
            let below = if no_row_below { value } else { &below[component * stride..][..stride] };
            let (along, down) = duals[2 * component * stride..][..2 * stride].split_at_mut(stride);
            move_duals(along, down, value, below, width, self.constants.step);
        }
    }
}

/// One row to write and another to read.
fn two_rows(rows: &mut [f32], len: usize, written: usize, read: usize) -> (&mut [f32], &[f32]) {
    if written < read {
        let (low, high) = rows.split_at_mut(read);
        (&mut low[written..written + len], &high[..len])
    } else {
        let (low, high) = rows.split_at_mut(written);
        (&mut high[..len], &low[read..read + len])
    }
}

/// Sums of squared changes are kept per vector lane.
pub const LANES: usize = 16;

multiversioned! {
    /// The step along the gradient of the residual that brings it to zero, or as near as the threshold allows.
    fn find_pull(
        pull: &mut [f32],
        data: (&[f32], &[f32], &[f32], &[f32]),
        values: (&[f32], &[f32], Option<&[f32]>),
        constants: Constants,
    ) {
        let len = pull.len();
        let (along, down, constant, inverse_square) = (&data.0[..len], &data.1[..len], &data.2[..len], &data.3[..len]);
        let (u, v) = (&values.0[..len], &values.1[..len]);
        for x in MARGIN..len {
            pull[x] = constant[x] + (along[x] * u[x] + down[x] * v[x]);
        }
        if let Some(brightness) = values.2 {
            for (residual, brightness) in pull[MARGIN..].iter_mut().zip(&brightness[MARGIN..]) {
                *residual += constants.gamma * brightness;
            }
        }
        for x in MARGIN..len {
            let step = -pull[x] * inverse_square[x];
            let step = if step > constants.threshold { constants.threshold } else { step };
            pull[x] = if step < -constants.threshold { -constants.threshold } else { step };
        }
    }
}

multiversioned! {
    /// Updates one component's values by the data term and the divergence of the dual variable.
    fn move_values(
        values: &mut [f32],
        width: usize,
        data: (&[f32], &[f32]),
        dual: [&[f32]; 3],
        theta: f32,
        lanes: &mut [f32; LANES],
    ) {
        let ((pull, gradient), [along, down, above]) = (data, dual);
        let whole = MARGIN + width - width % LANES;
        for at in (MARGIN..whole).step_by(LANES) {
            let (pull, gradient) = (block::<LANES>(pull, at), block::<LANES>(gradient, at));
            let (before, along) = (block::<LANES>(along, at - 1), block::<LANES>(along, at));
            let (down, above) = (block::<LANES>(down, at), block::<LANES>(above, at));
            let mut moved: [f32; LANES] = block(values, at);
            for lane in 0..LANES {
                let divergence = (along[lane] - before[lane]) + (down[lane] - above[lane]);
                let change = move_value(&mut moved[lane], pull[lane] * gradient[lane], theta * divergence);
                lanes[lane] += change * change;
            }
            values[at..at + LANES].copy_from_slice(&moved);
        }
        for x in whole..MARGIN + width {
            let divergence = (along[x] - along[x - 1]) + (down[x] - above[x]);
            let change = move_value(&mut values[x], pull[x] * gradient[x], theta * divergence);
            lanes[x - whole] += change * change;
        }
        values[MARGIN + width] = values[MARGIN + width - 1]; // so that the gradient at the last column is zero
    }
}

/// Moves a value by the data term and by smoothness; returns by how much.
#[inline(always)]
fn move_value(value: &mut f32, data: f32, smoothness: f32) -> f32 {
    let moved = (*value + data) + smoothness;
    let change = moved - *value;
    *value = moved;
    change
}

multiversioned! {
    /// Updates one component's dual variable by the gradient of the values, within the unit circle.
    fn move_duals(along: &mut [f32], down: &mut [f32], values: &[f32], below: &[f32], width: usize, step: f32) {
        let pixels = MARGIN..MARGIN + width;
        let (here, right) = (&values[pixels.clone()], &values[MARGIN + 1..MARGIN + 1 + width]);
        let below = &below[pixels.clone()];
        let (along, down) = (&mut along[pixels.clone()], &mut down[pixels]);
        for x in 0..width {
            let (gradient_x, gradient_y) = (right[x] - here[x], below[x] - here[x]);
            let length = (gradient_x * gradient_x + gradient_y * gradient_y).sqrt();
            let shrink = 1.0 / (1.0 + step * length);
            along[x] = (along[x] + step * gradient_x) * shrink;
            down[x] = (down[x] + step * gradient_y) * shrink;
        }
    }
}
