//! A row of tiles: assigns its splats to the tiles, blends each tile and writes its pixels.

use srflow_simd::Simd;

use crate::blending::{Tile, TileRow};
use crate::frame::{FrameRows, to_byte};
use crate::ordering::{Bins, Drawn};
use crate::pixel_order::{Peaks, PixelOrder};
use crate::projection::{Splat, TILE};
use crate::replay::{Place, Replay};
use crate::{Options, Sorting};

/// Data shared by the strips of one rendering.
#[derive(Clone, Copy)]
pub(crate) struct Scene<'a> {
    pub splats: &'a [Splat],
    /// If the splats are sorted per pixel.
    pub peaks: Option<&'a Peaks>,
    pub background: [f32; 3],
}

impl<'a> Scene<'a> {
    pub(crate) fn new(splats: &'a [Splat], peaks: &'a Peaks, options: &Options) -> Self {
        let peaks = (options.sorting == Sorting::PerPixel).then_some(peaks);
        Self { splats, peaks, background: options.background }
    }
}

/// Renders strip number `strip` into `pixels`, from the splats drawn there, front to back. `CHANNELS` is 4 (colour and depth)
/// or 7 (displacement and next depth too). Returns the number of blended (splat, pixel) pairs.
#[inline(always)]
pub(crate) fn render<const CHANNELS: usize>(
    s: impl Simd,
    scene: Scene<'_>,
    strip: usize,
    drawn: &[Drawn],
    bins: &mut Bins<u32>,
    (order, replay): &mut (PixelOrder, Replay),
    pixels: &mut FrameRows<'_>,
) -> u64 {
    let tiles = pixels.width.div_ceil(TILE);
    bins.deal(tiles, drawn.iter().map(|drawn| (drawn.splat, drawn.columns)));
    let mut blended = 0;
    let mut empty_from = 0;
    for tile_column in 0..tiles {
        let list = bins.get(tile_column);
        if list.is_empty() {
            continue;
        }
        let left = tile_column * TILE;
        let width = TILE.min(pixels.width - left);
        let mut tile = Tile::<CHANNELS>::new(width);
        let top = strip * TILE;
        if let Some(peaks) = scene.peaks {
            let place = Place { image_width: pixels.width, left, top, width, height: pixels.height };
            let index = |splat: u32| splat as usize;
            let shown = (scene.splats, peaks);
            let transmittance = order.forward(s, shown, list, index, place, replay);
            let sums = replay.sums::<_, CHANNELS>(s, |splat| &scene.splats[splat as usize], 0);
            for (row, (transmittance, sums)) in tile.rows.iter_mut().zip(transmittance.into_iter().zip(sums))
            {
                *row = TileRow { transmittance, sums };
            }
            blended += order.blended;
        } else {
            blended += tile.blend(s, scene.splats, list, (left, top), pixels.height);
        }
        pixels.fill_background(empty_from..left, scene.background);
        empty_from = left + width;
        for (y, row) in tile.rows.iter().enumerate().take(pixels.height) {
            write(pixels, row, (left, y), width, scene.background);
        }
    }
    pixels.fill_background(empty_from..pixels.width, scene.background);
    blended
}

/// Writes a tile's row of `width` pixels at `(left, y)`.
#[inline(always)]
fn write<const CHANNELS: usize>(
    pixels: &mut FrameRows<'_>,
    row: &TileRow<CHANNELS>,
    (left, y): (usize, usize),
    width: usize,
    background: [f32; 3],
) {
    let mut transmittance = [0.0; TILE];
    let mut alpha = [0.0; TILE];
    let mut color = [[0.0; TILE]; 3];
    for i in 0..TILE {
        transmittance[i] = row.transmittance.0[i].abs();
        alpha[i] = 1.0 - transmittance[i];
        for channel in 0..3 {
            color[channel][i] = row.sums[channel].0[i] + transmittance[i] * background[channel];
        }
    }
    let span = y * pixels.width + left..y * pixels.width + left + width;
    if let Some(out) = pixels.image.get_mut(span.clone()) {
        let mut bytes = [[0; TILE]; 3];
        for channel in 0..3 {
            for i in 0..TILE {
                bytes[channel][i] = to_byte(color[channel][i]);
            }
        }
        put(out, |i| [bytes[0][i], bytes[1][i], bytes[2][i]]);
    }
    if let Some(out) = pixels.color.get_mut(span.clone()) {
        put(out, |i| [color[0][i], color[1][i], color[2][i]]);
    }
    if let Some(out) = pixels.alpha.get_mut(span.clone()) {
        put(out, |i| alpha[i]);
    }
    if let Some(out) = pixels.depth.get_mut(span.clone()) {
        put(out, |i| mean(row.sums[3].0[i], alpha[i]));
    }
    if CHANNELS == 7 {
        if let Some(out) = pixels.flow.get_mut(span.clone()) {
            put(out, |i| [row.sums[4].0[i], row.sums[5].0[i]]);
        }
        if let Some(out) = pixels.depth_next.get_mut(span) {
            put(out, |i| mean(row.sums[6].0[i], alpha[i]));
        }
    }
}

/// Mean of a feature, given its weighted sum and the sum of the weights; 0 when nothing was blended.
#[inline(always)]
fn mean(sum: f32, alpha: f32) -> f32 {
    sum / if alpha > 0.0 { alpha } else { 1.0 }
}

/// Writes the pixels of a tile's row, as many as `out` takes. The loop over a whole row has a constant length, so it is
/// vectorized.
#[inline(always)]
fn put<T>(out: &mut [T], value: impl Fn(usize) -> T) {
    match <&mut [T; TILE]>::try_from(&mut *out) {
        Ok(out) => {
            for (i, out) in out.iter_mut().enumerate() {
                *out = value(i);
            }
        }
        Err(_) => {
            for (i, out) in out.iter_mut().enumerate() {
                *out = value(i);
            }
        }
    }
}
