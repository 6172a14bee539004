//! Operations on the numbers of arrays, along their axes, and on their shapes.

use std::ops::Range;

use super::map::{Map, checked};

/// A function of a number.
#[derive(Debug, Clone, Copy)]
pub(super) enum Unary {
    Relu,
    /// `x * min(max(x + 3, 0), 6) / 6`.
    HardSwish,
    /// `1 / (1 + exp(-x))`.
    Logistic,
    Negative,
    SquareRoot,
    /// `1 / sqrt(x)`.
    InverseRoot,
}

impl Unary {
    pub(super) fn of_map(self, map: &Map) -> Map {
        let function = |x: f32| match self {
            Self::Relu => x.max(0.0),
            Self::HardSwish => x * (x + 3.0).clamp(0.0, 6.0) / 6.0,
            Self::Logistic => 1.0 / (1.0 + libm::expf(-x)),
            Self::Negative => -x,
            Self::SquareRoot => x.sqrt(),
            Self::InverseRoot => 1.0 / x.sqrt(),
        };
        Map { shape: map.shape, numbers: map.numbers.iter().map(|x| function(*x)).collect() }
    }
}

/// A function of two numbers.
#[derive(Debug, Clone, Copy)]
pub(super) enum Binary {
    Add,
    Subtract,
    Multiply,
    Divide,
    SquaredDifference,
}

impl Binary {
    /// Of the numbers of two maps. An axis of size 1 is repeated.
    pub(super) fn of_maps(self, a: &Map, b: &Map) -> Result<Map, String> {
        let function = |a: f32, b: f32| match self {
            Self::Add => a + b,
            Self::Subtract => a - b,
            Self::Multiply => a * b,
            Self::Divide => a / b,
            Self::SquaredDifference => (a - b) * (a - b),
        };
        let shape = [0, 1, 2].map(|axis| match (a.shape[axis], b.shape[axis]) {
            (1, size) | (size, 1) => size,
            (size, other) if size == other => size,
            // No map is so small.
            _ => 0,
        });
        if shape.contains(&0) {
            return Err(format!("expected maps of one shape, found {:?} and {:?}", a.shape, b.shape));
        }
        checked(shape)?;
        if a.shape == b.shape {
            let numbers = a.numbers.iter().zip(&b.numbers).map(|(a, b)| function(*a, *b)).collect();
            return Ok(Map { shape, numbers });
        }
        let at = |map: &Map, place: [usize; 3]| {
            let [c, y, x] = [0, 1, 2].map(|axis| if map.shape[axis] == 1 { 0 } else { place[axis] });
            map.numbers[(c * map.shape[1] + y) * map.shape[2] + x]
        };
        let numbers = places(shape).map(|place| function(at(a, place), at(b, place))).collect();
        Ok(Map { shape, numbers })
    }
}

/// All places of a map, in the order of its numbers.
fn places([channels, height, width]: [usize; 3]) -> impl Iterator<Item = [usize; 3]> {
    (0..channels).flat_map(move |c| (0..height).flat_map(move |y| (0..width).map(move |x| [c, y, x])))
}

/// Sums along axes, which then have size 1; or means.
#[derive(Debug, Clone, Copy)]
pub(super) struct Reduction {
    /// Which of channels, rows, columns.
    pub(super) along: [bool; 3],
    pub(super) is_mean: bool,
}

impl Reduction {
    pub(super) fn of_map(self, map: &Map) -> Map {
        let shape = [0, 1, 2].map(|axis| if self.along[axis] { 1 } else { map.shape[axis] });
        let mut sums = vec![0.0; shape.iter().product()];
        for (place, number) in places(map.shape).zip(&map.numbers) {
            let [c, y, x] = [0, 1, 2].map(|axis| if self.along[axis] { 0 } else { place[axis] });
            sums[(c * shape[1] + y) * shape[2] + x] += number;
        }
        if self.is_mean {
            let of = (map.numbers.len() / sums.len().max(1)) as f32;
            sums.iter_mut().for_each(|sum| *sum /= of);
        }
        Map { shape, numbers: sums }
    }
}

/// Columns as channels, and channels as columns.
pub(super) fn transposed(map: &Map) -> Map {
    let [channels, height, width] = map.shape;
    let shape = [width, height, channels];
    let numbers = places(shape).map(|[x, y, c]| map.numbers[(c * height + y) * width + x]).collect();
    Map { shape, numbers }
}

/// A part of each of channels, rows, columns.
pub(super) fn sliced(map: &Map, parts: &[Range<usize>; 3]) -> Result<Map, String> {
    let shape = [0, 1, 2].map(|axis| parts[axis].len());
    if (0..3).any(|axis| parts[axis].is_empty() || parts[axis].end > map.shape[axis]) {
        return Err(format!("expected a part of {:?}, found {parts:?}", map.shape));
    }
    let [_, height, width] = map.shape;
    let at = |[c, y, x]: [usize; 3]| {
        map.numbers[((c + parts[0].start) * height + y + parts[1].start) * width + x + parts[2].start]
    };
    Ok(Map { shape, numbers: places(shape).map(at).collect() })
}

/// The same numbers, in TFLite's order, in another shape.
pub(super) fn reshaped(map: &Map, shape: &NewShape) -> Result<Map, String> {
    let numbers = map.numbers.len();
    let wrong = || format!("expected a shape for {numbers} numbers, found {shape:?}");
    let known = shape.0.iter().flatten().try_fold(1_usize, |known, size| known.checked_mul(*size));
    let known = known.filter(|known| *known > 0 && numbers.is_multiple_of(*known)).ok_or_else(wrong)?;
    Map::of_rows(shape.0.map(|size| size.unwrap_or(numbers / known)), &map.rows()).map_err(|_| wrong())
}

/// Channels, rows and columns; `None` for at most one that the others and the numbers determine.
#[derive(Debug, Clone, Copy)]
pub(super) struct NewShape(pub(super) [Option<usize>; 3]);

/// Maps beside each other along an axis; the others must agree.
pub(super) fn concatenated(parts: &[&Map], axis: usize) -> Result<Map, String> {
    let mut shape = parts.first().map_or([0; 3], |part| part.shape);
    shape[axis] = 0;
    for part in parts {
        let same = |other: usize| other == axis || part.shape[other] == shape[other];
        if !(0..3).all(same) {
            return Err(format!("expected maps that differ along one axis, found {:?}", part.shape));
        }
        shape[axis] = shape[axis].saturating_add(part.shape[axis]);
    }
    checked(shape)?;
    // What one step along the axes before it, and this one, takes.
    let outer: usize = shape[..axis].iter().product();
    let mut numbers = Vec::with_capacity(shape.iter().product());
    for step in 0..outer {
        for part in parts {
            let len: usize = part.shape[axis..].iter().product();
            numbers.extend_from_slice(&part.numbers[step * len..][..len]);
        }
    }
    Ok(Map { shape, numbers })
}
