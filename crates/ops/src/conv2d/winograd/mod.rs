//! Convolution with small kernels by fewer multiplications (Winograd 1980; Lavin and Gray 2016): four outputs in a row need 6
//! products for 3 taps instead of 12, and 8 for 5 taps instead of 20.
//!
//! Tiles of the input are transformed, multiplied position by position (one matrix product over the channels for each of 36 or 8
//! positions), and transformed back. Each block of tiles passes through all three steps before the next begins.

use rayon::prelude::*;
use srflow_simd::{
    Activation, Isa, MAX_LANES, Multiply, Numbers, Output, Packed, Pair, Precision, Product, Right, Scratch,
    SharedMut, Simd, Start, Steps, dispatch, dispatch_pairs, multiply, panel_columns,
};

use super::Epilogue;
use crate::convolution::Conv2dShape;

mod transforms;

use transforms::{OUTPUTS, WEIGHTS_5, input_3, input_5, output_3, output_5, weights_3};

/// Fewer channels do not pay for the transforms.
const FEWEST_CHANNELS: usize = 16;
/// Elements between the matrices of two positions: the numbers of channels are often such that, one right after another, they would
/// all lie in the same few lines of the cache.
const APART: usize = 16;
/// Pairs of input and output channels. Transformed weights take up to four times the memory of the weights; networks have more
/// pairs only in maps of so few pixels that the products saved are not worth it.
const MOST_PAIRS: usize = 1 << 19;

/// Which dimensions are transformed.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Scheme {
    /// 3x3.
    Square,
    /// 1x5.
    Row,
    /// 5x1.
    Column,
}

impl Scheme {
    /// The scheme for a convolution, if there is one.
    pub(super) fn of(shape: &Conv2dShape) -> Option<Self> {
        let [inputs, outputs] = [shape.in_channels, shape.out_channels];
        let worth_it = inputs.min(outputs) >= FEWEST_CHANNELS && inputs * outputs <= MOST_PAIRS;
        if shape.stride != [1, 1] || !worth_it {
            return None;
        }
        match shape.kernel {
            [3, 3] => Some(Scheme::Square),
            [1, 5] => Some(Scheme::Row),
            [5, 1] => Some(Scheme::Column),
            _ => None,
        }
    }

    /// Height and width of a tile's output.
    fn tile(self) -> [usize; 2] {
        match self {
            Scheme::Square => [OUTPUTS, OUTPUTS],
            Scheme::Row => [1, OUTPUTS],
            Scheme::Column => [OUTPUTS, 1],
        }
    }

    /// Positions of a transformed tile, down and across.
    fn positions(self) -> [usize; 2] {
        match self {
            Scheme::Square => [6, 6],
            Scheme::Row => [1, WEIGHTS_5.len()],
            Scheme::Column => [WEIGHTS_5.len(), 1],
        }
    }

    /// The transformed weights, a left side for each position.
    pub(super) fn pack(self, isa: Isa, precision: Precision, weight: &[f32], shape: &Conv2dShape) -> Packed {
        let pairs = shape.out_channels * shape.in_channels;
        let [down, across] = self.positions();
        // Tap by tap, so that each position is a sum of whole planes.
        let taps = weight.len() / pairs.max(1);
        let mut planes = vec![0.0; weight.len()];
        planes.par_chunks_mut(pairs).enumerate().for_each(|(tap, plane)| {
            for (to, &value) in plane.iter_mut().zip(weight[tap..].iter().step_by(taps)) {
                *to = value;
            }
        });
        let weights_3 = weights_3(precision == Precision::Bf16);
        let depths = vec![shape.in_channels; down * across];
        Packed::parts(isa, precision, shape.out_channels, &depths, |position, transformed| {
            let factors: Vec<f64> = match self {
                Scheme::Square => {
                    let (rows, columns) = (weights_3[position / across], weights_3[position % across]);
                    rows.iter().flat_map(|row| columns.iter().map(move |column| row * column)).collect()
                }
                Scheme::Row | Scheme::Column => WEIGHTS_5[position].to_vec(),
            };
            let mut sums = vec![0.0_f64; pairs];
            for (factor, plane) in factors.iter().zip(planes.chunks_exact(pairs)) {
                if *factor != 0.0 {
                    for (sum, &value) in sums.iter_mut().zip(plane) {
                        *sum += factor * f64::from(value);
                    }
                }
            }
            transformed.iter_mut().zip(sums).for_each(|(to, sum)| *to = sum as f32);
        })
    }
}

/// [`super::conv2d`] with weights from [`Scheme::pack`].
pub(super) fn convolve(
    isa: Isa,
    scheme: Scheme,
    input: &[f32],
    packed: &Packed,
    epilogue: &Epilogue,
    shape: &Conv2dShape,
) -> Vec<f32> {
    let [height, width] = shape.output();
    let [down, across] = scheme.positions();
    let positions = down * across;
    let bf16 = packed.precision() == Precision::Bf16;
    let [tile_height, tile_width] = scheme.tile();
    let grid = [height.div_ceil(tile_height), width.div_ceil(tile_width)];
    let panel = panel_columns(isa);
    let panels = (grid[0] * grid[1]).div_ceil(panel);
    let source = SourceRows::new(isa, scheme, shape);
    // Two channels are a row of pairs.
    let input_rows = if bf16 { shape.in_channels.div_ceil(2) } else { shape.in_channels };
    let [input_step, output_step] = [input_rows, shape.out_channels].map(|rows| rows * panel + APART);
    let fill = |target: SharedMut| {
        (0..shape.batch * panels).into_par_iter().for_each(|task| {
            let mut rows = Scratch::of(2 * source.rows * source.row);
            let (mut numbers, mut pairs) = if bf16 {
                (Scratch::of(0), Scratch::<Pair>::of(positions * input_step))
            } else {
                (Scratch::of(positions * input_step), Scratch::of(0))
            };
            let mut products = Scratch::of(positions * output_step + isa.lanes());
            let (n, first) = (task / panels, task % panels * panel);
            let tiles = panel.min(grid[0] * grid[1] - first);
            let runs = runs(first, tiles, grid[1]);
            let plane = shape.input[0] * shape.input[1];
            let image = &input[n * shape.in_channels * plane..][..shape.in_channels * plane];
            for row in 0..input_rows {
                let of = |channel: usize| image.get(channel * plane..(channel + 1) * plane);
                let task = InputTask {
                    scheme,
                    source: &source,
                    planes: if bf16 { [of(2 * row), of(2 * row + 1)] } else { [of(row), None] },
                    size: shape.input,
                    padding: shape.padding,
                    runs: &runs,
                    out_step: input_step,
                };
                let rows = &mut rows;
                // SAFETY: the source contains the rows of every run of two planes, the output every position.
                unsafe {
                    if bf16 {
                        let out = pairs[row * panel..].as_mut_ptr().cast();
                        transform_input_to_pairs(isa, &task, rows, out);
                    } else {
                        transform_input(isa, &task, rows, numbers[row * panel..].as_mut_ptr());
                    }
                }
            }
            for position in 0..positions {
                let at = position * input_step;
                let product = Product {
                    left: packed.part(position),
                    rows: shape.out_channels,
                    depth: shape.in_channels,
                    right: if bf16 { Right::Bf16(&pairs[at..]) } else { Right::F32(&numbers[at..]) },
                    right_panel: input_rows * panel,
                    start: Start::Zero,
                    add: None,
                    activation: Activation::Identity,
                    columns: tiles,
                };
                let out = &mut products[position * output_step..];
                let steps = Steps { row: panel, panel: shape.out_channels * panel };
                multiply(isa, &product, &mut Output::new(out, steps));
            }
            for channel in 0..shape.out_channels {
                let at = (n * shape.out_channels + channel) * height * width;
                let task = OutputTask {
                    scheme,
                    bf16,
                    products: &products[channel * panel..],
                    step: output_step,
                    runs: &runs,
                    size: [height, width],
                    bias: epilogue.bias.map_or(0.0, |bias| bias[channel]),
                    residual: epilogue.residual.map(|residual| &residual[at..at + height * width]),
                    activation: epilogue.activation,
                    out: target.at(at),
                };
                // SAFETY: the products contain every position, the output the channel's plane.
                unsafe { transform_output(isa, &task) }
            }
        });
    };
    // SAFETY: the panels cover every tile, and all outputs of each tile that are inside are written.
    unsafe { SharedMut::fill_new(shape.output_len(), fill) }
}

/// Neighbouring tiles of one row of tiles.
#[derive(Debug, Clone, Copy)]
struct Run {
    /// Index of the first tile within the panel.
    at: usize,
    row: usize,
    column: usize,
    len: usize,
}

/// The runs of `tiles` tiles from `first`, in a grid of `columns`.
fn runs(first: usize, tiles: usize, columns: usize) -> Vec<Run> {
    let mut runs = Vec::new();
    let mut at = 0;
    while at < tiles {
        let (row, column) = ((first + at) / columns, (first + at) % columns);
        let len = (columns - column).min(tiles - at);
        runs.push(Run { at, row, column, len });
        at += len;
    }
    runs
}

/// The zero-padded rows of one channel that a run of tiles reads. If tiles lie side by side, each row holds every fourth column,
/// then the next ones, and so on, so that the same position of neighbouring tiles is in neighbouring elements.
struct SourceRows {
    rows: usize,
    row: usize,
    /// Elements from the columns of one remainder modulo 4 to those of the next; 0 for columns in order.
    phase: usize,
    /// Number of columns that a tile reads beyond those of its output.
    reach: usize,
}

impl SourceRows {
    fn new(isa: Isa, scheme: Scheme, shape: &Conv2dShape) -> Self {
        let [tile_height, tile_width] = scheme.tile();
        let rows = tile_height + shape.kernel[0] - 1;
        let reach = shape.kernel[1] - 1;
        // Padded for reads and writes of whole vectors.
        let columns = (panel_columns(isa) * tile_width + reach).next_multiple_of(OUTPUTS * isa.lanes());
        let room = 2 * isa.lanes();
        if tile_width == 1 {
            return Self { rows, row: columns + room, phase: 0, reach };
        }
        let phase = columns / OUTPUTS + room;
        Self { rows, row: OUTPUTS * phase, phase, reach }
    }
}

struct InputTask<'a> {
    scheme: Scheme,
    source: &'a SourceRows,
    /// A channel, or the two of a row of pairs; a missing one is zero.
    planes: [Option<&'a [f32]>; 2],
    size: [usize; 2],
    padding: [usize; 2],
    runs: &'a [Run],
    /// Elements from one position to the next.
    out_step: usize,
}

dispatch! {
    /// Transforms the tiles of the runs of the first plane; `rows` is scratch.
    ///
    /// # Safety
    /// `rows` is twice as long as the task's [`SourceRows`] require; `out` contains every position.
    unsafe fn transform_input = transform_input_to_numbers(task: &InputTask, rows: &mut [f32], out: *mut f32)
}

dispatch_pairs! {
    /// Transforms the tiles of the runs of both planes to pairs.
    ///
    /// # Safety
    /// As for [`transform_input`].
    unsafe fn transform_input_to_pairs = transform_input_kernel(task: &InputTask, rows: &mut [f32], out: *mut f32)
}

#[inline(always)]
unsafe fn transform_input_to_numbers<S: Simd>(s: S, task: &InputTask, rows: &mut [f32], out: *mut f32) {
    // SAFETY: guaranteed by the caller.
    unsafe { transform_input_kernel(s, Numbers, task, rows, out) }
}

#[inline(always)]
unsafe fn transform_input_kernel<S: Simd, M: Multiply<S>>(
    s: S,
    how: M,
    task: &InputTask,
    rows: &mut [f32],
    out: *mut f32,
) {
    let source = task.source;
    let [tile_height, tile_width] = task.scheme.tile();
    let [height, width] = task.size;
    let (first, second) = rows.split_at_mut(source.rows * source.row);
    let mut before = Transformed([0.0; 36 * MAX_LANES]);
    let before = before.0.as_mut_ptr();
    for run in task.runs {
        let columns = run.len * tile_width + source.reach;
        for (plane, rows) in task.planes.into_iter().zip([&mut *first, &mut *second]).take(M::FACTORS) {
            for (i, row) in rows.chunks_exact_mut(source.row).take(source.rows).enumerate() {
                let y = (run.row * tile_height + i).checked_sub(task.padding[0]).filter(|&y| y < height);
                match plane.zip(y) {
                    // SAFETY: guaranteed by the caller.
                    Some((plane, y)) => unsafe {
                        let from = &plane[y * width..][..width];
                        fill_row(
                            s,
                            from,
                            run.column * tile_width,
                            task.padding[1],
                            columns,
                            source.phase,
                            row,
                        )
                    },
                    None => row.fill(0.0),
                }
            }
        }
        for x in (0..run.len).step_by(S::LANES) {
            let lanes = S::LANES.min(run.len - x);
            // SAFETY: guaranteed by the caller; all positions of a tile fit before the second plane's.
            unsafe {
                let out = Positions { first: out.add(run.at + x), step: task.out_step, lanes, before };
                if M::FACTORS == 2 {
                    let kept = Positions { first: before, step: S::LANES, lanes: S::LANES, before };
                    transform_tiles::<S, M, false>(s, how, task, first.as_ptr().add(x), &kept);
                    transform_tiles::<S, M, true>(s, how, task, second.as_ptr().add(x), &out);
                } else {
                    transform_tiles::<S, M, false>(s, how, task, first.as_ptr().add(x), &out);
                }
            }
        }
    }
}

/// The transformed tiles of neighbouring columns, one position after another.
#[repr(align(64))]
struct Transformed([f32; 36 * MAX_LANES]);

/// Where transformed tiles of neighbouring columns are stored.
struct Positions {
    first: *mut f32,
    /// Elements from one position to the next.
    step: usize,
    lanes: usize,
    /// [`Transformed`] tiles of the plane before, for pairs.
    before: *const f32,
}

/// Transforms the tiles of neighbouring columns, from the first of their rows at `from`. If `PAIRS`, what is stored are pairs with the
/// tiles of the plane before.
#[inline(always)]
unsafe fn transform_tiles<S: Simd, M: Multiply<S>, const PAIRS: bool>(
    s: S,
    how: M,
    task: &InputTask,
    from: *const f32,
    to: &Positions,
) {
    let source = task.source;
    let input = |d| if M::FACTORS == 2 { input_3::<S, true>(s, d) } else { input_3::<S, false>(s, d) };
    // SAFETY: guaranteed by the caller.
    unsafe {
        match task.scheme {
            Scheme::Square => {
                let mut down = [[s.splat(0.0); 6]; 6];
                for x in 0..6 {
                    let from = from.add(x % OUTPUTS * source.phase + x / OUTPUTS);
                    let mut column = [s.splat(0.0); 6];
                    for (y, v) in column.iter_mut().enumerate() {
                        *v = s.load(from.add(y * source.row));
                    }
                    let column = input(column);
                    for y in 0..6 {
                        down[y][x] = column[y];
                    }
                }
                for (y, row) in down.into_iter().enumerate() {
                    store_positions::<S, M, 6, PAIRS>(s, how, to, 6 * y, input(row));
                }
            }
            Scheme::Row => {
                let mut row = [s.splat(0.0); 8];
                for (x, v) in row.iter_mut().enumerate() {
                    *v = s.load(from.add(x % OUTPUTS * source.phase + x / OUTPUTS));
                }
                store_positions::<S, M, 8, PAIRS>(s, how, to, 0, input_5(s, row));
            }
            Scheme::Column => {
                let mut column = [s.splat(0.0); 8];
                for (y, v) in column.iter_mut().enumerate() {
                    *v = s.load(from.add(y * source.row));
                }
                store_positions::<S, M, 8, PAIRS>(s, how, to, 0, input_5(s, column));
            }
        }
    }
}

#[inline(always)]
unsafe fn store_positions<S: Simd, M: Multiply<S>, const N: usize, const PAIRS: bool>(
    s: S,
    how: M,
    positions: &Positions,
    first: usize,
    v: [S::Vector; N],
) {
    for (position, v) in (first..).zip(v) {
        // SAFETY: guaranteed by the caller.
        unsafe {
            let v = if PAIRS { how.pair(s, s.load(positions.before.add(position * S::LANES)), v) } else { v };
            let to = positions.first.add(position * positions.step);
            if positions.lanes == S::LANES { s.store(to, v) } else { s.store_first(to, v, positions.lanes) }
        }
    }
}

/// Copies `columns` columns of a row, zero-padded by `padding` on both sides, from padded column `first` on, in the layout of
/// [`SourceRows`]. What it writes beyond them belongs to no tile.
#[inline(always)]
unsafe fn fill_row<S: Simd>(
    s: S,
    from: &[f32],
    first: usize,
    padding: usize,
    columns: usize,
    phase: usize,
    to: &mut [f32],
) {
    let first = first as isize - padding as isize;
    if phase == 0 {
        for x in (0..columns).step_by(S::LANES) {
            s.write(read_padded(s, from, first + x as isize), &mut to[x..]);
        }
        return;
    }
    for block in 0..columns.div_ceil(OUTPUTS * S::LANES) {
        let first = first + (block * OUTPUTS * S::LANES) as isize;
        let mut v = [s.splat(0.0); OUTPUTS];
        for (i, v) in v.iter_mut().enumerate() {
            *v = read_padded(s, from, first + (i * S::LANES) as isize);
        }
        let v = s.deinterleave(v);
        for remainder in 0..OUTPUTS {
            s.write(v[remainder], &mut to[remainder * phase + block * S::LANES..]);
        }
    }
}

/// A vector of a row from element `at` on, with zeros where the row has no elements.
#[inline(always)]
fn read_padded<S: Simd>(s: S, row: &[f32], at: isize) -> S::Vector {
    if at >= 0 {
        return match row.get(at as usize..) {
            Some(rest) => s.read_first(rest),
            None => s.splat(0.0),
        };
    }
    let zeros = at.unsigned_abs();
    if zeros >= S::LANES {
        return s.splat(0.0);
    }
    let mut shifted = [0.0; 2 * MAX_LANES];
    s.write(s.read_first(row), &mut shifted[zeros..]);
    s.read(&shifted)
}

struct OutputTask<'a> {
    scheme: Scheme,
    /// Whether the products are of bfloat16.
    bf16: bool,
    products: &'a [f32],
    /// Elements from one position to the next.
    step: usize,
    runs: &'a [Run],
    size: [usize; 2],
    bias: f32,
    residual: Option<&'a [f32]>,
    activation: Activation,
    out: *mut f32,
}

dispatch! {
    /// Transforms products back and applies the epilogue of one channel.
    ///
    /// # Safety
    /// The products contain every position, the output a plane in which no other thread writes these tiles.
    unsafe fn transform_output = transform_output_kernel(task: &OutputTask)
}

#[inline(always)]
unsafe fn transform_output_kernel<S: Simd>(s: S, task: &OutputTask) {
    let [height, width] = task.size;
    let [tile_height, tile_width] = task.scheme.tile();
    // SAFETY: guaranteed by the caller; only outputs inside the plane are stored.
    unsafe {
        for run in task.runs {
            for tile in (0..run.len).step_by(S::LANES) {
                let lanes = S::LANES.min(run.len - tile);
                let from = task.products.as_ptr().add(run.at + tile);
                let (y, x) = (run.row * tile_height, (run.column + tile) * tile_width);
                // The columns of these tiles; the vectors may reach into tiles of other runs.
                let end = width.min(x + lanes * tile_width);
                match task.scheme {
                    Scheme::Square => {
                        let rows = if task.bf16 {
                            output_square::<S, true>(s, from, task.step)
                        } else {
                            output_square::<S, false>(s, from, task.step)
                        };
                        for (i, row) in rows.into_iter().enumerate() {
                            if y + i < height {
                                finish_row(s, task, y + i, x, end, row);
                            }
                        }
                    }
                    Scheme::Row => {
                        let row = output_5(s, load_positions::<S, 8>(s, from, task.step));
                        finish_row(s, task, y, x, end, row);
                    }
                    Scheme::Column => {
                        let column = output_5(s, load_positions::<S, 8>(s, from, task.step));
                        for (i, v) in column.into_iter().enumerate() {
                            if y + i < height {
                                finish(s, task, y + i, x, end, v);
                            }
                        }
                    }
                }
            }
        }
    }
}

/// The outputs of neighbouring tiles.
#[inline(always)]
unsafe fn output_square<S: Simd, const BF16: bool>(
    s: S,
    from: *const f32,
    step: usize,
) -> [[S::Vector; OUTPUTS]; OUTPUTS] {
    let mut across = [[s.splat(0.0); 6]; OUTPUTS];
    for p in 0..6 {
        // SAFETY: guaranteed by the caller.
        let column = unsafe { load_positions::<S, 6>(s, from.add(p * step), 6 * step) };
        let column = output_3::<S, BF16>(s, column);
        for i in 0..OUTPUTS {
            across[i][p] = column[i];
        }
    }
    let mut rows = [[s.splat(0.0); OUTPUTS]; OUTPUTS];
    for i in 0..OUTPUTS {
        rows[i] = output_3::<S, BF16>(s, across[i]);
    }
    rows
}

#[inline(always)]
unsafe fn load_positions<S: Simd, const N: usize>(s: S, from: *const f32, step: usize) -> [S::Vector; N] {
    // SAFETY: guaranteed by the caller; products are padded by a vector after the last tile.
    unsafe {
        let mut v = [s.splat(0.0); N];
        for (position, v) in v.iter_mut().enumerate() {
            *v = s.load(from.add(position * step));
        }
        v
    }
}

/// Applies the epilogue to the outputs of neighbouring tiles in a row, and stores them.
#[inline(always)]
unsafe fn finish_row<S: Simd>(
    s: S,
    task: &OutputTask,
    y: usize,
    x: usize,
    end: usize,
    row: [S::Vector; OUTPUTS],
) {
    // SAFETY: guaranteed by the caller.
    unsafe {
        let row = s.interleave(row);
        for i in 0..OUTPUTS {
            finish(s, task, y, x + i * S::LANES, end, row[i]);
        }
    }
}

/// Applies the epilogue to the columns from `x` up to `end` of row `y`, and stores them.
#[inline(always)]
unsafe fn finish<S: Simd>(s: S, task: &OutputTask, y: usize, x: usize, end: usize, v: S::Vector) {
    if x >= end {
        return;
    }
    let lanes = S::LANES.min(end - x);
    let at = y * task.size[1] + x;
    // SAFETY: inside the plane.
    unsafe {
        let mut v = s.add(v, s.splat(task.bias));
        if let Some(residual) = task.residual {
            v = s.add(v, s.load_first(residual.as_ptr().add(at), lanes));
        }
        let v = task.activation.apply(s, v);
        let to = task.out.add(at);
        if lanes == S::LANES { s.store(to, v) } else { s.store_first(to, v, lanes) }
    }
}
