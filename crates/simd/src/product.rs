//! Matrix products: the inner loop of pointwise convolution, of Winograd's convolution and of attention.
//!
//! The right side is stored in panels: [`VECTORS`] vectors of columns wide, all rows, one row after another. Addresses are
//! read in order, and the data of a register tile lies in the first cache levels.

use std::marker::PhantomData;
#[cfg(target_arch = "x86_64")]
use std::ops::Range;

#[cfg(target_arch = "x86_64")]
use crate::amx::{self, Amx};
use crate::{
    Activation, Isa, Left, MAX_LANES, Multiply, Numbers, Pair, Precision, Scratch, Simd, dispatch,
    dispatch_pairs, pair_rows,
};

/// Vectors in one row of a panel.
const VECTORS: usize = 3;

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

/// Whole panels of the right side of a [`Product`], each with rows of [`panel_columns`].
#[derive(Debug, Clone, Copy)]
pub enum Right<'a> {
    /// A row for each factor.
    F32(&'a [f32]),
    /// A row for every two factors, as [`pair_rows`] makes them.
    Bf16(&'a [Pair]),
}

impl Right<'_> {
    /// Elements of each panel's column.
    fn rows(self, depth: usize) -> usize {
        match self {
            Right::F32(_) => depth,
            Right::Bf16(_) => Precision::Bf16.packed(depth),
        }
    }

    fn len(self) -> usize {
        match self {
            Right::F32(numbers) => numbers.len(),
            Right::Bf16(pairs) => pairs.len(),
        }
    }
}

/// `activation(start + left * right + add)`, computed for the columns of one or more panels.
#[derive(Debug, Clone, Copy)]
pub struct Product<'a> {
    /// Its precision is that of the product: for [`Precision::Bf16`] a right side of `f32` is rounded on the way.
    pub left: Left<'a>,
    pub rows: usize,
    pub depth: usize,
    pub right: Right<'a>,
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
        let Self { rows, columns, .. } = *self;
        self.check_inputs(isa);
        if let Start::Output = self.start {
            let [filled_rows, filled_columns] = out.filled;
            assert!(filled_rows >= rows && filled_columns >= columns, "an output that is not written yet");
        }
        assert!(
            rows <= out.limit[0] && columns <= out.limit[1],
            "more than these rows and columns of the output"
        );
        let len = out.steps.extent(rows, columns, panel_columns(isa));
        assert!(out.len >= len, "output: {} elements of {len}", out.len);
    }

    /// Panics when the kernels would read out of bounds, of the left side and the output apart.
    fn check_inputs(&self, isa: Isa) {
        let width = panel_columns(isa);
        let Self { rows, depth, columns, .. } = *self;
        let right = Steps { row: width, panel: self.right_panel };
        let Some(whole) = columns.checked_next_multiple_of(width) else {
            panic!("a matrix larger than memory")
        };
        let right = right.extent(self.right.rows(depth), whole, width);
        assert!(self.right.len() >= right, "right side: {} elements of {right}", self.right.len());
        if let Start::PerRow(start) = self.start {
            assert!(start.len() >= rows, "starts of {rows} rows: {}", start.len());
        }
        if let Some((add, steps)) = self.add {
            let len = steps.extent(rows, columns, width);
            assert!(add.len() >= len, "addend: {} elements of {len}", add.len());
        }
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

    /// Its first element and the number of elements.
    pub(crate) fn memory(&self) -> (*const f32, usize) {
        (self.start, self.len)
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

/// Computes a product. Panics when a slice is too short, when it starts from an output that was never written, or when `f32` is to
/// be multiplied by pairs.
pub fn multiply(isa: Isa, product: &Product, out: &mut Output) {
    product.check(isa, out);
    with_sides(isa, product, |sides| match product.left {
        // SAFETY: the bounds of every read and write were checked.
        Left::F32(_) => unsafe { multiply_unchecked(isa, product, sides, out) },
        // SAFETY: as above.
        Left::Bf16(_) => unsafe {
            #[cfg(target_arch = "x86_64")]
            if let Some(amx) = amx_for(isa, product, sides) {
                return multiply_in_tiles::<false>(amx, product, sides, out);
            }
            multiply_pairs_unchecked(isa, product, sides, out)
        },
    });
    out.mark_filled(product.rows, product.columns);
}

/// Computes a product of bfloat16 whose output is a right side in turn: its rows two by two, as [`pair_rows`] rounds them, in panels
/// `panel` elements apart. Panics as [`multiply`], when the product is of `f32`, starts from its output, or has a panel that is not
/// whole.
pub fn multiply_to_pairs(isa: Isa, product: &Product, out: &mut [Pair], panel: usize) {
    let width = panel_columns(isa);
    assert!(product.columns.is_multiple_of(width), "{} columns: panels of {width}", product.columns);
    assert!(!matches!(product.start, Start::Output), "a product of pairs never starts from its output");
    product.check_inputs(isa);
    let steps = Steps { row: width, panel };
    let len = steps.extent(Precision::Bf16.packed(product.rows), product.columns, width);
    assert!(out.len() >= len, "output: {} pairs of {len}", out.len());
    // SAFETY: the memory is borrowed for as long as the output is used; a pair has the size and alignment of an `f32`.
    let out = unsafe { Output::from_raw(out.as_mut_ptr().cast(), out.len(), steps, true) };
    with_sides(isa, product, |sides| match product.left {
        Left::F32(_) => panic!("a product of numbers gives no pairs"),
        // SAFETY: the bounds of every read and write were checked.
        Left::Bf16(_) => unsafe {
            #[cfg(target_arch = "x86_64")]
            if let Some(amx) = amx_for(isa, product, sides) {
                return multiply_in_tiles::<true>(amx, product, sides, &out);
            }
            multiply_pairs_to_pairs_unchecked(isa, product, sides, &out)
        },
    });
}

/// [`multiply`] with a diagonal matrix: `factors` takes the place of the left side, and there are as many rows on the right. It
/// cannot start from the output.
pub fn multiply_diagonal(isa: Isa, factors: &[f32], product: &Product, out: &mut Output) {
    assert_eq!(product.rows, product.depth, "a diagonal matrix is square");
    assert!(factors.len() >= product.rows, "factors of {} rows: {}", product.rows, factors.len());
    assert!(matches!(product.right, Right::F32(_)), "factors times pairs");
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

/// Calls `of` with both sides of a product, the right one rounded if the left is. Panics when the left one is too short, or when the
/// right one is rounded and the left is not.
fn with_sides(isa: Isa, product: &Product, of: impl FnOnce(&Sides)) {
    let Product { rows, depth, right_panel, .. } = *product;
    let precision = product.left.precision();
    let Some(left) = rows.checked_mul(precision.packed(depth)) else { panic!("a matrix larger than memory") };
    assert!(product.left.len() >= left, "left side: {} elements of {left}", product.left.len());
    let depth = precision.packed(depth);
    match (product.left, product.right) {
        (Left::F32(left), Right::F32(right)) => {
            of(&Sides { left: left.as_ptr(), right: right.as_ptr(), panel: right_panel, depth });
        }
        (Left::F32(_), Right::Bf16(_)) => panic!("numbers times pairs"),
        (Left::Bf16(left), Right::Bf16(right)) => {
            let (left, right) = (left.as_ptr().cast(), right.as_ptr().cast());
            of(&Sides { left, right, panel: right_panel, depth });
        }
        (Left::Bf16(left), Right::F32(right)) => {
            let width = panel_columns(isa);
            let (panels, panel) = (product.columns.div_ceil(width), depth.checked_mul(width));
            let len = panel.and_then(|panel| panels.checked_mul(panel));
            let (Some(panel), Some(len)) = (panel, len) else { panic!("a matrix larger than memory") };
            let mut pairs = Scratch::<Pair>::of(len);
            for (number, pairs) in pairs.chunks_exact_mut(panel.max(1)).enumerate() {
                let rows = &right[number * right_panel..][..product.depth * width];
                pair_rows(isa, rows, width, pairs);
            }
            of(&Sides { left: left.as_ptr().cast(), right: pairs.as_ptr().cast(), panel, depth });
        }
    }
}

dispatch! {
    /// # Safety
    /// The bounds of the product, its sides and its output were checked.
    unsafe fn multiply_unchecked = multiply_numbers(product: &Product, sides: &Sides, output: &Output)
}

dispatch_pairs! {
    /// # Safety
    /// As for [`multiply_unchecked`]; the elements of the sides are pairs.
    unsafe fn multiply_pairs_unchecked = multiply_to_numbers(product: &Product, sides: &Sides, output: &Output)
}

dispatch_pairs! {
    /// # Safety
    /// As for [`multiply_pairs_unchecked`]; the output has room for pairs of rows, whole panels of them.
    unsafe fn multiply_pairs_to_pairs_unchecked = multiply_to_pairs_kernel(product: &Product, sides: &Sides, output: &Output)
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
    unsafe { multiply_kernel::<S, Numbers, false>(s, Numbers, product, sides, output, 0) }
}

#[inline(always)]
unsafe fn multiply_to_numbers<S: Simd, M: Multiply<S>>(
    s: S,
    how: M,
    product: &Product,
    sides: &Sides,
    output: &Output,
) {
    // SAFETY: the caller checked the bounds.
    unsafe { multiply_kernel::<S, M, false>(s, how, product, sides, output, 0) }
}

#[inline(always)]
unsafe fn multiply_to_pairs_kernel<S: Simd, M: Multiply<S>>(
    s: S,
    how: M,
    product: &Product,
    sides: &Sides,
    output: &Output,
) {
    // SAFETY: the caller checked the bounds.
    unsafe { multiply_kernel::<S, M, true>(s, how, product, sides, output, 0) }
}

#[inline(always)]
unsafe fn multiply_diagonal_kernel<S: Simd>(s: S, factors: &[f32], product: &Product, output: &Output) {
    let Right::F32(right) = product.right else { unreachable!("checked by the caller") };
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
                let right = right.as_ptr().add(panel * product.right_panel + row * width);
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

/// AMX, for a product of pairs that is large enough for it.
#[cfg(target_arch = "x86_64")]
fn amx_for(isa: Isa, product: &Product, sides: &Sides) -> Option<Amx> {
    (product.rows >= amx::ROWS && sides.depth >= amx::LEAST).then(|| Amx::of(isa)).flatten()
}

/// [`multiply_kernel`] with AMX where its tiles fit.
///
/// # Safety
/// As for [`multiply_pairs_unchecked`], or if `PAIRS` for [`multiply_pairs_to_pairs_unchecked`]; the product is one of [`amx_for`].
#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx512bf16,avx512f,avx512bw,avx512dq,avx512vl,avx2,fma,bmi1,bmi2,popcnt")]
unsafe fn multiply_in_tiles<const PAIRS: bool>(amx: Amx, product: &Product, sides: &Sides, output: &Output) {
    let mut left = Scratch::<f32>::of(sides.depth.next_multiple_of(amx::BLOCK) * amx::MOST_ROWS);
    let two = product.rows / amx::MOST_ROWS * amx::MOST_ROWS;
    let whole = product.rows / amx::ROWS * amx::ROWS;
    // SAFETY: the caller checked the bounds; blocks of the left side have as many rows as those of tiles.
    unsafe {
        multiply_rows_in_tiles::<{ amx::MOST_ROWS }, PAIRS>(amx, product, sides, output, 0..two, &mut left);
        multiply_rows_in_tiles::<{ amx::ROWS }, PAIRS>(amx, product, sides, output, two..whole, &mut left);
        let s = amx.pairs().avx512();
        multiply_kernel::<_, _, PAIRS>(s, amx, product, sides, output, whole)
    }
}

/// Some rows of [`multiply_in_tiles`], in tiles of `ROWS`, whole blocks of the left side.
#[cfg(target_arch = "x86_64")]
#[inline(always)]
unsafe fn multiply_rows_in_tiles<const ROWS: usize, const PAIRS: bool>(
    amx: Amx,
    product: &Product,
    sides: &Sides,
    output: &Output,
    rows: Range<usize>,
    left: &mut Scratch,
) {
    if rows.is_empty() {
        return;
    }
    let s = amx.pairs().avx512();
    let width = VECTORS * crate::Avx512::LANES;
    let tiles = amx::Tiles::<ROWS>::new(amx);
    let arranged = amx::arranged(sides.depth);
    for first in rows.step_by(ROWS) {
        // SAFETY: guaranteed by the caller.
        unsafe {
            let block = sides.left.add(first * sides.depth);
            amx::arrange::<ROWS>(s, block, sides.depth, left.as_mut_ptr());
            for panel in 0..product.columns.div_ceil(width) {
                let columns = width.min(product.columns - panel * width);
                let at = [first, panel, columns];
                tile::<_, _, ROWS, PAIRS>(s, amx, product, sides, output, at, |right, values| {
                    amx::accumulate(&tiles, left.as_ptr(), right, sides.depth, values);
                    let (right, rest) = (right.add(arranged * width), sides.depth - arranged);
                    if rest == 0 {
                        return;
                    }
                    for number in 0..ROWS / amx::ROWS {
                        let block = block.add((number * sides.depth + arranged) * amx::ROWS);
                        let values = values.add(number * amx::ROWS * width);
                        accumulate::<_, _, { amx::ROWS }, VECTORS>(s, amx, block, right, rest, values);
                    }
                });
            }
        }
    }
}

/// From row `first` on, which begins a block. If `PAIRS`, the rows of the output are rounded two by two.
#[inline(always)]
unsafe fn multiply_kernel<S: Simd, M: Multiply<S>, const PAIRS: bool>(
    s: S,
    how: M,
    product: &Product,
    sides: &Sides,
    output: &Output,
    mut first: usize,
) {
    let width = VECTORS * S::LANES;
    while first < product.rows {
        let rows = S::TILE_ROWS.min(product.rows - first);
        for panel in 0..product.columns.div_ceil(width) {
            // A block of the left side stays in the first-level cache while all panels are processed.
            let columns = width.min(product.columns - panel * width);
            macro_rules! by_rows {
                ($($rows:literal)*) => {
                    match rows {
                        // SAFETY: the caller checked the bounds.
                        $($rows => unsafe {
                            let (at, depth) = ([first, panel, columns], sides.depth);
                            let left = sides.left.add(first * depth);
                            tile::<S, M, $rows, PAIRS>(s, how, product, sides, output, at, |right, values| {
                                match columns.div_ceil(S::LANES) {
                                    1 => accumulate::<S, M, $rows, 1>(s, how, left, right, depth, values),
                                    2 => accumulate::<S, M, $rows, 2>(s, how, left, right, depth, values),
                                    _ => accumulate::<S, M, $rows, VECTORS>(s, how, left, right, depth, values),
                                }
                            })
                        },)*
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
struct Tile<const ROWS: usize>([[f32; VECTORS * MAX_LANES]; ROWS]);

/// `accumulate` adds to the values, its second argument, what the left side is times the panel of the right one, its first.
#[inline(always)]
unsafe fn tile<S: Simd, M: Multiply<S>, const ROWS: usize, const PAIRS: bool>(
    s: S,
    how: M,
    product: &Product,
    sides: &Sides,
    output: &Output,
    [first, panel, columns]: [usize; 3],
    accumulate: impl FnOnce(*const f32, *mut f32),
) {
    let mut tile = Tile([[0.0; VECTORS * MAX_LANES]; ROWS]);
    // SAFETY: the caller checked the bounds; a tile holds the rows' vectors.
    unsafe {
        let at = |steps: Steps| first * steps.row + panel * steps.panel;
        let values = tile.0.as_mut_ptr().cast::<f32>();
        match product.start {
            Start::Zero => {}
            Start::PerRow(start) => {
                for i in 0..ROWS * VECTORS {
                    s.store(values.add(i * S::LANES), s.splat(start[first + i / VECTORS]));
                }
            }
            Start::Output => {
                let out = output.start.add(at(output.steps));
                each_vector::<S, ROWS>(columns, |i, row, x, lanes| {
                    let value = s.load_first(out.add(row * output.steps.row + x), lanes);
                    s.store(values.add(i * S::LANES), value);
                });
            }
        }
        accumulate(sides.right.add(panel * sides.panel), values);
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
        if PAIRS {
            let Steps { row, panel: step } = output.steps;
            let out = output.start.add(first / 2 * row + panel * step);
            for i in 0..ROWS.div_ceil(2) * VECTORS {
                let (y, v) = (i / VECTORS, i % VECTORS);
                let value = |row: usize| {
                    if row < ROWS { s.load(values.add((row * VECTORS + v) * S::LANES)) } else { s.splat(0.0) }
                };
                s.store(out.add(y * row + v * S::LANES), how.pair(s, value(2 * y), value(2 * y + 1)));
            }
            return;
        }
        let out = output.start.add(at(output.steps));
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
mod tests;
