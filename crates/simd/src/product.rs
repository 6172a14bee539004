//! Products of matrices: the inner loop of pointwise convolution, of Winograd's convolution and of attention.
//!
//! The right side comes in panels, blocks of [`VECTORS`] vectors of columns of all its rows, one row after another. So
//! every address is read in order, and what a register tile needs lies in the first cache levels.

use crate::{Activation, Isa, MAX_LANES, Simd, dispatch};

/// Vectors of a panel's row.
const VECTORS: usize = 3;
/// [`Simd::TILE_ROWS`] at most.
const MAX_ROWS: usize = 8;

/// Columns of a panel.
pub fn panel_columns(isa: Isa) -> usize {
    VECTORS * isa.lanes()
}

/// Puts a left side `[rows, depth]` into the order of [`Product::left`]: blocks of a register tile's rows (fewer in the
/// last), each `[depth, rows of the block]`.
pub fn pack_rows(isa: Isa, matrix: &[f32], depth: usize, packed: &mut [f32]) {
    let block = isa.tile_rows();
    assert_eq!(matrix.len(), packed.len());
    if packed.is_empty() {
        return;
    }
    for (to, from) in packed.chunks_mut(block * depth).zip(matrix.chunks(block * depth)) {
        pack_block(isa, from, depth, to);
    }
}

dispatch! {
    /// One block of [`pack_rows`].
    fn pack_block = pack_block_kernel(from: &[f32], depth: usize, to: &mut [f32])
}

#[inline(always)]
fn pack_block_kernel<S: Simd>(s: S, from: &[f32], depth: usize, to: &mut [f32]) {
    let rows = from.len() / depth;
    let mut first = 0;
    if rows * 2 == S::LANES {
        // Two vectors of each row make a square.
        let mut square = [0.0; MAX_LANES * MAX_LANES];
        while first + 2 * S::LANES <= depth {
            let mut sources = [std::ptr::null(); MAX_LANES];
            for row in 0..rows {
                let values = &from[row * depth + first..][..2 * S::LANES];
                sources[row] = values.as_ptr();
                sources[rows + row] = values[S::LANES..].as_ptr();
            }
            // SAFETY: each source is a vector long, and the square holds its columns.
            unsafe { s.transpose(&sources, square.as_mut_ptr(), S::LANES) }
            let (left, right) = to[first * rows..][..2 * S::LANES * rows].split_at_mut(S::LANES * rows);
            let halves = left.chunks_exact_mut(rows).zip(right.chunks_exact_mut(rows));
            for ((left, right), values) in halves.zip(square.chunks_exact(S::LANES)) {
                left.copy_from_slice(&values[..rows]);
                right.copy_from_slice(&values[rows..]);
            }
            first += 2 * S::LANES;
        }
    }
    for (row, values) in from.chunks_exact(depth).enumerate() {
        for (i, &value) in values.iter().enumerate().skip(first) {
            to[i * rows + row] = value;
        }
    }
}

/// What the sums of a [`Product`] start from.
#[derive(Clone, Copy)]
pub enum Start {
    Zero,
    /// A number for each row.
    PerRow(*const f32),
    /// What stands in the output.
    Output,
}

/// A matrix in memory: elements from a row to the next, and from a panel to the next.
#[derive(Clone, Copy)]
pub struct Steps {
    pub row: usize,
    pub panel: usize,
}

/// `out = activation(start + left * right + add)`, column by column of one or more panels.
pub struct Product {
    /// As [`pack_rows`] orders it.
    pub left: *const f32,
    pub rows: usize,
    pub depth: usize,
    /// Rows of whole panels.
    pub right: *const f32,
    /// Elements from a panel to the next.
    pub right_panel: usize,
    pub start: Start,
    pub add: Option<(*const f32, Steps)>,
    pub activation: Activation,
    pub out: *mut f32,
    pub out_steps: Steps,
    /// Columns of all panels together; only the last may lack some, and they are not written.
    pub columns: usize,
}

dispatch! {
    /// Computes one [`Product`].
    ///
    /// # Safety
    /// Every address that the product names can be read or written; no other thread writes them.
    pub unsafe fn multiply = multiply_kernel(product: &Product)
}

#[inline(always)]
unsafe fn multiply_kernel<S: Simd>(s: S, product: &Product) {
    let width = VECTORS * S::LANES;
    let mut first = 0;
    while first < product.rows {
        let rows = S::TILE_ROWS.min(product.rows - first);
        for panel in 0..product.columns.div_ceil(width) {
            // A block of the left side stays in the first-level cache while the panels pass by.
            let columns = width.min(product.columns - panel * width);
            macro_rules! by_rows {
                ($($rows:literal)*) => {
                    match rows {
                        // SAFETY: the caller's promise, passed on.
                        $($rows => unsafe { tile::<S, $rows>(s, product, first, panel, columns) },)*
                        _ => unreachable!("a tile has 1 to 8 rows"),
                    }
                };
            }
            by_rows!(1 2 3 4 5 6 7 8)
        }
        first += rows;
    }
}

/// A register tile's values on their way from the sums to the output.
#[repr(align(64))]
struct Tile([f32; MAX_ROWS * VECTORS * MAX_LANES]);

#[inline(always)]
unsafe fn tile<S: Simd, const ROWS: usize>(
    s: S,
    product: &Product,
    first: usize,
    panel: usize,
    columns: usize,
) {
    let mut tile = Tile([0.0; MAX_ROWS * VECTORS * MAX_LANES]);
    // SAFETY: the caller's promise; a tile holds the rows' vectors.
    unsafe {
        let at = |steps: Steps| first * steps.row + panel * steps.panel;
        let out = product.out.add(at(product.out_steps));
        let values = tile.0.as_mut_ptr();
        match product.start {
            Start::Zero => {}
            Start::PerRow(start) => {
                for i in 0..ROWS * VECTORS {
                    s.store(values.add(i * S::LANES), s.splat(*start.add(first + i / VECTORS)));
                }
            }
            Start::Output => {
                each_vector::<S, ROWS>(columns, |i, row, x, lanes| {
                    let value = s.load_first(out.add(row * product.out_steps.row + x), lanes);
                    s.store(values.add(i * S::LANES), value);
                });
            }
        }
        let left = product.left.add(first * product.depth);
        let right = product.right.add(panel * product.right_panel);
        match columns.div_ceil(S::LANES) {
            1 => accumulate::<S, ROWS, 1>(s, left, right, product.depth, values),
            2 => accumulate::<S, ROWS, 2>(s, left, right, product.depth, values),
            _ => accumulate::<S, ROWS, VECTORS>(s, left, right, product.depth, values),
        }
        if let Some((add, steps)) = product.add {
            let add = add.add(at(steps));
            each_vector::<S, ROWS>(columns, |i, row, x, lanes| {
                let value = s.load_first(add.add(row * steps.row + x), lanes);
                let values = values.add(i * S::LANES);
                s.store(values, s.add(s.load(values), value));
            });
        }
        macro_rules! apply {
            ($($activation:ident)*) => {
                // Chosen once for the tile, not once for each vector.
                match product.activation {
                    Activation::Identity => {}
                    $(Activation::$activation => {
                        for i in 0..ROWS * VECTORS {
                            let values = values.add(i * S::LANES);
                            s.store(values, Activation::$activation.apply(s, s.load(values)));
                        }
                    })*
                }
            };
        }
        apply!(Relu Gelu Tanh Sigmoid);
        each_vector::<S, ROWS>(columns, |i, row, x, lanes| {
            let value = s.load(values.add(i * S::LANES));
            let to = out.add(row * product.out_steps.row + x);
            if lanes == S::LANES { s.store(to, value) } else { s.store_first(to, value, lanes) }
        });
    }
}

/// Calls `of(number, row, column, lanes)` for each vector of a tile that has columns.
#[inline(always)]
fn each_vector<S: Simd, const ROWS: usize>(columns: usize, mut of: impl FnMut(usize, usize, usize, usize)) {
    for row in 0..ROWS {
        for v in 0..VECTORS {
            let x = v * S::LANES;
            if x < columns {
                of(row * VECTORS + v, row, x, S::LANES.min(columns - x));
            }
        }
    }
}

/// `values += left * right` for the first `V` vectors of each row, in registers all the while.
#[inline(always)]
unsafe fn accumulate<S: Simd, const ROWS: usize, const V: usize>(
    s: S,
    mut left: *const f32,
    mut right: *const f32,
    depth: usize,
    values: *mut f32,
) {
    // SAFETY: the caller's promise.
    unsafe {
        let mut sums = [[s.splat(0.0); V]; ROWS];
        for row in 0..ROWS {
            for v in 0..V {
                sums[row][v] = s.load(values.add((row * VECTORS + v) * S::LANES));
            }
        }
        for _ in 0..depth {
            let mut columns = [s.splat(0.0); V];
            for v in 0..V {
                columns[v] = s.load(right.add(v * S::LANES));
            }
            for row in 0..ROWS {
                let weight = s.splat(*left.add(row));
                for v in 0..V {
                    sums[row][v] = s.mul_add(weight, columns[v], sums[row][v]);
                }
            }
            left = left.add(ROWS);
            right = right.add(VECTORS * S::LANES);
        }
        for row in 0..ROWS {
            for v in 0..V {
                s.store(values.add((row * VECTORS + v) * S::LANES), sums[row][v]);
            }
        }
    }
}
