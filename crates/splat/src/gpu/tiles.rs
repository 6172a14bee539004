//! Listing the splats of each tile, front to back.

use cubecl::client::Client;
use cubecl::prelude::*;

use super::buffer::Buffer;
use super::projection::HIDDEN;

/// Rows and columns of tiles, each first and one past the last.
#[derive(Debug, Clone, Copy)]
pub(super) struct Area {
    pub rows: [u32; 2],
    pub columns: [u32; 2],
}

impl Area {
    pub(super) fn tiles(self) -> usize {
        (self.rows[1] - self.rows[0]) as usize * (self.columns[1] - self.columns[0]) as usize
    }

    /// Halves, the upper or left one first; `None` for a single tile.
    pub(super) fn split(self) -> Option<[Self; 2]> {
        let half = |[first, end]: [u32; 2]| first + (end - first) / 2;
        if self.rows[1] - self.rows[0] > 1 {
            let middle = half(self.rows);
            let (upper, lower) = ([self.rows[0], middle], [middle, self.rows[1]]);
            return Some([Self { rows: upper, ..self }, Self { rows: lower, ..self }]);
        }
        let middle = half(self.columns);
        let (left, right) = ([self.columns[0], middle], [middle, self.columns[1]]);
        (middle > self.columns[0])
            .then_some([Self { columns: left, ..self }, Self { columns: right, ..self }])
    }
}

/// Splats sorted front to back.
pub(super) struct Ordered {
    pub depth_bits: Buffer<u32>,
    pub splats: Buffer<u32>,
}

/// The numbers `0, 1, ...`.
pub(super) fn indices(client: &Client, len: usize) -> Buffer<u32> {
    let indices = Buffer::empty(client, len);
    let (count, dim) = threads(client, len);
    indices_kernel::launch(client, count, dim, indices.arg());
    indices
}

/// Number of splats that are drawn, in a buffer of one number.
pub(super) fn visible(client: &Client, ordered: &Ordered) -> Buffer<u32> {
    let visible = Buffer::of(client, &[0_u32]);
    let (count, dim) = threads(client, ordered.depth_bits.len);
    visible_kernel::launch(client, count, dim, ordered.depth_bits.arg(), visible.arg());
    visible
}

/// How many tiles of `area` each splat can touch, in the order given.
pub(super) fn counts(client: &Client, ordered: &Ordered, boxes: &Buffer<u32>, area: Area) -> Buffer<u32> {
    let counts = Buffer::empty(client, ordered.splats.len);
    let (count, dim) = threads(client, ordered.splats.len);
    let Area { rows, columns } = area;
    counts_kernel::launch(
        client,
        count,
        dim,
        ordered.splats.arg(),
        boxes.arg(),
        counts.arg(),
        rows[0],
        rows[1],
        columns[0],
        columns[1],
    );
    counts
}

/// One pair per splat and tile of `area` that it can touch, in the order given: the tile, counted within the area, and the splat. The
/// pairs of each splat begin at `starts`.
pub(super) fn pairs(
    client: &Client,
    ordered: &Ordered,
    boxes: &Buffer<u32>,
    area: Area,
    starts: &Buffer<u32>,
    len: usize,
) -> [Buffer<u32>; 2] {
    let [tiles, splats] = [Buffer::empty(client, len), Buffer::empty(client, len)];
    let (count, dim) = threads(client, ordered.splats.len);
    let Area { rows, columns } = area;
    pairs_kernel::launch(
        client,
        count,
        dim,
        ordered.splats.arg(),
        boxes.arg(),
        starts.arg(),
        tiles.arg(),
        splats.arg(),
        rows[0],
        rows[1],
        columns[0],
        columns[1],
    );
    [tiles, splats]
}

/// Two numbers for each of `count` tiles: where its pairs begin and end in `tiles`, which is sorted.
pub(super) fn ranges(client: &Client, tiles: &Buffer<u32>, count: usize) -> Buffer<u32> {
    let ranges = Buffer::of(client, &vec![0_u32; 2 * count]);
    let (cubes, dim) = threads(client, tiles.len);
    ranges_kernel::launch(client, cubes, dim, tiles.arg(), ranges.arg());
    ranges
}

fn threads(client: &Client, elements: usize) -> (CubeCount, CubeDim) {
    let dim = CubeDim::new(client, elements);
    (cubecl::calculate_cube_count_elemwise(client, elements, dim), dim)
}

#[cube(launch)]
fn indices_kernel(indices: &mut [u32]) {
    if ABSOLUTE_POS < indices.len() {
        indices[ABSOLUTE_POS] = ABSOLUTE_POS as u32;
    }
}

#[cube(launch)]
fn visible_kernel(depth_bits: &[u32], visible: &mut [u32]) {
    let at = ABSOLUTE_POS;
    if at < depth_bits.len() && depth_bits[at] != HIDDEN {
        let mut last = true;
        if at + 1 < depth_bits.len() {
            last = depth_bits[at + 1] == HIDDEN;
        }
        if last {
            visible[0] = at as u32 + 1u32;
        }
    }
}

/// First and one past the last of `packed` within `first..end`; empty if the latter is not greater.
#[cube]
fn clipped(packed: u32, first: u32, end: u32) -> (u32, u32) {
    ((packed & 0xFFFFu32).max(first), (packed >> 16u32).min(end))
}

#[cube(launch)]
fn counts_kernel(
    order: &[u32],
    boxes: &[u32],
    counts: &mut [u32],
    first_row: u32,
    end_row: u32,
    first_column: u32,
    end_column: u32,
) {
    if ABSOLUTE_POS >= order.len() {
        terminate!();
    }
    let splat = order[ABSOLUTE_POS] as usize;
    let (top, bottom) = clipped(boxes[2 * splat], first_row, end_row);
    let (left, right) = clipped(boxes[2 * splat + 1], first_column, end_column);
    let mut count = 0u32;
    if top < bottom && left < right {
        count = (bottom - top) * (right - left);
    }
    counts[ABSOLUTE_POS] = count;
}

#[cube(launch)]
fn pairs_kernel(
    order: &[u32],
    boxes: &[u32],
    starts: &[u32],
    tiles: &mut [u32],
    splats: &mut [u32],
    first_row: u32,
    end_row: u32,
    first_column: u32,
    end_column: u32,
) {
    if ABSOLUTE_POS >= order.len() {
        terminate!();
    }
    let splat = order[ABSOLUTE_POS];
    let (top, bottom) = clipped(boxes[2 * splat as usize], first_row, end_row);
    let (left, right) = clipped(boxes[2 * splat as usize + 1], first_column, end_column);
    let mut at = starts[ABSOLUTE_POS] as usize;
    let mut row = top;
    while row < bottom {
        let mut column = left;
        while column < right {
            tiles[at] = (row - first_row) * (end_column - first_column) + (column - first_column);
            splats[at] = splat;
            at += 1;
            column += 1u32;
        }
        row += 1u32;
    }
}

#[cube(launch)]
fn ranges_kernel(tiles: &[u32], ranges: &mut [u32]) {
    let at = ABSOLUTE_POS;
    if at >= tiles.len() {
        terminate!();
    }
    let tile = tiles[at] as usize;
    let mut first = true;
    if at > 0 {
        first = tiles[at - 1] as usize != tile;
    }
    if first {
        ranges[2 * tile] = at as u32;
    }
    let mut last = true;
    if at + 1 < tiles.len() {
        last = tiles[at + 1] as usize != tile;
    }
    if last {
        ranges[2 * tile + 1] = at as u32 + 1u32;
    }
}
