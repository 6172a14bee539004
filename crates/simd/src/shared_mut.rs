//! One buffer written by several tasks.

use std::marker::PhantomData;
use std::mem::MaybeUninit;
use std::ops::Range;

use rayon::prelude::*;

use crate::{Isa, Output, Steps, panel_columns};

/// Memory that several tasks write at once, each to its own elements.
#[derive(Debug, Clone, Copy)]
pub struct SharedMut<'a> {
    start: *mut f32,
    len: usize,
    initialised: bool,
    memory: PhantomData<&'a mut [MaybeUninit<f32>]>,
}

// SAFETY: only pointers and outputs are handed out; whoever uses one guarantees that no other task uses its
// elements.
unsafe impl Send for SharedMut<'_> {}
// SAFETY: as above.
unsafe impl Sync for SharedMut<'_> {}

impl<'a> SharedMut<'a> {
    pub fn new(slice: &'a mut [f32]) -> Self {
        Self { start: slice.as_mut_ptr(), len: slice.len(), initialised: true, memory: PhantomData }
    }

    fn uninitialised(slice: &'a mut [MaybeUninit<f32>]) -> Self {
        Self { start: slice.as_mut_ptr().cast(), len: slice.len(), initialised: false, memory: PhantomData }
    }

    /// A vector whose memory is uninitialised until `fill` writes it.
    ///
    /// # Safety
    /// `fill` writes each of the `len` elements and reads none before writing it.
    pub unsafe fn fill_new(len: usize, fill: impl FnOnce(SharedMut)) -> Vec<f32> {
        let mut out = Vec::with_capacity(len);
        fill(SharedMut::uninitialised(&mut out.spare_capacity_mut()[..len]));
        // SAFETY: the caller guarantees that `fill` writes every element.
        unsafe { out.set_len(len) }
        out
    }

    /// The address of element `index`; panics when out of range. Whatever is written through it must belong to the calling
    /// task alone while others write, and no element may be read before it was written.
    pub fn at(&self, index: usize) -> *mut f32 {
        assert!(index < self.len, "element {index} of {}", self.len);
        self.start.wrapping_add(index)
    }

    /// An output for products of the calling task, from element `first` on.
    ///
    /// # Safety
    /// Rows and columns that are written belong to the calling task alone while others write.
    pub unsafe fn output(&self, first: usize, steps: Steps) -> Output<'a> {
        // SAFETY: the range is inside; the caller guarantees the rest.
        unsafe { Output::from_raw(self.at(first), self.len - first, steps, self.initialised) }
    }
}

/// A new vector, filled in parallel in pieces of `piece` elements (the last may be shorter). `fill` gets the number of a
/// piece and its memory, and returns that memory filled. Each thread has its own `scratch`.
pub fn fill_pieces<T>(
    len: usize,
    piece: usize,
    scratch: impl Fn() -> T + Send + Sync,
    fill: impl for<'p> Fn(&mut T, usize, &'p mut [MaybeUninit<f32>]) -> &'p mut [f32] + Send + Sync,
) -> Vec<f32> {
    let mut out = Vec::with_capacity(len);
    let pieces = out.spare_capacity_mut()[..len].par_chunks_mut(piece.max(1)).enumerate();
    pieces.for_each_init(scratch, |scratch, (number, piece)| {
        let memory = (piece.as_ptr().cast::<f32>(), piece.len());
        let filled = fill(scratch, number, piece);
        assert_eq!((filled.as_ptr(), filled.len()), memory, "another piece");
    });
    // SAFETY: each piece was returned as a slice of numbers at its address and of its length.
    unsafe { out.set_len(len) }
    out
}

/// A copy of `from` whose pieces of `piece` elements (the last may be shorter) `change` changes in parallel, given their numbers.
pub fn copy_pieces(from: &[f32], piece: usize, change: impl Fn(usize, &mut [f32]) + Send + Sync) -> Vec<f32> {
    fill_pieces(
        from.len(),
        piece,
        || (),
        |(), number, out| {
            let out = out.write_copy_of_slice(&from[number * piece..][..out.len()]);
            change(number, out);
            out
        },
    )
}

/// Zeros, written on all cores: the first write to new memory is slow, as the system clears each page.
pub fn zeros(len: usize) -> Vec<f32> {
    fill_pieces(
        len,
        1 << 16,
        || (),
        |(), _, piece| {
            piece.fill(MaybeUninit::new(0.0));
            // SAFETY: every element was just written.
            unsafe { piece.assume_init_mut() }
        },
    )
}

/// A new `[images, rows, columns]`, filled in parallel in pieces of `width` columns and all rows of an image. `fill` gets
/// the image, the columns, and the [`Output`] into which it must multiply (see [`crate::multiply`]) each of them. Each
/// thread has its own `scratch`.
pub fn fill_columns<T>(
    isa: Isa,
    [images, rows, columns]: [usize; 3],
    width: usize,
    scratch: impl Fn() -> T + Send + Sync,
    fill: impl Fn(&mut T, usize, Range<usize>, &mut Output) + Send + Sync,
) -> Vec<f32> {
    let pieces = columns.div_ceil(width);
    let steps = Steps { row: columns, panel: panel_columns(isa) };
    let len = images * rows * columns;
    let fill_all = |target: SharedMut| {
        let tasks = if len == 0 { 0 } else { images * pieces };
        (0..tasks).into_par_iter().for_each_init(scratch, |scratch, task| {
            let (image, first) = (task / pieces, task % pieces * width);
            let own = first..columns.min(first + width);
            // SAFETY: a product within these columns belongs to this task alone; any other is refused.
            let mut out =
                unsafe { target.output(image * rows * columns + first, steps) }.limited_to(rows, own.len());
            let memory = out.memory();
            fill(scratch, image, own.clone(), &mut out);
            // Safe code may replace what it borrows.
            assert!(out.memory() == memory, "another output");
            let [filled_rows, filled_columns] = out.filled();
            assert!(filled_rows >= rows && filled_columns >= own.len(), "not all was written");
        });
    };
    // SAFETY: the pieces cover every column of every image, and each was checked to be filled.
    unsafe { SharedMut::fill_new(len, fill_all) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Activation, Left, Product, Right, Start, multiply};

    #[test]
    fn pieces_become_one_vector() {
        let filled = fill_pieces(
            10,
            4,
            || (),
            |(), number, piece| {
                let numbers: Vec<f32> = (0..piece.len()).map(|i| (number * 4 + i) as f32).collect();
                piece.write_copy_of_slice(&numbers)
            },
        );
        assert_eq!(filled, (0..10).map(|i| i as f32).collect::<Vec<_>>());
        assert!(fill_pieces(0, 0, || (), |(), _, _| unreachable!("there are none")).is_empty());
    }

    #[test]
    fn pieces_are_copied_before_they_are_changed() {
        let numbers = [1.0, 2.0, 3.0, 4.0, 5.0];
        let changed = copy_pieces(&numbers, 2, |number, piece| piece[0] += 10.0 * number as f32);
        assert_eq!(changed, [1.0, 2.0, 13.0, 4.0, 25.0]);
        assert!(copy_pieces(&[], 0, |_, _| unreachable!("there are none")).is_empty());
    }

    #[test]
    fn zeros_are_zero() {
        // In memory that was not.
        for len in [0, 3, (1 << 16) + 5, 1 << 20] {
            drop(vec![1.0_f32; len]);
            let found = zeros(len);
            assert!(found.len() == len && found.iter().all(|x| x.to_bits() == 0));
        }
    }

    #[test]
    #[should_panic(expected = "another piece")]
    fn an_unfilled_piece_is_detected() {
        fill_pieces(4, 4, || (), |(), _, piece| piece[..2].write_copy_of_slice(&[1.0; 2]));
    }

    /// Constant products: `rows` and `columns` are fixed, whatever the piece.
    fn fill_with(isa: Isa, rows: usize, columns: usize, start: Start) -> Vec<f32> {
        fill_columns(
            isa,
            [2, 3, 100],
            40,
            || (),
            |(), image, own, out| {
                let left = vec![(image + 1) as f32; rows];
                let right = vec![own.start as f32; panel_columns(isa) * 10];
                let columns = columns.min(own.len());
                let product = Product {
                    left: Left::F32(&left),
                    rows,
                    depth: 1,
                    right: Right::F32(&right),
                    right_panel: panel_columns(isa),
                    start,
                    add: None,
                    activation: Activation::Identity,
                    columns,
                };
                multiply(isa, &product, out);
            },
        )
    }

    #[test]
    fn columns_become_one_matrix_for_each_image() {
        for isa in Isa::to_test() {
            let filled = fill_with(isa, 3, usize::MAX, Start::Zero);
            for (i, &found) in filled.iter().enumerate() {
                assert_eq!(found, ((i / 300 + 1) * (i % 100 / 40 * 40)) as f32, "{isa:?}, element {i}");
            }
        }
    }

    #[test]
    #[should_panic(expected = "not all was written")]
    fn unwritten_columns_are_detected() {
        fill_with(Isa::best(), 3, 39, Start::Zero);
    }

    #[test]
    #[should_panic(expected = "another output")]
    fn an_output_that_was_replaced_is_detected() {
        let fill = |(): &mut (), _, own: Range<usize>, out: &mut Output| {
            let memory = vec![0.0; 3 * own.len()].leak();
            *out = Output::new(memory, Steps { row: own.len(), panel: 0 });
        };
        fill_columns(Isa::best(), [1, 3, 4], 4, || (), fill);
    }

    #[test]
    #[should_panic(expected = "not written yet")]
    fn an_output_that_was_not_written_is_not_read() {
        fill_with(Isa::best(), 3, usize::MAX, Start::Output);
    }

    #[test]
    #[should_panic(expected = "of the output")]
    fn another_tasks_rows_are_not_written() {
        fill_with(Isa::best(), 4, usize::MAX, Start::Zero);
    }
}
