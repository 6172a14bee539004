//! Blending on a device: [`crate::blending`], one cube of threads per tile and one thread per pixel.

use cubecl::client::Client;
use cubecl::prelude::*;
use cubecl::server::ServerError;

use super::buffer::Buffer;
use super::projection::SPLAT;
use super::tiles::Area;
use crate::projection::LOG2_ALPHA_MIN;
use crate::projection::TILE;
use crate::reference::{ALPHA_MAX, TRANSMITTANCE_MIN};
use crate::{Frame, Outputs};

/// Pixels of a tile, and splats that are in shared memory at a time.
const UNITS: usize = TILE * TILE;
/// Numbers of a splat in shared memory: centre, factor, binary logarithm of the opacity, features. With the counts of the pixels
/// this fits into the 16 KiB that every device has.
const LOADED: usize = 13;

/// The outputs of one image.
pub(super) struct Pixels {
    wanted: Outputs,
    size: [usize; 2],
    background: [f32; 3],
    /// Red, green and blue from the lowest byte on.
    image: Buffer<u32>,
    color: Buffer<f32>,
    alpha: Buffer<f32>,
    depth: Buffer<f32>,
    flow: Buffer<f32>,
    depth_next: Buffer<f32>,
}

impl Pixels {
    pub(super) fn new(client: &Client, size: [usize; 2], wanted: Outputs, background: [f32; 3]) -> Self {
        let pixels = size[0] * size[1];
        let len = |wanted: bool, numbers: usize| if wanted { numbers * pixels } else { 0 };
        Self {
            wanted,
            size,
            background,
            image: Buffer::empty(client, len(wanted.image, 1)),
            color: Buffer::empty(client, len(wanted.color, 3)),
            alpha: Buffer::empty(client, len(wanted.alpha, 1)),
            depth: Buffer::empty(client, len(wanted.depth, 1)),
            flow: Buffer::empty(client, len(wanted.flow, 2)),
            depth_next: Buffer::empty(client, len(wanted.depth_next, 1)),
        }
    }

    /// Blends the tiles of `area`; tile `i` of it has the splats `list[ranges[2 * i]..ranges[2 * i + 1]]`. Returns how many pixels
    /// were blended, one number per row of each tile.
    pub(super) fn blend(
        &self,
        client: &Client,
        splats: &Buffer<f32>,
        list: &Buffer<u32>,
        ranges: &Buffer<u32>,
        area: Area,
    ) -> Buffer<u32> {
        let blended = Buffer::empty(client, area.tiles() * TILE);
        let dim = CubeDim::new_1d(UNITS as u32);
        let count = cubecl::calculate_cube_count_elemwise(client, area.tiles() * UNITS, dim);
        blend_kernel::launch(
            client,
            count,
            dim,
            splats.arg(),
            list.arg(),
            ranges.arg(),
            blended.arg(),
            self.image.arg(),
            self.color.arg(),
            self.alpha.arg(),
            self.depth.arg(),
            self.flow.arg(),
            self.depth_next.arg(),
            self.size[0],
            self.size[1],
            area.rows[0] as usize,
            area.columns[0] as usize,
            (area.columns[1] - area.columns[0]) as usize,
            self.background[0],
            self.background[1],
            self.background[2],
            self.wanted.image,
            self.wanted.color,
            self.wanted.alpha,
            self.wanted.depth,
            self.wanted.flow,
            self.wanted.depth_next,
        );
        blended
    }

    /// Copies the outputs to a frame that was prepared for them.
    pub(super) fn read(&self, client: &Client, frame: &mut Frame) -> Result<(), ServerError> {
        if self.wanted.image {
            let [image] = Buffer::read(client, [&self.image])?;
            for (pixel, packed) in frame.image.pixels_mut().iter_mut().zip(image) {
                let [r, g, b, _] = packed.to_le_bytes();
                *pixel = [r, g, b];
            }
        }
        let floats: [(bool, &Buffer<f32>, &mut [f32]); 5] = [
            (self.wanted.color, &self.color, frame.color.as_flattened_mut()),
            (self.wanted.alpha, &self.alpha, frame.alpha.pixels_mut()),
            (self.wanted.depth, &self.depth, frame.depth.pixels_mut()),
            (self.wanted.flow, &self.flow, frame.flow.pixels_mut().as_flattened_mut()),
            (self.wanted.depth_next, &self.depth_next, frame.depth_next.pixels_mut()),
        ];
        for (wanted, buffer, output) in floats {
            if wanted {
                let [numbers] = Buffer::read(client, [buffer])?;
                output.copy_from_slice(&numbers);
            }
        }
        Ok(())
    }
}

#[cube]
fn to_byte(value: f32) -> u32 {
    u32::cast_from(value.clamp(0.0f32, 1.0f32) * 255.0f32 + 0.5f32)
}

#[cube(launch)]
fn blend_kernel(
    splats: &[f32],
    list: &[u32],
    ranges: &[u32],
    blended: &mut [u32],
    image: &mut [u32],
    color: &mut [f32],
    alpha: &mut [f32],
    depth: &mut [f32],
    flow: &mut [f32],
    depth_next: &mut [f32],
    width: usize,
    height: usize,
    first_row: usize,
    first_column: usize,
    columns: usize,
    background_red: f32,
    background_green: f32,
    background_blue: f32,
    #[comptime] with_image: bool,
    #[comptime] with_color: bool,
    #[comptime] with_alpha: bool,
    #[comptime] with_depth: bool,
    #[comptime] with_flow: bool,
    #[comptime] with_depth_next: bool,
) {
    let tile = CUBE_POS;
    if tile >= ranges.len() / 2 {
        terminate!();
    }
    let unit = UNIT_POS as usize;
    let left = (first_column + tile % columns) * TILE;
    let top = (first_row + tile / columns) * TILE;
    let (x, y) = (left + unit % TILE, top + unit / TILE);
    let inside = x < width && y < height;
    let column = f32::cast_from(unit % TILE);
    let row = f32::cast_from(unit / TILE);

    let mut loaded = Shared::<[f32]>::new_slice(comptime!(UNITS * LOADED));
    let mut counts = Shared::<[u32]>::new_slice(comptime!(UNITS));
    let mut unfinished = Shared::<[u32]>::new_slice(1usize);
    let mut transmittance = 1.0f32;
    let mut done = !inside;
    let mut count = 0u32;
    let mut red = 0.0f32;
    let mut green = 0.0f32;
    let mut blue = 0.0f32;
    let mut z = 0.0f32;
    let mut u = 0.0f32;
    let mut v = 0.0f32;
    let mut z_next = 0.0f32;

    let end = ranges[2 * tile + 1] as usize;
    let mut first = ranges[2 * tile] as usize;
    let mut going = first < end;
    while going {
        if unit == 0 {
            unfinished[0] = 0u32;
        }
        if first + unit < end {
            let splat = list[first + unit] as usize * SPLAT;
            let into = unit * LOADED;
            // The rounded centre is a whole number, so the first difference is exact.
            loaded[into] = (f32::cast_from(left) - splats[splat]) - splats[splat + 2];
            loaded[into + 1] = (f32::cast_from(top) - splats[splat + 1]) - splats[splat + 3];
            for i in 4..15usize {
                loaded[into + i - 2] = splats[splat + i];
            }
        }
        sync_cube();
        let mut here = (end - first).min(UNITS);
        if done {
            here = 0usize;
        }
        let mut i = 0usize;
        while i < here {
            let at = i * LOADED;
            let dx = loaded[at] + column;
            let dy = loaded[at + 1] + row;
            let e1 = dx * loaded[at + 2] + dy * loaded[at + 3];
            let e2 = dy * loaded[at + 4];
            let log2_alpha = loaded[at + 5] - e2 * e2 - e1 * e1;
            i += 1;
            if log2_alpha >= LOG2_ALPHA_MIN {
                let opacity = (log2_alpha * std::f32::consts::LN_2).exp().min(comptime!(ALPHA_MAX as f32));
                // One rounding, as that of a fused product: the limit is near what two Gaussians of the largest alpha leave.
                let remaining = transmittance * (1.0f32 - opacity);
                if remaining >= comptime!(TRANSMITTANCE_MIN as f32) {
                    let weight = transmittance * opacity;
                    red += weight * loaded[at + 6];
                    green += weight * loaded[at + 7];
                    blue += weight * loaded[at + 8];
                    z += weight * loaded[at + 9];
                    if comptime!(with_flow || with_depth_next) {
                        u += weight * loaded[at + 10];
                        v += weight * loaded[at + 11];
                        z_next += weight * loaded[at + 12];
                    }
                    transmittance = remaining;
                    count += 1u32;
                } else {
                    done = true;
                    i = here;
                }
            }
        }
        if !done {
            unfinished[0] = 1u32;
        }
        sync_cube();
        first += UNITS;
        going = first < end && unfinished[0] == 1u32;
        sync_cube();
    }

    counts[unit] = count;
    sync_cube();
    if unit < TILE {
        let mut sum = 0u32;
        for i in 0..TILE {
            sum += counts[unit * TILE + i];
        }
        blended[tile * TILE + unit] = sum;
    }

    if inside {
        let pixel = y * width + x;
        let covered = 1.0f32 - transmittance;
        let mut divisor = covered;
        if covered <= 0.0f32 {
            divisor = 1.0f32;
        }
        red += transmittance * background_red;
        green += transmittance * background_green;
        blue += transmittance * background_blue;
        if comptime!(with_image) {
            image[pixel] = to_byte(red) | (to_byte(green) << 8u32) | (to_byte(blue) << 16u32);
        }
        if comptime!(with_color) {
            color[3 * pixel] = red;
            color[3 * pixel + 1] = green;
            color[3 * pixel + 2] = blue;
        }
        if comptime!(with_alpha) {
            alpha[pixel] = covered;
        }
        if comptime!(with_depth) {
            depth[pixel] = z / divisor;
        }
        if comptime!(with_flow) {
            flow[2 * pixel] = u;
            flow[2 * pixel + 1] = v;
        }
        if comptime!(with_depth_next) {
            depth_next[pixel] = z_next / divisor;
        }
    }
}
