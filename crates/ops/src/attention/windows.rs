//! Attention with weights that are used once: each block of scores is computed in the cache, normalized online and applied, and
//! only the softmax statistics are kept for the gradients. Attention may be limited to windows, as in Swin (Liu et al., ICCV 2021).

use std::borrow::Cow;
use std::ops::Range;

use rayon::prelude::*;
use srflow_simd::{Isa, Output, Precision, Right, Scratch, SharedMut, Start, Steps, panel_columns};

use super::backward::Gathered;
use super::panels::{BLOCK, ChannelsAsRows, Group, PANELS, blocks, from_panels};
use super::softmax::{exponentiate, scale_columns};
use super::weights::{AttentionWeights, Gathering, Pairs, Sums, invert};
use crate::MapShape;
use crate::precision::cpu_precision;

/// A partition of an image into rectangular windows. Pixels attend only to pixels of their window.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Windows {
    /// Bands of rows, from the top.
    rows: Vec<Range<usize>>,
    /// Bands of columns, from the left.
    columns: Vec<Range<usize>>,
}

/// A rectangle of an image.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Window {
    pub(super) rows: Range<usize>,
    pub(super) columns: Range<usize>,
}

impl Windows {
    /// `splits` windows of one size along each side, or one of the whole image. Panics when the sides, height and width, are not
    /// multiples of `splits`.
    pub fn split(sides: [usize; 2], splits: usize) -> Self {
        Self::bands(sides, splits, |_| 0)
    }

    /// [`Self::split`], shifted by half a window down and right. The rest at the edges, which Swin rolls to the opposite edge and
    /// masks, forms smaller windows.
    pub fn shifted(sides: [usize; 2], splits: usize) -> Self {
        Self::bands(sides, splits, |window| window / 2)
    }

    fn bands(sides: [usize; 2], splits: usize, shift: fn(usize) -> usize) -> Self {
        let [rows, columns] = sides.map(|side| {
            assert!(splits > 0 && side.is_multiple_of(splits), "{splits} windows along {side} pixels");
            let window = side / splits;
            let cuts = (0..splits).map(|number| shift(window) + number * window);
            let mut cuts: Vec<usize> = std::iter::once(0).chain(cuts).chain([side]).collect();
            cuts.dedup();
            cuts.windows(2).map(|ends| ends[0]..ends[1]).collect()
        });
        Self { rows, columns }
    }

    /// Bands of rows, from the top, and of columns, from the left.
    pub(super) fn into_bands(self) -> [Vec<Range<usize>>; 2] {
        [self.rows, self.columns]
    }

    /// Height and width of the image.
    pub(super) fn sides(&self) -> [usize; 2] {
        [&self.rows, &self.columns].map(|bands| bands.last().map_or(0, |last| last.end))
    }

    /// Row by row.
    pub(super) fn each(&self) -> Vec<Window> {
        let row = |rows: &Range<usize>| {
            let rows = rows.clone();
            self.columns.iter().map(move |columns| Window { rows: rows.clone(), columns: columns.clone() })
        };
        self.rows.iter().flat_map(row).collect()
    }
}

impl Window {
    fn pixels(&self) -> usize {
        self.rows.len() * self.columns.len()
    }

    /// Its part of an image of `[channels, height, width]`, as `[channels, pixels]`.
    fn of<'a>(&self, image: &'a [f32], [height, width]: [usize; 2]) -> Cow<'a, [f32]> {
        if self.pixels() == height * width {
            return Cow::Borrowed(image);
        }
        let mut part = Vec::with_capacity(image.len() / (height * width) * self.pixels());
        for plane in image.chunks_exact(height * width) {
            for row in plane.chunks_exact(width).take(self.rows.end).skip(self.rows.start) {
                part.extend_from_slice(&row[self.columns.clone()]);
            }
        }
        Cow::Owned(part)
    }

    /// Writes a part, laid out as by [`Self::of`], to an image that starts at element `first`.
    ///
    /// # Safety
    /// The window of this image belongs to the calling task alone.
    unsafe fn put(&self, part: &[f32], images: &SharedMut, first: usize, [height, width]: [usize; 2]) {
        let rows = part.chunks_exact(self.columns.len());
        for (number, from) in rows.enumerate() {
            let (channel, row) = (number / self.rows.len(), self.rows.start + number % self.rows.len());
            let start = first + (channel * height + row) * width;
            // SAFETY: these elements are of the window; both ends are checked to lie in the images.
            unsafe {
                let last = images.at(start + self.columns.end - 1);
                let to = images.at(start + self.columns.start);
                debug_assert_eq!(to.wrapping_add(from.len() - 1), last);
                std::slice::from_raw_parts_mut(to, from.len()).copy_from_slice(from);
            }
        }
    }
}

/// Calls `of` with the parts of all inputs in each window of each image, `[channels, pixels]` each, and assembles the `N` outputs
/// of the same layout, with so many channels, to whole images.
fn in_windows<const I: usize, const N: usize>(
    windows: &Windows,
    batch: usize,
    inputs: [&[f32]; I],
    channels: [usize; N],
    of: impl Fn([Cow<'_, [f32]>; I], usize) -> [Vec<f32>; N] + Sync,
) -> [Vec<f32>; N] {
    let sides @ [height, width] = windows.sides();
    let each = windows.each();
    let mut outputs = channels.map(|channels| vec![0.0; batch * channels * height * width]);
    let targets = outputs.each_mut().map(|output| SharedMut::new(output));
    (0..batch * each.len()).into_par_iter().for_each(|task| {
        let (n, window) = (task / each.len(), &each[task % each.len()]);
        let own = inputs.map(|input| {
            let image = input.len() / batch;
            window.of(&input[n * image..][..image], sides)
        });
        let parts = of(own, window.pixels());
        for ((part, target), channels) in parts.iter().zip(&targets).zip(channels) {
            assert_eq!(part.len(), channels * window.pixels(), "so many channels of a window");
            // SAFETY: windows do not overlap, and this one of this image is this task's.
            unsafe { window.put(part, target, n * channels * height * width, sides) }
        }
    });
    outputs
}

/// `out_i = sum_j softmax_j(q_i . k_j) v_j` over the pixels of the window of `i`, and the softmax statistics for
/// [`windowed_attention_backward`], `[batch, 2, height, width]`.
///
/// Queries and keys are of `shape`, values of any number of channels. At the [`crate::precision()`]. Panics when the length of a slice
/// does not match, or the windows are not of these images.
pub fn windowed_attention(
    queries: &[f32],
    keys: &[f32],
    values: &[f32],
    shape: &MapShape,
    windows: &Windows,
) -> [Vec<f32>; 2] {
    check([queries, keys], [values], shape, windows);
    let precision = cpu_precision();
    let channels = [values.len() / shape.with_channels(1).elements(), 2];
    in_windows(windows, shape.batch, [queries, keys, values], channels, |[queries, keys, values], pixels| {
        let (out, Sums { maxima, inverse_sums }) =
            attend(Isa::best(), precision, [&queries, &keys, &values], pixels);
        [out, [&maxima[..pixels], &inverse_sums[..pixels]].concat()]
    })
}

/// Gradients of queries, keys and values, from the outputs of [`windowed_attention`] and `grad`, the gradient of the first. The
/// gradient of the values is empty unless `of_values`. Panics as [`windowed_attention`].
pub fn windowed_attention_backward(
    [queries, keys, values]: [&[f32]; 3],
    [out, statistics]: [&[f32]; 2],
    grad: &[f32],
    shape: &MapShape,
    windows: &Windows,
    of_values: bool,
) -> [Vec<f32>; 3] {
    check([queries, keys], [values, out, grad], shape, windows);
    assert_eq!(statistics.len(), shape.with_channels(2).elements(), "statistics of {shape:?}");
    let (isa, precision) = (Isa::best(), cpu_precision());
    let inputs = [queries, keys, values, out, statistics, grad];
    let backward = |[queries, keys, values, out, statistics, grad]: [Cow<[f32]>; 6], pixels: usize| {
        let mut sums = Sums::of_nothing(pixels.next_multiple_of(panel_columns(isa)));
        let (maxima, inverse_sums) = statistics.split_at(pixels);
        sums.maxima[..pixels].copy_from_slice(maxima);
        sums.inverse_sums[..pixels].copy_from_slice(inverse_sums);
        let weights = AttentionWeights::of_sums(isa, precision, [&queries, &keys], pixels, sums);
        let gathered = Gathered { values: &values, gathered: &out, grad: &grad };
        let [d_queries, d_keys] = weights.backward(&queries, &keys, &[gathered], &vec![0.0; pixels]);
        let d_values = if of_values { weights.gather_backward(&queries, &keys, &grad) } else { Vec::new() };
        [d_queries, d_keys, d_values]
    };
    let of_values = if of_values { values.len() / shape.with_channels(1).elements() } else { 0 };
    in_windows(windows, shape.batch, inputs, [shape.channels, shape.channels, of_values], backward)
}

fn check<const N: usize>(pairs: [&[f32]; 2], others: [&[f32]; N], shape: &MapShape, windows: &Windows) {
    assert!(shape.elements() > 0, "attention: pixels and channels: {shape:?}");
    assert_eq!(windows.sides(), [shape.height, shape.width], "attention: windows of the image");
    for pair in pairs {
        assert_eq!(pair.len(), shape.elements(), "queries and keys of {shape:?}");
    }
    for other in others {
        assert_eq!(other.len(), others[0].len(), "as many outputs as values");
        assert!(other.len().is_multiple_of(shape.with_channels(1).elements()), "values of {shape:?}");
    }
}

/// Attention between all pixels of a window, `[channels, pixels]` like its inputs, and the softmax statistics.
pub(super) fn attend(
    isa: Isa,
    precision: Precision,
    [queries, keys, values]: [&[f32]; 3],
    pixels: usize,
) -> (Vec<f32>, Sums) {
    let width = panel_columns(isa);
    let channels = values.len() / pixels;
    let pairs = Pairs::new(isa, precision, queries, keys, pixels);
    let values = ChannelsAsRows::new(isa, precision, values, pixels, BLOCK);
    let gathering = Gathering { isa, values: &values };
    let columns = pixels.next_multiple_of(width);
    let mut sums = Sums::of_nothing(columns);
    let mut out = vec![0.0; channels * columns];
    let statistics = sums.maxima.par_chunks_mut(PANELS * width);
    let statistics = statistics.zip(sums.inverse_sums.par_chunks_mut(PANELS * width));
    out.par_chunks_mut(PANELS * channels * width).zip(statistics).enumerate().for_each_init(
        || (Scratch::of(PANELS * BLOCK * width), Scratch::of(PANELS * width)),
        |(scores, factors), (number, (out, (maxima, sums)))| {
            let group = Group::of(isa, number, pixels);
            let step = BLOCK * width;
            for block @ (first, len) in blocks(pixels) {
                let mut output = Output::new(scores, Steps { row: width, panel: step });
                pairs.multiply(group, block, Start::Zero, &mut output);
                for panel in 0..group.panels {
                    let own = panel * width..(panel + 1) * width;
                    let (maxima, sums) = (&mut maxima[own.clone()], &mut sums[own.clone()]);
                    exponentiate(
                        isa,
                        &mut scores[panel * step..][..len * width],
                        maxima,
                        sums,
                        &mut factors[own],
                    );
                }
                if first > 0 {
                    scale(out, channels, factors, width);
                }
                let mut output = Output::new(out, Steps { row: width, panel: channels * width });
                gathering.add(group, block, Right::F32(scores), step, &mut output);
            }
            invert(sums, maxima);
            scale(out, channels, sums, width);
        },
    );
    (from_panels(isa, &out, pixels), sums)
}

/// Multiplies the columns of panels of `channels` rows.
fn scale(panels: &mut [f32], channels: usize, factors: &[f32], width: usize) {
    for (panel, factors) in panels.chunks_exact_mut(channels * width).zip(factors.chunks_exact(width)) {
        if factors.iter().any(|&factor| factor != 1.0) {
            scale_columns(panel, factors);
        }
    }
}
