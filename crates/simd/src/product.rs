//! Matrix products: the inner loop of pointwise convolution, of Winograd's convolution and of attention.
//!
//! The right side is stored in panels: [`VECTORS`] vectors of columns wide, all rows, one row after another. Addresses are
//! read in order, and the data of a register tile lies in the first cache levels.

use std::cell::Cell;
use std::marker::PhantomData;

use crate::bf16::pair_rows;
use crate::{
    Activation, Isa, Left, MAX_LANES, Multiply, Numbers, Pair, Precision, Simd, dispatch, dispatch_pairs,
};

/// Vectors in one row of a panel.
const VECTORS: usize = 3;
/// Upper bound of [`Simd::TILE_ROWS`].
const MAX_ROWS: usize = 8;

pub fn panel_columns(isa: Isa) -> usize {
    VECTORS * isa.lanes()
}

/// The initial value of the sums of a [`Product`].
#[derive(Debug, Clone, Copy)]
pub enum Start<'a> {
    Zero,
    /// One number per row.
    PerRow(&'a [f32]),
    /// The current content of the output.
    Output,
}

/// The layout of a matrix in memory: elements from one row to the next, and from one panel to the next.
#[derive(Debug, Clone, Copy)]
pub struct Steps {
    pub row: usize,
    pub panel: usize,
}

impl Steps {
    /// Elements from the first to the end of `rows` rows, in panels of `width` columns; the last panel may be narrower.
    fn extent(self, rows: usize, columns: usize, width: usize) -> usize {
        let (Some(last_row), Some(last_panel)) =
            (rows.checked_sub(1), columns.div_ceil(width).checked_sub(1))
        else {
            return 0;
        };
        let panel = |number: usize, columns: usize| {
            let row = last_row.checked_mul(self.row)?;
            number.checked_mul(self.panel)?.checked_add(row)?.checked_add(columns)
        };
        let whole = if last_panel == 0 { Some(0) } else { panel(last_panel - 1, width) };
        let last = panel(last_panel, columns - last_panel * width);
        whole.zip(last).map_or(usize::MAX, |(whole, last)| whole.max(last))
    }
}

/// `activation(start + left * right + add)`, computed for the columns of one or more panels.
#[derive(Debug, Clone, Copy)]
pub struct Product<'a> {
    /// Its precision is that of the product: for [`Precision::Bf16`] the right side is rounded on the way.
    pub left: Left<'a>,
    pub rows: usize,
    pub depth: usize,
    /// Whole panels, each `depth` rows of [`panel_columns`].
    pub right: &'a [f32],
    /// Elements from one panel to the next.
    pub right_panel: usize,
    pub start: Start<'a>,
    pub add: Option<(&'a [f32], Steps)>,
    pub activation: Activation,
    /// Columns of all panels together. Only the last panel may be incomplete; its missing columns are not written.
    pub columns: usize,
}

impl Product<'_> {
    /// Panics when the kernels would read or write out of bounds.
    fn check(&self, isa: Isa, out: &Output) {
        let width = panel_columns(isa);
        let Self { rows, depth, columns, .. } = *self;
        let right = Steps { row: width, panel: self.right_panel };
        let right = right.extent(depth, columns.next_multiple_of(width), width);
        assert!(self.right.len() >= right, "right side: {} elements of {right}", self.right.len());
        match self.start {
            Start::Zero => {}
            Start::PerRow(start) => assert!(start.len() >= rows, "starts of {rows} rows: {}", start.len()),
            Start::Output => {
                let [filled_rows, filled_columns] = out.filled;
                assert!(
                    filled_rows >= rows && filled_columns >= columns,
                    "an output that is not written yet"
                );
            }
        }
        if let Some((add, steps)) = self.add {
            let len = steps.extent(rows, columns, width);
            assert!(add.len() >= len, "addend: {} elements of {len}", add.len());
        }
        assert!(
            rows <= out.limit[0] && columns <= out.limit[1],
            "more than these rows and columns of the output"
        );
        let len = out.steps.extent(rows, columns, width);
        assert!(out.len >= len, "output: {} elements of {len}", out.len);
    }
}

/// The destination of a [`Product`]: rows and panels in memory whose other elements may belong to other tasks.
#[derive(Debug)]
pub struct Output<'a> {
    start: *mut f32,
    len: usize,
    steps: Steps,
    /// Rows and columns that may be written.
    limit: [usize; 2],
    /// Rows and columns, counted from the first, that are known to be initialised.
    filled: [usize; 2],
    memory: PhantomData<&'a mut [f32]>,
}

impl<'a> Output<'a> {
    pub fn new(memory: &'a mut [f32], steps: Steps) -> Self {
        let all = [usize::MAX; 2];
        let (start, len) = (memory.as_mut_ptr(), memory.len());
        Self { start, len, steps, limit: all, filled: all, memory: PhantomData }
    }

    /// # Safety
    /// The `len` elements from `start` outlive the output, and those in the rows and columns that will be written belong to
    /// it alone. If `initialised`, they are.
    pub(crate) unsafe fn from_raw(start: *mut f32, len: usize, steps: Steps, initialised: bool) -> Self {
        let filled = if initialised { [usize::MAX; 2] } else { [0; 2] };
        Self { start, len, steps, limit: [usize::MAX; 2], filled, memory: PhantomData }
    }

    /// The same output, refusing products with more rows or columns.
    pub(crate) fn limited_to(self, rows: usize, columns: usize) -> Self {
        Self { limit: [rows, columns], ..self }
    }

    /// Rows and columns, counted from the first, that are known to be initialised.
    pub(crate) fn filled(&self) -> [usize; 2] {
        self.filled
    }

    fn mark_filled(&mut self, rows: usize, columns: usize) {
        // A smaller area than the known one adds nothing.
        if self.filled[0] <= rows && self.filled[1] <= columns {
            self.filled = [rows, columns];
        }
    }
}

/// Computes a product. Panics when a slice is too short, or when it starts from an output that was never written.
pub fn multiply(isa: Isa, product: &Product, out: &mut Output) {
    let Product { rows, depth, columns, .. } = *product;
    let Some(left) = rows.checked_mul(product.left.precision().packed(depth)) else {
        panic!("a matrix larger than memory")
    };
    assert!(product.left.len() >= left, "left side: {} elements of {left}", product.left.len());
    product.check(isa, out);
    match product.left {
        Left::F32(left) => {
            let sides = Sides {
                left: left.as_ptr(),
                right: product.right.as_ptr(),
                panel: product.right_panel,
                depth,
            };
            // SAFETY: the bounds of every read and write were checked.
            unsafe { multiply_unchecked(isa, product, &sides, out) }
        }
        Left::Bf16(left) => with_pairs(isa, product, |right, panel| {
            let depth = Precision::Bf16.packed(depth);
            let sides = Sides { left: left.as_ptr().cast(), right: right.as_ptr().cast(), panel, depth };
            // SAFETY: as above, with half as many rows on the right.
            unsafe { multiply_pairs_unchecked(isa, product, &sides, out) }
        }),
    }
    out.mark_filled(rows, columns);
}

/// [`multiply`] with a diagonal matrix: `factors` takes the place of the left side, and there are as many rows on the right. It
/// cannot start from the output.
pub fn multiply_diagonal(isa: Isa, factors: &[f32], product: &Product, out: &mut Output) {
    assert_eq!(product.rows, product.depth, "a diagonal matrix is square");
    assert!(factors.len() >= product.rows, "factors of {} rows: {}", product.rows, factors.len());
    product.check(isa, out);
    // SAFETY: the bounds of every read and write were checked.
    unsafe { multiply_diagonal_unchecked(isa, factors, product, out) }
    out.mark_filled(product.rows, product.columns);
}

/// What a register tile multiplies: the elements of both sides are numbers, or else [`Pair`]s of them.
struct Sides {
    /// In the order of [`Packed`](crate::Packed).
    left: *const f32,
    /// Panels of `depth` rows.
    right: *const f32,
    /// Elements from one panel to the next.
    panel: usize,
    /// Elements of a row of the left side.
    depth: usize,
}

/// Calls `of` with the right side as pairs, and the number of them from one panel to the next.
fn with_pairs(isa: Isa, product: &Product, of: impl FnOnce(&[Pair], usize)) {
    thread_local! {
        static PAIRS: Cell<Vec<Pair>> = const { Cell::new(Vec::new()) };
    }
    let width = panel_columns(isa);
    let panels = product.columns.div_ceil(width);
    let panel = Precision::Bf16.packed(product.depth) * width;
    let mut pairs = PAIRS.take();
    if pairs.len() < panels * panel {
        pairs.resize(panels * panel, Pair::default());
    }
    if panel > 0 {
        for (number, pairs) in pairs.chunks_exact_mut(panel).take(panels).enumerate() {
            let rows = &product.right[number * product.right_panel..][..product.depth * width];
            pair_rows(isa, rows, width, pairs);
        }
    }
    of(&pairs, panel);
    PAIRS.set(pairs);
}

dispatch! {
    /// # Safety
    /// The bounds of the product, its sides and its output were checked.
    unsafe fn multiply_unchecked = multiply_numbers(product: &Product, sides: &Sides, output: &Output)
}

dispatch_pairs! {
    /// # Safety
    /// As for [`multiply_unchecked`]; the elements of the sides are pairs.
    unsafe fn multiply_pairs_unchecked = multiply_kernel(product: &Product, sides: &Sides, output: &Output)
}

dispatch! {
    /// # Safety
    /// The bounds of the factors, the product and its output were checked.
    unsafe fn multiply_diagonal_unchecked =
        multiply_diagonal_kernel(factors: &[f32], product: &Product, output: &Output)
}

#[inline(always)]
unsafe fn multiply_numbers<S: Simd>(s: S, product: &Product, sides: &Sides, output: &Output) {
    // SAFETY: the caller checked the bounds.
    unsafe { multiply_kernel(s, Numbers, product, sides, output) }
}

#[inline(always)]
unsafe fn multiply_diagonal_kernel<S: Simd>(s: S, factors: &[f32], product: &Product, output: &Output) {
    let width = VECTORS * S::LANES;
    for panel in 0..product.columns.div_ceil(width) {
        let columns = width.min(product.columns - panel * width);
        for row in 0..product.rows {
            let factor = s.splat(factors[row]);
            let start = match product.start {
                Start::PerRow(start) => s.splat(start[row]),
                Start::Zero => s.splat(0.0),
                Start::Output => unreachable!("a diagonal product never starts from its output"),
            };
            // SAFETY: the caller checked the bounds.
            unsafe {
                let right = product.right.as_ptr().add(panel * product.right_panel + row * width);
                let out = output.start.add(panel * output.steps.panel + row * output.steps.row);
                for x in (0..columns).step_by(S::LANES) {
                    let lanes = S::LANES.min(columns - x);
                    let mut sum = s.mul_add(factor, s.load(right.add(x)), start);
                    if let Some((add, steps)) = product.add {
                        let add = add.as_ptr().add(panel * steps.panel + row * steps.row + x);
                        sum = s.add(sum, s.load_first(add, lanes));
                    }
                    let value = product.activation.apply(s, sum);
                    let to = out.add(x);
                    if lanes == S::LANES { s.store(to, value) } else { s.store_first(to, value, lanes) }
                }
            }
        }
    }
}

#[inline(always)]
unsafe fn multiply_kernel<S: Simd, M: Multiply<S>>(
    s: S,
    how: M,
    product: &Product,
    sides: &Sides,
    output: &Output,
) {
    let width = VECTORS * S::LANES;
    let mut first = 0;
    while first < product.rows {
        let rows = S::TILE_ROWS.min(product.rows - first);
        for panel in 0..product.columns.div_ceil(width) {
            // A block of the left side stays in the first-level cache while all panels are processed.
            let columns = width.min(product.columns - panel * width);
            macro_rules! by_rows {
                ($($rows:literal)*) => {
                    match rows {
                        // SAFETY: the caller checked the bounds.
                        $($rows => unsafe { tile::<S, M, $rows>(s, how, product, sides, output, [first, panel, columns]) },)*
                        _ => unreachable!("a tile has 1 to 8 rows"),
                    }
                };
            }
            by_rows!(1 2 3 4 5 6 7 8)
        }
        first += rows;
    }
}

/// The values of a register tile between the sums and the output.
#[repr(align(64))]
struct Tile([f32; MAX_ROWS * VECTORS * MAX_LANES]);

#[inline(always)]
unsafe fn tile<S: Simd, M: Multiply<S>, const ROWS: usize>(
    s: S,
    how: M,
    product: &Product,
    sides: &Sides,
    output: &Output,
    [first, panel, columns]: [usize; 3],
) {
    let mut tile = Tile([0.0; MAX_ROWS * VECTORS * MAX_LANES]);
    // SAFETY: the caller checked the bounds; a tile holds the rows' vectors.
    unsafe {
        let at = |steps: Steps| first * steps.row + panel * steps.panel;
        let out = output.start.add(at(output.steps));
        let values = tile.0.as_mut_ptr();
        match product.start {
            Start::Zero => {}
            Start::PerRow(start) => {
                for i in 0..ROWS * VECTORS {
                    s.store(values.add(i * S::LANES), s.splat(start[first + i / VECTORS]));
                }
            }
            Start::Output => {
                each_vector::<S, ROWS>(columns, |i, row, x, lanes| {
                    let value = s.load_first(out.add(row * output.steps.row + x), lanes);
                    s.store(values.add(i * S::LANES), value);
                });
            }
        }
        let left = sides.left.add(first * sides.depth);
        let right = sides.right.add(panel * sides.panel);
        match columns.div_ceil(S::LANES) {
            1 => accumulate::<S, M, ROWS, 1>(s, how, left, right, sides.depth, values),
            2 => accumulate::<S, M, ROWS, 2>(s, how, left, right, sides.depth, values),
            _ => accumulate::<S, M, ROWS, VECTORS>(s, how, left, right, sides.depth, values),
        }
        if let Some((add, steps)) = product.add {
            let add = add.as_ptr().add(at(steps));
            each_vector::<S, ROWS>(columns, |i, row, x, lanes| {
                let value = s.load_first(add.add(row * steps.row + x), lanes);
                let values = values.add(i * S::LANES);
                s.store(values, s.add(s.load(values), value));
            });
        }
        macro_rules! apply {
            ($($activation:ident)*) => {
                // Chosen once per tile, not once per vector.
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
        apply!(Relu LeakyRelu Gelu Tanh Sigmoid);
        each_vector::<S, ROWS>(columns, |i, row, x, lanes| {
            let value = s.load(values.add(i * S::LANES));
            let to = out.add(row * output.steps.row + x);
            if lanes == S::LANES { s.store(to, value) } else { s.store_first(to, value, lanes) }
        });
    }
}

/// Calls `of(number, row, column, lanes)` for each vector of a tile that contains columns.
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

/// `values += left * right` for the first `V` vectors of each row, held in registers throughout.
#[inline(always)]
unsafe fn accumulate<S: Simd, M: Multiply<S>, const ROWS: usize, const V: usize>(
    s: S,
    how: M,
    mut left: *const f32,
    mut right: *const f32,
    depth: usize,
    values: *mut f32,
) {
    // SAFETY: the caller checked the bounds.
    unsafe {
        let mut sums = [[s.splat(0.0); V]; ROWS];
        for row in 0..ROWS {
            for v in 0..V {
                sums[row][v] = how.begin(s, s.load(values.add((row * VECTORS + v) * S::LANES)));
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
                    sums[row][v] = how.add(s, weight, columns[v], sums[row][v]);
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Packed;
    use crate::bf16::add_products;

    const ROWS: usize = 11;
    const DEPTH: usize = 7;

    fn numbers(len: usize, seed: usize) -> Vec<f32> {
        (0..len).map(|i| ((i * 7919 + seed * 104_729) % 1000) as f32 / 500.0 - 1.0).collect()
    }

    /// `[DEPTH, columns]` in panels; missing columns of the last one are zero.
    fn panels(isa: Isa, right: &[f32], columns: usize) -> Vec<f32> {
        let width = panel_columns(isa);
        let mut panels = vec![0.0; columns.next_multiple_of(width) * DEPTH];
        for (row, values) in right.chunks_exact(columns).enumerate() {
            for (x, &value) in values.iter().enumerate() {
                panels[(x / width * DEPTH + row) * width + x % width] = value;
            }
        }
        panels
    }

    #[test]
    fn products_are_the_sums_of_their_definition() {
        for isa in Isa::to_test() {
            let width = panel_columns(isa);
            for columns in [1, width - 1, width, 2 * width + 5] {
                let (left, right) = (numbers(ROWS * DEPTH, 1), numbers(DEPTH * columns, 2));
                let (start, add) = (numbers(ROWS, 3), numbers(ROWS * columns, 4));
                let packed = Packed::rows(isa, Precision::F32, &left, DEPTH);
                let panels = panels(isa, &right, columns);
                let steps = Steps { row: columns, panel: width };
                let product = Product {
                    left: packed.part(0),
                    rows: ROWS,
                    depth: DEPTH,
                    right: &panels,
                    right_panel: DEPTH * width,
                    start: Start::PerRow(&start),
                    add: Some((&add, steps)),
                    activation: Activation::Relu,
                    columns,
                };
                let mut out = vec![f32::NAN; ROWS * columns];
                multiply(isa, &product, &mut Output::new(&mut out, steps));
                for (i, found) in out.iter().enumerate() {
                    let (row, x) = (i / columns, i % columns);
                    let terms = (0..DEPTH)
                        .map(|k| f64::from(left[row * DEPTH + k]) * f64::from(right[k * columns + x]));
                    let expected = (f64::from(start[row] + add[i]) + terms.sum::<f64>()).max(0.0);
                    assert!((f64::from(*found) - expected).abs() < 1e-5, "{isa:?}: {found} for {expected}");
                }

                let diagonal = Product { rows: DEPTH, ..product };
                let mut out = vec![f32::NAN; DEPTH * columns];
                multiply_diagonal(isa, &start[..DEPTH], &diagonal, &mut Output::new(&mut out, steps));
                for (i, found) in out.iter().enumerate() {
                    let factor = f64::from(start[i / columns]);
                    let expected = factor * f64::from(right[i]) + factor + f64::from(add[i]);
                    assert!((f64::from(*found) - expected.max(0.0)).abs() < 1e-5, "{isa:?}: {found}");
                }
            }
        }
    }

    #[test]
    fn products_of_bfloat16_have_the_bits_of_their_definition() {
        for isa in Isa::to_test() {
            let width = panel_columns(isa);
            // The last one makes sums that are not normal numbers.
            for (columns, scale) in [(1, 1.0), (width, 3.0), (2 * width + 5, 1.0), (width, 3e-20)] {
                let scaled = |numbers: Vec<f32>| numbers.into_iter().map(|x| x * scale).collect::<Vec<f32>>();
                let (left, right) = (scaled(numbers(ROWS * DEPTH, 1)), scaled(numbers(DEPTH * columns, 2)));
                let start: Vec<f32> = scaled(scaled(numbers(ROWS, 3)));
                let packed = Packed::rows(isa, Precision::Bf16, &left, DEPTH);
                let steps = Steps { row: columns, panel: width };
                let product = Product {
                    left: packed.part(0),
                    rows: ROWS,
                    depth: DEPTH,
                    right: &panels(isa, &right, columns),
                    right_panel: DEPTH * width,
                    start: Start::PerRow(&start),
                    add: None,
                    activation: Activation::Identity,
                    columns,
                };
                let mut out = vec![f32::NAN; ROWS * columns];
                multiply(isa, &product, &mut Output::new(&mut out, steps));
                for (i, found) in out.iter().enumerate() {
                    let (row, x) = (i / columns, i % columns);
                    let factor = |k: usize| if k < DEPTH { left[row * DEPTH + k] } else { 0.0 };
                    let other = |k: usize| if k < DEPTH { right[k * columns + x] } else { 0.0 };
                    let expected = (0..DEPTH).step_by(2).fold(start[row], |sum, k| {
                        let pair = Pair::new(factor(k), factor(k + 1));
                        add_products(sum, pair, Pair::new(other(k), other(k + 1)))
                    });
                    assert_eq!(found.to_bits(), expected.to_bits(), "{isa:?}: {found} for {expected}");
                }
            }
        }
    }

    /// Every slice panics when it is one element too short; nothing is read or written out of bounds.
    #[test]
    fn slices_that_are_too_short_are_refused() {
        let isa = Isa::best();
        let width = panel_columns(isa);
        let columns = width + 3;
        let steps = Steps { row: columns, panel: width };
        let full = [ROWS * DEPTH, DEPTH * 2 * width, ROWS, ROWS * columns, ROWS * columns];
        let run = |[left, right, start, add, out]: [usize; 5]| {
            let (left, right) = (vec![0.0; left], vec![0.0; right]);
            let (start, add, mut out) = (vec![0.0; start], vec![0.0; add], vec![0.0; out]);
            let product = Product {
                left: Left::F32(&left),
                rows: ROWS,
                depth: DEPTH,
                right: &right,
                right_panel: DEPTH * width,
                start: Start::PerRow(&start),
                add: Some((&add, steps)),
                activation: Activation::Identity,
                columns,
            };
            std::panic::catch_unwind(move || multiply(isa, &product, &mut Output::new(&mut out, steps)))
        };
        assert!(run(full).is_ok());
        for side in 0..full.len() {
            let mut short = full;
            short[side] -= 1;
            assert!(run(short).is_err(), "side {side}");
        }
    }
}
