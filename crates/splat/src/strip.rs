//! A row of tiles: deals its splats out to the tiles, blends each tile and writes its pixels.

use crate::blending::{Tile, TileRow};
use crate::frame::FrameRows;
use crate::ordering::Bins;
use crate::projection::{Splat, TILE, TileRect};
use crate::simd::InstructionSet;

/// What the strips of one rendering share.
#[derive(Clone, Copy)]
pub(crate) struct Scene<'a> {
    pub splats: &'a [Splat],
    pub rects: &'a [TileRect],
    pub background: [f32; 3],
}

/// Renders strip number `strip` into `pixels`, from the splats that can touch it, front to back. `CHANNELS` is 4
/// (colour and depth) or 7 (displacement and next depth too). Returns how many (splat, pixel) pairs were blended.
#[inline(always)]
pub(crate) fn render<const CHANNELS: usize>(
    isa: impl InstructionSet,
    scene: Scene<'_>,
    strip: usize,
    splats: &[u32],
    bins: &mut Bins,
    pixels: &mut FrameRows<'_>,
) -> u64 {
    let tiles = pixels.width.div_ceil(TILE);
    bins.deal(splats, tiles, |splat| {
        let rect = scene.rects[splat as usize];
        rect.left..rect.right
    });
    let mut blended = 0;
    let mut empty_from = 0;
    for tile_column in 0..tiles {
        let list = bins.get(tile_column, splats);
        if list.is_empty() {
            continue;
        }
        let left = tile_column * TILE;
        let width = TILE.min(pixels.width - left);
        let mut tile = Tile::<CHANNELS>::new(width);
        let corner = (left, strip * TILE);
        blended += tile.blend(isa, scene.splats, list, corner, pixels.height);
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
    let transmittance = row.transmittance.0.map(f32::abs);
    let alpha = transmittance.map(|t| 1.0 - t);
    // An alpha of zero means that nothing was blended, and the sums are zero too.
    let divisor = alpha.map(|a| if a > 0.0 { a } else { 1.0 });
    let mean = |channel: usize| -> [f32; TILE] {
        let sum = &row.sums[channel].0;
        std::array::from_fn(|i| sum[i] / divisor[i])
    };
    let channel = |c: usize| -> [f32; TILE] {
        let sum = &row.sums[c].0;
        std::array::from_fn(|i| sum[i] + transmittance[i] * background[c])
    };
    let color = [channel(0), channel(1), channel(2)];
    let span = y * pixels.width + left..y * pixels.width + left + width;
    if let Some(out) = pixels.image.get_mut(span.clone()) {
        let bytes = color.map(|channel| channel.map(to_byte));
        put(out, &std::array::from_fn(|i| [bytes[0][i], bytes[1][i], bytes[2][i]]));
    }
    if let Some(out) = pixels.color.get_mut(span.clone()) {
        put(out, &std::array::from_fn(|i| [color[0][i], color[1][i], color[2][i]]));
    }
    if let Some(out) = pixels.alpha.get_mut(span.clone()) {
        put(out, &alpha);
    }
    if let Some(out) = pixels.depth.get_mut(span.clone()) {
        put(out, &mean(3));
    }
    if CHANNELS == 7 {
        if let Some(out) = pixels.flow.get_mut(span.clone()) {
            let (u, v) = (&row.sums[4].0, &row.sums[5].0);
            put(out, &std::array::from_fn(|i| [u[i], v[i]]));
        }
        if let Some(out) = pixels.depth_next.get_mut(span) {
            put(out, &mean(6));
        }
    }
}

/// The first pixels of a tile's row, as many as `out` takes; a whole row by vector copies.
#[inline(always)]
fn put<T: Copy>(out: &mut [T], values: &[T; TILE]) {
    match <&mut [T; TILE]>::try_from(&mut *out) {
        Ok(out) => *out = *values,
        Err(_) => out.copy_from_slice(&values[..out.len()]),
    }
}

/// 0..1 to 0..=255, clamped, rounded.
#[inline(always)]
pub(crate) fn to_byte(value: f32) -> u8 {
    (value.clamp(0.0, 1.0) * 255.0 + 0.5) as u8
}
