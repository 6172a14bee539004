//! Prefix sums and stable sorting on a device. Nothing depends on the order in which threads run: the result is the same each time.

use cubecl::client::Client;
use cubecl::prelude::*;

use super::buffer::Buffer;

/// Threads per cube.
const UNITS: usize = 128;
/// Neighbouring numbers per thread.
const ITEMS: usize = 16;
const BLOCK: usize = UNITS * ITEMS;
/// Bits that one pass sorts by.
const DIGIT_BITS: usize = 4;
const DIGITS: usize = 1 << DIGIT_BITS;

/// Replaces each number by the sum of those before it, and returns the sum of all, in a buffer of one number. Sums stop at the largest
/// `u32`.
pub(super) fn exclusive_sums(client: &Client, numbers: &Buffer<u32>) -> Buffer<u32> {
    let blocks = numbers.len.div_ceil(BLOCK);
    let totals = Buffer::empty(client, blocks);
    let (count, dim) = cubes(client, blocks);
    block_sums::launch(client, count.clone(), dim, numbers.arg(), totals.arg());
    if blocks == 1 {
        return totals;
    }
    let total = exclusive_sums(client, &totals);
    add_to_blocks::launch(client, count, dim, numbers.arg(), totals.arg());
    total
}

/// Sorts `keys` of at most `bits` bits, and `values` with them; equal keys keep their order.
pub(super) fn sort(client: &Client, bits: usize, keys: &mut Buffer<u32>, values: &mut Buffer<u32>) {
    let blocks = keys.len.div_ceil(BLOCK);
    let (count, dim) = cubes(client, blocks);
    let mut sorted = [Buffer::empty(client, keys.len), Buffer::empty(client, keys.len)];
    for shift in (0..bits).step_by(DIGIT_BITS) {
        let starts = Buffer::<u32>::empty(client, DIGITS * blocks);
        count_digits::launch(client, count.clone(), dim, keys.arg(), starts.arg(), shift as u32, blocks);
        exclusive_sums(client, &starts);
        let [sorted_keys, sorted_values] = &mut sorted;
        scatter::launch(
            client,
            count.clone(),
            dim,
            keys.arg(),
            values.arg(),
            starts.arg(),
            sorted_keys.arg(),
            sorted_values.arg(),
            shift as u32,
            blocks,
        );
        std::mem::swap(keys, sorted_keys);
        std::mem::swap(values, sorted_values);
    }
}

/// One cube per block. There may be more cubes.
fn cubes(client: &Client, blocks: usize) -> (CubeCount, CubeDim) {
    let dim = CubeDim::new_1d(UNITS as u32);
    (cubecl::calculate_cube_count_elemwise(client, blocks * UNITS, dim), dim)
}

#[cube]
fn saturating_sum(a: u32, b: u32) -> u32 {
    let sum = a + b;
    select(sum < a, 0xFFFF_FFFFu32, sum)
}

/// The sum of the numbers of the threads before this one; the last thread's plus its own number is the sum of all. `sums` is shared
/// memory for two rows of the cube's numbers.
#[cube]
fn sum_of_earlier_threads(sums: &mut [u32], own: u32) -> u32 {
    let unit = UNIT_POS as usize;
    let mut row = 0usize;
    sums[unit] = own;
    sync_cube();
    let mut distance = 1usize;
    while distance < UNITS {
        let mut sum = sums[row + unit];
        if unit >= distance {
            sum = saturating_sum(sum, sums[row + unit - distance]);
        }
        row = UNITS - row;
        sums[row + unit] = sum;
        sync_cube();
        distance *= 2;
    }
    let mut earlier = 0u32;
    if unit > 0 {
        earlier = sums[row + unit - 1];
    }
    earlier
}

/// [`exclusive_sums`] of each block; `totals` are the sums of the blocks.
#[cube(launch)]
fn block_sums(numbers: &mut [u32], totals: &mut [u32]) {
    let block = CUBE_POS;
    if block >= totals.len() {
        terminate!();
    }
    let mut sums = Shared::<[u32]>::new_slice(comptime!(2 * UNITS));
    let unit = UNIT_POS as usize;
    let first = block * BLOCK + unit * ITEMS;
    let mut own = 0u32;
    for i in 0..ITEMS {
        if first + i < numbers.len() {
            own = saturating_sum(own, numbers[first + i]);
        }
    }
    let mut sum = sum_of_earlier_threads(&mut sums, own);
    if unit == UNITS - 1 {
        totals[block] = saturating_sum(sum, own);
    }
    for i in 0..ITEMS {
        if first + i < numbers.len() {
            let number = numbers[first + i];
            numbers[first + i] = sum;
            sum = saturating_sum(sum, number);
        }
    }
}

#[cube(launch)]
fn add_to_blocks(sums: &mut [u32], starts: &[u32]) {
    let block = CUBE_POS;
    if block >= starts.len() {
        terminate!();
    }
    for i in 0..ITEMS {
        // Neighbouring threads, neighbouring numbers.
        let at = block * BLOCK + i * UNITS + UNIT_POS as usize;
        if at < sums.len() {
            sums[at] = saturating_sum(sums[at], starts[block]);
        }
    }
}

/// How often each thread of the block has each digit: `DIGITS` rows of `UNITS` numbers in shared memory.
#[cube]
fn count_own(keys: &[u32], counts: &mut [u32], first: usize, shift: u32) {
    let unit = UNIT_POS as usize;
    for digit in 0..DIGITS {
        counts[digit * UNITS + unit] = 0u32;
    }
    for i in 0..ITEMS {
        if first + i < keys.len() {
            let digit = ((keys[first + i] >> shift) & 15u32) as usize;
            counts[digit * UNITS + unit] += 1u32;
        }
    }
}

/// How often each block has each digit: `counts[digit * blocks + block]`.
#[cube(launch)]
fn count_digits(keys: &[u32], counts: &mut [u32], shift: u32, blocks: usize) {
    let block = CUBE_POS;
    if block >= blocks {
        terminate!();
    }
    let mut own = Shared::<[u32]>::new_slice(comptime!(DIGITS * UNITS));
    let unit = UNIT_POS as usize;
    count_own(keys, &mut own, block * BLOCK + unit * ITEMS, shift);
    sync_cube();
    if unit < DIGITS {
        let mut sum = 0u32;
        for other in 0..UNITS {
            sum += own[unit * UNITS + other];
        }
        counts[unit * blocks + block] = sum;
    }
}

/// Moves each key and value to its place; `starts[digit * blocks + block]` is that of the block's first key with this digit.
#[cube(launch)]
fn scatter(
    keys: &[u32],
    values: &[u32],
    starts: &[u32],
    sorted_keys: &mut [u32],
    sorted_values: &mut [u32],
    shift: u32,
    blocks: usize,
) {
    let block = CUBE_POS;
    if block >= blocks {
        terminate!();
    }
    let mut places = Shared::<[u32]>::new_slice(comptime!(DIGITS * UNITS));
    let unit = UNIT_POS as usize;
    let first = block * BLOCK + unit * ITEMS;
    count_own(keys, &mut places, first, shift);
    sync_cube();
    // From counts to places, one thread per digit.
    if unit < DIGITS {
        let mut place = starts[unit * blocks + block];
        for other in 0..UNITS {
            let count = places[unit * UNITS + other];
            places[unit * UNITS + other] = place;
            place += count;
        }
    }
    sync_cube();
    for i in 0..ITEMS {
        if first + i < keys.len() {
            let key = keys[first + i];
            let entry = ((key >> shift) & 15u32) as usize * UNITS + unit;
            let place = places[entry] as usize;
            places[entry] += 1u32;
            sorted_keys[place] = key;
            sorted_values[place] = values[first + i];
        }
    }
}
