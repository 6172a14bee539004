//! Arrays between the operations of a network.

use super::{MAX_NUMBERS, Problem, unknown};

/// Planes of channels, rows, columns.
#[derive(Debug, Clone)]
pub(super) struct Map {
    pub(super) shape: [usize; 3],
    pub(super) numbers: Vec<f32>,
}

/// An axis of a [`Map`], or the batch, which has one map.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum MapAxis {
    Batch,
    /// Place in the shape.
    Of(usize),
}

impl MapAxis {
    /// That of an axis of TFLite's, of so many; negative ones count from the end.
    pub(super) fn of(axis: i32, rank: usize) -> Option<Self> {
        let axis = if axis < 0 { axis.checked_add(i32::try_from(rank).ok()?)? } else { axis };
        let from_end = rank.checked_sub(usize::try_from(axis).ok()?.checked_add(1)?)?;
        Some(match from_end {
            0 => Self::Of(0),
            1 => Self::Of(2),
            2 => Self::Of(1),
            3 => Self::Batch,
            _ => return None,
        })
    }
}

/// The shape of a map that has these axes in TFLite.
pub(super) fn shape_of(axes: &[usize]) -> Result<[usize; 3], Problem> {
    let at = |from_end: usize| axes.len().checked_sub(from_end).map_or(1, |place| axes[place]);
    match axes.len() <= 4 && at(4) == 1 {
        true => Ok([at(1), at(3), at(2)]),
        false => Err(unknown(format!("expected an array of 1 x rows x columns x channels, found {axes:?}"))),
    }
}

impl Map {
    pub(super) fn new(shape: [usize; 3], numbers: Vec<f32>) -> Result<Self, String> {
        let expected: usize = shape.iter().product();
        if numbers.len() != expected {
            return Err(format!("expected {expected} numbers, found {}", numbers.len()));
        }
        Ok(Self { shape, numbers })
    }

    /// From numbers in TFLite's order: rows, columns, channels.
    pub(super) fn of_rows(shape: [usize; 3], rows: &[f32]) -> Result<Self, String> {
        let [channels, height, width] = shape;
        if checked(shape)?.iter().product::<usize>() * channels != rows.len() {
            return Err(format!("expected {shape:?} numbers, found {}", rows.len()));
        }
        let pixels = height * width;
        let numbers = (0..rows.len()).map(|at| rows[at % pixels * channels + at / pixels]).collect();
        Ok(Self { shape, numbers })
    }

    /// The numbers in TFLite's order.
    pub(super) fn rows(&self) -> Vec<f32> {
        let [channels, height, width] = self.shape;
        let pixels = height * width;
        (0..self.numbers.len()).map(|at| self.numbers[at % channels * pixels + at / channels]).collect()
    }
}

/// Height and width of a map of sane size.
pub(super) fn checked(shape: [usize; 3]) -> Result<[usize; 2], String> {
    let len = shape.iter().try_fold(1_usize, |len, size| len.checked_mul(*size));
    match len {
        Some(1..=MAX_NUMBERS) => Ok([shape[1], shape[2]]),
        _ => Err(format!("expected a map of at most {MAX_NUMBERS} numbers, found {shape:?}")),
    }
}
