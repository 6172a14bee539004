//! Occlusion of a frame's pixels in the next frame, from exact geometry.

use srflow_core::Mask;
use srflow_splat::Frame;

/// A surface is hidden when something in the next frame is nearer by more than this, in metres. Depths are means over
/// translucent layers, so two views of the same skin or hair differ slightly.
pub const DEPTH_TOLERANCE: f32 = 0.003;

/// Depth of the possible occluders: 0 where alpha is not above one half.
pub fn surface_into(frame: &Frame, surface: &mut Vec<f32>) {
    surface.clear();
    let pixels = frame.depth.pixels().iter().zip(frame.alpha.pixels());
    surface.extend(pixels.map(|(&depth, &alpha)| if alpha > 0.5 { depth } else { 0.0 }));
}

/// `true` where the surface in `frame` is not visible in the next frame, whose [`surface_into`] is `next_surface`.
///
/// On the head (alpha above one half) a pixel `p` is occluded when it moves out of the image, or when the mean depth of its
/// surface in the next camera (`depth_next`) is behind the next frame's own depth around `p + flow / alpha` by more than
/// [`DEPTH_TOLERANCE`]. Around means the four pixels that bilinear sampling reads: all of them must be nearer, so that a
/// slanted surface does not occlude itself. On the static background, a pixel is occluded when the head covers it in the
/// next frame.
pub fn occlusion(frame: &Frame, next_surface: &[f32]) -> Mask {
    let (width, height) = (frame.width, frame.height);
    let next = Surface { width, height, depth: next_surface };
    let mut hidden = Mask::new(width, height);
    let rows = hidden.pixels_mut().chunks_exact_mut(width.max(1)).enumerate();
    for (y, row) in rows {
        let (alpha, flow, depth) = (frame.alpha.row(y), frame.flow.row(y), frame.depth_next.row(y));
        let next_row = &next_surface[y * width..(y + 1) * width];
        for (x, hidden) in row.iter_mut().enumerate() {
            *hidden = if alpha[x] > 0.5 {
                let [u, v] = flow[x].map(|component| component / alpha[x]);
                depth[x] > next.hides_behind(x as f32 + u, y as f32 + v) + DEPTH_TOLERANCE
            } else {
                next_row[x] > 0.0
            };
        }
    }
    hidden
}

struct Surface<'a> {
    width: usize,
    height: usize,
    depth: &'a [f32],
}

impl Surface<'_> {
    /// Depth beyond which nothing is visible at `(x, y)`: the farthest of the four pixels around it; infinity where one of them
    /// shows the background, minus infinity outside the image.
    fn hides_behind(&self, x: f32, y: f32) -> f32 {
        let inside = x >= -0.5 && y >= -0.5 && x <= self.width as f32 - 0.5 && y <= self.height as f32 - 0.5;
        if !inside {
            return f32::NEG_INFINITY;
        }
        // Between the centres of the outermost pixels and the image border, the nearest pixel is used.
        let x0 = (x.max(0.0) as usize).min(self.width - 1);
        let y0 = (y.max(0.0) as usize).min(self.height - 1);
        let (x1, y1) = ((x0 + 1).min(self.width - 1), (y0 + 1).min(self.height - 1));
        let mut farthest = 0.0_f32;
        for at in [y0 * self.width + x0, y0 * self.width + x1, y1 * self.width + x0, y1 * self.width + x1] {
            let depth = self.depth[at];
            farthest = farthest.max(if depth > 0.0 { depth } else { f32::INFINITY });
        }
        farthest
    }
}

#[cfg(test)]
mod tests {
    use srflow_core::{FlowField, Plane, Size};

    use super::*;

    const SIZE: Size = Size::new(12, 4);

    /// A wall at 1 m over the columns `columns`, which moves by `u` pixels and will be at `depth_next`.
    fn wall(columns: std::ops::Range<usize>, u: f32, depth_next: f32) -> Frame {
        let Size { width, height } = SIZE;
        let on = |x: usize, value: f32| if columns.contains(&x) { value } else { 0.0 };
        Frame {
            width,
            height,
            alpha: Plane::from_fn(width, height, |x, _| on(x, 1.0)),
            depth: Plane::from_fn(width, height, |x, _| on(x, 1.0)),
            depth_next: Plane::from_fn(width, height, |x, _| on(x, depth_next)),
            flow: FlowField::from_fn(width, height, |x, _| [on(x, u), 0.0]),
            ..Frame::new()
        }
    }

    fn hidden_columns(frame: &Frame, next: &Frame) -> Vec<usize> {
        let mut surface = Vec::new();
        surface_into(next, &mut surface);
        let hidden = occlusion(frame, &surface);
        (0..SIZE.width).filter(|&x| hidden.get(x, 1)).collect()
    }

    #[test]
    fn a_free_motion_is_visible_and_covers_the_background() {
        assert_eq!(hidden_columns(&wall(2..6, 2.0, 1.0), &wall(4..8, 0.0, 0.0)), [6, 7]);
    }

    #[test]
    fn points_that_leave_the_image_are_hidden() {
        assert_eq!(hidden_columns(&wall(2..12, 3.0, 1.0), &wall(0..12, 0.0, 0.0)), [0, 1, 9, 10, 11]);
    }

    #[test]
    fn points_that_end_behind_a_nearer_surface_are_hidden() {
        let next = wall(5..12, 0.0, 0.0); // at 1 m
        assert_eq!(hidden_columns(&wall(0..6, 2.0, 1.1), &next), [3, 4, 5, 6, 7, 8, 9, 10, 11]);
        assert_eq!(
            hidden_columns(&wall(0..6, 2.0, 1.0 + DEPTH_TOLERANCE / 2.0), &next),
            [6, 7, 8, 9, 10, 11]
        );
        // Between a covered and an uncovered pixel something may still be visible.
        assert_eq!(hidden_columns(&wall(0..6, 1.5, 1.1), &next), [4, 5, 6, 7, 8, 9, 10, 11]);
    }

    #[test]
    fn flow_is_divided_by_alpha_to_find_the_target() {
        let mut frame = wall(0..6, 2.0, 1.1);
        frame.alpha = Plane::from_fn(SIZE.width, SIZE.height, |x, _| if x < 6 { 0.75 } else { 0.0 });
        frame.flow.pixels_mut().iter_mut().for_each(|[u, _]| *u *= 0.75);
        assert_eq!(hidden_columns(&frame, &wall(5..12, 0.0, 0.0))[..3], [3, 4, 5]);
    }
}
