use rayon::prelude::*;

use crate::{FlowField, Size};

/// Projects a flow forward: the flow of the next pair if all motion continues unchanged. A pixel of the result takes the vector
/// whose end point is nearest to it, the first in row-major order if several are; vectors that leave the frame are ignored. If
/// none is left, the flow is zero.
///
/// This is the warm start of RAFT (Teed and Deng, ECCV 2020, section 3.3; `forward_interpolate` of `core/utils/utils.py`).
pub fn forward_interpolate(flow: &FlowField) -> FlowField {
    let Size { width, height } = flow.size();
    let mut arrivals = Vec::with_capacity(width * height);
    for y in 0..height {
        for (x, vector) in flow.row(y).iter().enumerate() {
            let head = [x as f32 + vector[0], y as f32 + vector[1]];
            let inside = |place: f32, side: usize| place > 0.0 && place < side as f32;
            if inside(head[0], width) && inside(head[1], height) {
                arrivals.push(Arrival { head, source: y * width + x });
            }
        }
    }
    let mut moved = FlowField::new(width, height);
    if arrivals.is_empty() {
        return moved;
    }
    sort_as_tree(&mut arrivals, 0);
    moved.pixels_mut().par_chunks_mut(width).enumerate().for_each(|(y, row)| {
        for (x, pixel) in row.iter_mut().enumerate() {
            *pixel = flow.pixels()[nearest(&arrivals, [x as f32, y as f32])];
        }
    });
    moved
}

/// End point of a pixel's vector.
#[derive(Debug, Clone, Copy)]
struct Arrival {
    head: [f32; 2],
    source: usize,
}

/// Builds a k-d tree: the middle element splits the rest along `axis`, and so on in both halves along the other axis.
fn sort_as_tree(arrivals: &mut [Arrival], axis: usize) {
    if arrivals.len() < 2 {
        return;
    }
    let middle = arrivals.len() / 2;
    arrivals.select_nth_unstable_by(middle, |a, b| a.head[axis].total_cmp(&b.head[axis]));
    let (before, rest) = arrivals.split_at_mut(middle);
    rayon::join(|| sort_as_tree(before, 1 - axis), || sort_as_tree(&mut rest[1..], 1 - axis));
}

/// The source of the arrival nearest to `place`. `tree` must not be empty.
fn nearest(tree: &[Arrival], place: [f32; 2]) -> usize {
    let mut best = (f32::INFINITY, usize::MAX);
    search(tree, 0, place, &mut best);
    best.1
}

fn search(tree: &[Arrival], axis: usize, place: [f32; 2], best: &mut (f32, usize)) {
    let middle = tree.len() / 2;
    let Some(Arrival { head, source }) = tree.get(middle) else { return };
    let [across, down] = [place[0] - head[0], place[1] - head[1]];
    let found = (across * across + down * down, *source);
    if found < *best {
        *best = found;
    }
    let gap = place[axis] - head[axis];
    let (before, after) = (&tree[..middle], &tree[middle + 1..]);
    let (near, far) = if gap < 0.0 { (before, after) } else { (after, before) };
    search(near, 1 - axis, place, best);
    if gap * gap <= best.0 {
        search(far, 1 - axis, place, best);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::Key;

    #[test]
    fn a_global_motion_continues() {
        let flow = FlowField::filled(9, 7, [2.0, -1.0]);
        assert_eq!(forward_interpolate(&flow), flow);
    }

    /// A block of 3 x 3 moves right by 4 over a static background.
    #[test]
    fn a_moving_block_is_found_at_its_target() {
        let block = |x: usize, y: usize| (2..5).contains(&x) && (2..5).contains(&y);
        let flow = FlowField::from_fn(12, 7, |x, y| if block(x, y) { [4.0, 0.0] } else { [0.0; 2] });
        let moved = forward_interpolate(&flow);
        assert_eq!(moved.get(7, 3), [4.0, 0.0]);
        assert_eq!(moved.get(3, 1), [0.0, 0.0]);
        assert_eq!(moved.get(10, 3), [0.0, 0.0]);
    }

    #[test]
    fn unknown_vectors_and_those_that_leave_the_frame_are_ignored() {
        assert_eq!(forward_interpolate(&FlowField::filled(4, 3, [50.0, 0.0])), FlowField::new(4, 3));
        let mut flow = FlowField::filled(4, 3, [f32::NAN; 2]);
        assert_eq!(forward_interpolate(&flow), FlowField::new(4, 3));
        flow.set(1, 1, [0.5, 0.25]);
        assert_eq!(forward_interpolate(&flow), FlowField::filled(4, 3, [0.5, 0.25]));
        assert_eq!(forward_interpolate(&FlowField::new(0, 0)).size(), Size::new(0, 0));
    }

    /// The definition by brute force: the reference does not specify which of two equally near end points it takes.
    #[test]
    fn the_nearest_end_point_wins() {
        for seed in 0..20 {
            let mut random = Key::new(seed).stream("vectors");
            let (width, height) = (5 + seed as usize, 17);
            let flow = FlowField::from_fn(width, height, |_, _| {
                let [u, v] = [(); 2].map(|()| random.uniform(-12.0, 12.0));
                // Half-pixel vectors create ties, and end points on the frame's border.
                [u, v].map(|side| (side * 2.0).round() / 2.0)
            });
            let moved = forward_interpolate(&flow);
            for (x, y) in (0..height).flat_map(|y| (0..width).map(move |x| (x, y))) {
                let mut best = (f32::INFINITY, [0.0; 2]);
                for (x0, y0) in (0..height).flat_map(|y| (0..width).map(move |x| (x, y))) {
                    let [u, v] = flow.get(x0, y0);
                    let head = [x0 as f32 + u, y0 as f32 + v];
                    let distance = (x as f32 - head[0]).powi(2) + (y as f32 - head[1]).powi(2);
                    let inside =
                        head[0] > 0.0 && head[0] < width as f32 && head[1] > 0.0 && head[1] < height as f32;
                    if inside && distance < best.0 {
                        best = (distance, [u, v]);
                    }
                }
                assert_eq!(moved.get(x, y), best.1, "seed {seed}, ({x}, {y})");
            }
        }
    }
}
