//! The correlation lookup on CubeCL devices.
//!
//! Layouts: first map, or some rows of it, `[batch, height, width, channels]`; pyramid of the second, its levels one after another, each
//! `[batch, height, width, channels]`; positions `[batch, 2, height, width]`; windows
//! `[batch, levels * side^2, height, width]`. The channels of a pixel are adjacent, so the threads that share a dot product
//! read contiguous memory.

use burn::backend::TensorMetadata;
use burn_cubecl::cubecl::{self, prelude::*};
use burn_cubecl::tensor::CubeTensor;

use super::tensor::Lookup;
use crate::cube::{AtomicAdd, ByExchange, InOneStep, adds_in_one_step, contiguous, cubes, empty, zeros};

/// Threads per cube.
const UNITS: usize = 128;
/// Threads that share a dot product.
const LANES: usize = 4;
/// Channels that a thread loads at once, if their number is divisible.
const VECTOR: usize = 4;
/// Maximum number of neighbouring pixels per cube: their writes to one entry of the window fill a sector of 32 bytes.
const GROUP: usize = 8;
/// Numbers in a cube's shared memory: 16 KiB, which every device has.
const SHARED: usize = 4096;

pub(super) fn lookup(lookup: &Lookup, inputs: [CubeTensor; 3]) -> CubeTensor {
    let Lookup { second: [second_height, second_width], levels, radius, .. } = *lookup;
    let [first, second, coords] = inputs.map(contiguous);
    let [batch, height, width, channels] = first.shape().dims();
    let (side, reach) = (2 * radius + 1, 2 * radius + 2);
    let out = empty(&first, [batch, levels * side * side, height, width]);
    let group = (SHARED / (reach * reach * LANES)).clamp(1, GROUP);
    let client = first.client.clone();
    let (count, dim) = cubes(&client, (batch * height * width).div_ceil(group) * levels, UNITS);
    lookup_kernel::launch(
        &client,
        count,
        dim,
        if channels.is_multiple_of(VECTOR) { VECTOR } else { 1 },
        first.into_tensor_arg(),
        second.into_tensor_arg(),
        coords.into_tensor_arg(),
        out.clone().into_tensor_arg(),
        second_height,
        second_width,
        levels,
        1.0 / (channels as f32).sqrt(),
        radius,
        group,
    );
    out
}

/// Gradients of both maps.
pub(super) fn lookup_backward(lookup: &Lookup, inputs: [CubeTensor; 3], grad: CubeTensor) -> [CubeTensor; 2] {
    let Lookup { second: [second_height, second_width], levels, radius, .. } = *lookup;
    let ([first, second, coords], grad) = (inputs.map(contiguous), contiguous(grad));
    let [batch, height, width, channels] = first.shape().dims();
    let (d_first, d_second) = (empty(&first, first.shape()), zeros(&second, second.shape()));
    let client = first.client.clone();
    let launch = match adds_in_one_step(&client) {
        true => gradient_kernel::launch::<InOneStep>,
        false => gradient_kernel::launch::<ByExchange>,
    };
    let (count, dim) = cubes(&client, batch * height * width, UNITS);
    launch(
        &client,
        count,
        dim,
        first.into_tensor_arg(),
        second.into_tensor_arg(),
        coords.into_tensor_arg(),
        grad.into_tensor_arg(),
        d_first.clone().into_tensor_arg(),
        d_second.clone().into_tensor_arg(),
        second_height,
        second_width,
        1.0 / (channels as f32).sqrt(),
        levels,
        radius,
    );
    [d_first, d_second]
}

/// A level of the pyramid.
#[derive(CubeType)]
struct Level {
    /// Index of its first number.
    start: usize,
    height: usize,
    width: usize,
    /// Ratio of its size to that of the finest level.
    scale: f32,
}

/// Halves the size down to the requested level; `numbers` is the count per image pixel, over all images.
#[cube]
fn level_of(height: usize, width: usize, numbers: usize, number: usize) -> Level {
    let mut start = 0;
    let mut level_height = height;
    let mut level_width = width;
    let mut scale = 1.0;
    for _ in 0..number {
        start += level_height * level_width * numbers;
        level_height /= 2;
        level_width /= 2;
        scale *= 0.5;
    }
    Level { start, height: level_height, width: level_width, scale }
}

/// Position of a pixel's window in a level: the integer position of the upper left corner, and the fraction.
#[derive(CubeType)]
struct Window {
    left: f32,
    top: f32,
    right: f32,
    below: f32,
}

/// Pixel `at` of image `n`.
#[cube]
fn window_of(
    coords: &Tensor<f32>,
    n: usize,
    at: usize,
    pixels: usize,
    scale: f32,
    #[comptime] radius: usize,
) -> Window {
    let x = coords[n * 2 * pixels + at] * scale;
    let y = coords[(n * 2 + 1) * pixels + at] * scale;
    let reach = f32::cast_from(radius);
    Window { left: x.floor() - reach, top: y.floor() - reach, right: x - x.floor(), below: y - y.floor() }
}

/// Compared as floats before any cast: a position may have any value, including NaN.
#[cube]
fn inside(x: f32, y: f32, level: &Level) -> bool {
    x >= 0.0 && y >= 0.0 && x < f32::cast_from(level.width) && y < f32::cast_from(level.height)
}

/// A cube computes one level's windows of `group` pixels: first the dot products at the `reach^2` integer positions of each,
/// `LANES` threads per product, each with every `LANES`-th vector of the channels; then their bilinear samples.
#[cube(launch)]
#[allow(clippy::manual_div_ceil)] // This form was tested on a device.
fn lookup_kernel<N: Size>(
    first: &Tensor<Vector<f32, N>>,
    second: &Tensor<Vector<f32, N>>,
    coords: &Tensor<f32>,
    out: &mut Tensor<f32>,
    second_height: usize,
    second_width: usize,
    levels: usize,
    scale: f32,
    #[comptime] radius: usize,
    #[comptime] group: usize,
) {
    let side = comptime!(2 * radius + 1);
    let reach = comptime!(2 * radius + 2);
    let products = comptime!(reach * reach * group);
    let (batch, height, width) = (first.shape(0), first.shape(1), first.shape(2));
    let vectors = first.shape(3) / first.vector_size();
    let pixels = height * width;
    let groups = (batch * pixels + group - 1) / group;
    let number = CUBE_POS / groups;
    if number >= levels {
        terminate!();
    }
    let first_pixel = CUBE_POS % groups * group;
    let level = level_of(second_height, second_width, batch * vectors, number);

    let mut shares = Shared::new_slice(comptime!(products * LANES));
    let unit = UNIT_POS as usize;
    let lane = unit % LANES;
    let mut product = unit / LANES;
    while product < products {
        let pixel = first_pixel + product / (reach * reach);
        let position = product % (reach * reach);
        let mut sum = Vector::<f32, N>::new(0.0);
        if pixel < batch * pixels {
            let n = pixel / pixels;
            let window = window_of(coords, n, pixel % pixels, pixels, level.scale, radius);
            let x = window.left + f32::cast_from(position % reach);
            let y = window.top + f32::cast_from(position / reach);
            if inside(x, y, &level) {
                let row = n * level.height + usize::cast_from(y);
                let there = level.start + (row * level.width + usize::cast_from(x)) * vectors;
                let here = pixel * vectors;
                let mut c = lane;
                while c < vectors {
                    sum += first[here + c] * second[there + c];
                    c += LANES;
                }
            }
        }
        let mut share = 0.0;
        #[unroll]
        for i in 0..sum.vector_size() {
            share += sum.extract(i);
        }
        shares[product * LANES + lane] = share;
        product += UNITS / LANES;
    }
    sync_cube();

    // Neighbouring threads write neighbouring pixels of one entry.
    let mut index = unit;
    while index < side * side * group {
        let pixel = first_pixel + index % group;
        let entry = index / group;
        if pixel < batch * pixels {
            let n = pixel / pixels;
            let at = pixel % pixels;
            let window = window_of(coords, n, at, pixels, level.scale, radius);
            // The reference's order: x is the slower index.
            let corner = index % group * (reach * reach) + entry % side * reach + entry / side;
            let mut corners = Array::<f32>::new(4usize);
            #[unroll]
            for k in 0..4usize {
                let mut sum = 0.0;
                #[unroll]
                for lane in 0..LANES {
                    sum += shares[(corner + k / 2 * reach + k % 2) * LANES + lane];
                }
                corners[k] = sum;
            }
            let upper = corners[0] * (1.0 - window.right) + corners[1] * window.right;
            let lower = corners[2] * (1.0 - window.right) + corners[3] * window.right;
            let sample = upper * (1.0 - window.below) + lower * window.below;
            let channel = (n * levels + number) * side * side + entry;
            out[channel * pixels + at] = sample * scale;
        }
        index += UNITS;
    }
}

/// A cube computes the gradients of one pixel's windows: first those of the dot products of all levels, then, with the channels
/// divided among the threads, those of the pixel's own features and of the second map's, which other cubes add to as well.
#[cube(launch)]
fn gradient_kernel<A: AtomicAdd>(
    first: &Tensor<f32>,
    second: &Tensor<f32>,
    coords: &Tensor<f32>,
    grad: &Tensor<f32>,
    d_first: &mut Tensor<f32>,
    d_second: &mut Tensor<Atomic<A::Cell>>,
    second_height: usize,
    second_width: usize,
    scale: f32,
    #[comptime] levels: usize,
    #[comptime] radius: usize,
) {
    let side = comptime!(2 * radius + 1);
    let reach = comptime!(2 * radius + 2);
    let area = comptime!(reach * reach);
    let (batch, height, width, channels) = (first.shape(0), first.shape(1), first.shape(2), first.shape(3));
    let pixels = height * width;
    let pixel = CUBE_POS;
    if pixel >= batch * pixels {
        terminate!();
    }
    let n = pixel / pixels;
    let at = pixel % pixels;
    let unit = UNIT_POS as usize;
    let mut d_products = Shared::new_slice(comptime!(levels * area));
    let mut product = unit;
    while product < levels * area {
        let number = product / area;
        let column = product % area % reach;
        let row = product % area / reach;
        let level = level_of(second_height, second_width, batch * channels, number);
        let window = window_of(coords, n, at, pixels, level.scale, radius);
        let mut sum = 0.0;
        // The samples for which this product is the upper left, upper right, lower left and lower right corner.
        #[unroll]
        for k in 0..4usize {
            let (i, j) = (column - k % 2, row - k / 2);
            if column >= k % 2 && i < side && row >= k / 2 && j < side {
                let channel = (n * levels + number) * side * side + i * side + j;
                let across = if k % 2 == 0 { 1.0 - window.right } else { window.right };
                let down = if k / 2 == 0 { 1.0 - window.below } else { window.below };
                sum += across * down * grad[channel * pixels + at];
            }
        }
        d_products[product] = sum * scale;
        product += UNITS;
    }
    sync_cube();

    let mut c = unit;
    while c < channels {
        let own = first[pixel * channels + c];
        let mut sum = 0.0;
        for number in 0..levels {
            let level = level_of(second_height, second_width, batch * channels, number);
            let window = window_of(coords, n, at, pixels, level.scale, radius);
            for position in 0..area {
                let x = window.left + f32::cast_from(position % reach);
                let y = window.top + f32::cast_from(position / reach);
                if inside(x, y, &level) {
                    let row = n * level.height + usize::cast_from(y);
                    let there = level.start + (row * level.width + usize::cast_from(x)) * channels + c;
                    let d_product = d_products[number * area + position];
                    sum += d_product * second[there];
                    A::add(&mut d_second[there], d_product * own);
                }
            }
        }
        d_first[pixel * channels + c] = sum;
        c += UNITS;
    }
}
