use rayon::prelude::*;

use crate::{FlowField, Image, Mask, Size, SizeMismatch, check_same_size};

/// Reconstructs frame 1 by backward warping: each pixel is `frame2` at the position that `flow` points to, interpolated
/// bilinearly. The mask is `true` where that is possible: the flow is known and ends inside the frame, within `0..=W-1` and
/// `0..=H-1`. Elsewhere the image is black.
///
/// # Errors
/// When the sizes differ.
pub fn warp(frame2: &Image, flow: &FlowField) -> Result<(Image, Mask), SizeMismatch> {
    check_same_size("the frame", frame2.size(), "the flow", flow.size())?;
    let Size { width, height } = flow.size();
    let mut warped = Image::new(width, height);
    let mut valid = Mask::new(width, height);
    let rows = warped.pixels_mut().par_chunks_mut(width.max(1));
    rows.zip(valid.pixels_mut().par_chunks_mut(width.max(1))).enumerate().for_each(|(y, (warped, valid))| {
        for (x, flow) in flow.row(y).iter().enumerate() {
            let Some(corners) = Corners::at(destination(x, y, *flow), width, height) else { continue };
            let color = corners.interpolate(|index| frame2.pixels()[index].map(f32::from));
            warped[x] = color.map(|channel| (channel + 0.5) as u8);
            valid[x] = true;
        }
    });
    Ok((warped, valid))
}

/// Tolerance between the forward flow and the backward flow at its end; see [`forward_backward_check`]. With the forward flow
/// `f` of a pixel and the backward flow `b` at its end, the two agree when:
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Tolerance {
    /// `|f + b| < pixels`, as `fb_check` of ptlflow (`ptlflow/utils/flow_utils.py`), whose default is 1 pixel.
    Absolute {
        /// The limit in pixels.
        pixels: f32,
    },
    /// `|f + b|^2 < factor (|f|^2 + |b|^2) + offset` (Sundaram et al., ECCV 2010; Meister et al., *UnFlow*, AAAI 2018,
    /// equation 2).
    Relative {
        /// UnFlow: 0.01.
        factor: f32,
        /// In square pixels. UnFlow: 0.5.
        offset: f32,
    },
}

impl Tolerance {
    /// The relative tolerance with UnFlow's values.
    pub const UNFLOW: Self = Self::Relative { factor: 0.01, offset: 0.5 };
}

/// `true` where following the flow forward and then backward returns to the start: elsewhere, the pixel is occluded in frame
/// 2, or one of the flows is wrong. `backward` is the flow from frame 2 to frame 1, stored at frame 2's pixels, and is
/// interpolated bilinearly. A pixel whose flow leaves the frame, is unknown, or ends next to an unknown one is `false`.
///
/// # Errors
/// When the sizes differ.
pub fn forward_backward_check(
    forward: &FlowField,
    backward: &FlowField,
    tolerance: Tolerance,
) -> Result<Mask, SizeMismatch> {
    check_same_size("the forward flow", forward.size(), "the backward flow", backward.size())?;
    let Size { width, height } = forward.size();
    let agree = |f: [f32; 2], b: [f32; 2]| {
        let square = |[u, v]: [f32; 2]| u * u + v * v;
        let gap = square([f[0] + b[0], f[1] + b[1]]);
        match tolerance {
            Tolerance::Absolute { pixels } => gap.sqrt() < pixels,
            Tolerance::Relative { factor, offset } => gap < factor * (square(f) + square(b)) + offset,
        }
    };
    let mut consistent = Mask::new(width, height);
    let rows = consistent.pixels_mut().par_chunks_mut(width.max(1));
    rows.enumerate().for_each(|(y, consistent)| {
        for (x, (consistent, f)) in consistent.iter_mut().zip(forward.row(y)).enumerate() {
            if let Some(corners) = Corners::at(destination(x, y, *f), width, height) {
                *consistent = agree(*f, corners.interpolate(|index| backward.pixels()[index]));
            }
        }
    });
    Ok(consistent)
}

fn destination(x: usize, y: usize, [u, v]: [f32; 2]) -> [f32; 2] {
    [x as f32 + u, y as f32 + v]
}

/// The four pixels around a position, as indices into a row-major buffer, and the position between them.
struct Corners {
    top_left: usize,
    right: usize,
    down: usize,
    along: [f32; 2],
}

impl Corners {
    /// `None` when the position is outside the image (or NaN).
    fn at([x, y]: [f32; 2], width: usize, height: usize) -> Option<Self> {
        let inside = |place: f32, side: usize| place >= 0.0 && side > 0 && place <= (side - 1) as f32;
        if !(inside(x, width) && inside(y, height)) {
            return None;
        }
        let (left, top) = (x as usize, y as usize);
        let along = [x - left as f32, y - top as f32];
        // At a pixel's centre its neighbour has weight zero: it may be outside, or NaN.
        let right = usize::from(along[0] > 0.0);
        let down = if along[1] > 0.0 { width } else { 0 };
        Some(Self { top_left: top * width + left, right, down, along })
    }

    fn interpolate<const N: usize>(&self, pixel: impl Fn(usize) -> [f32; N]) -> [f32; N] {
        let between = |from: [f32; N], to: [f32; N], part: f32| -> [f32; N] {
            std::array::from_fn(|channel| from[channel] + part * (to[channel] - from[channel]))
        };
        let top = between(pixel(self.top_left), pixel(self.top_left + self.right), self.along[0]);
        let bottom_left = self.top_left + self.down;
        let bottom = between(pixel(bottom_left), pixel(bottom_left + self.right), self.along[0]);
        between(top, bottom, self.along[1])
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn ramp(width: usize, height: usize) -> Image {
        Image::from_fn(width, height, |x, y| [(10 * x) as u8, (20 * y) as u8, (5 * x + 7 * y) as u8])
    }

    #[test]
    fn warping_a_ramp_moves_it_by_the_flow() {
        let frame2 = ramp(8, 6);
        let flow = FlowField::filled(8, 6, [1.5, 0.25]);
        let (warped, valid) = warp(&frame2, &flow).unwrap();
        for y in 0..6 {
            for x in 0..8 {
                let inside = x as f32 + 1.5 <= 7.0 && y as f32 + 0.25 <= 5.0;
                assert_eq!(valid.get(x, y), inside, "({x}, {y})");
                let expected = [10.0 * (x as f32 + 1.5), 20.0 * (y as f32 + 0.25)];
                let [r, g, _] = warped.get(x, y);
                if inside {
                    assert_eq!([r, g], expected.map(|c| c.round() as u8), "({x}, {y})");
                } else {
                    assert_eq!(warped.get(x, y), [0; 3]);
                }
            }
        }
    }

    #[test]
    fn zero_flow_gives_the_frame_back_up_to_its_last_row_and_column() {
        let frame2 = ramp(5, 4);
        let (warped, valid) = warp(&frame2, &FlowField::new(5, 4)).unwrap();
        assert_eq!(warped, frame2);
        assert!(valid.pixels().iter().all(|valid| *valid));
    }

    #[test]
    fn unknown_and_extreme_flow_is_invalid_and_never_reads_outside() {
        let wild = [f32::NAN, f32::INFINITY, f32::NEG_INFINITY, f32::MAX, 1e10, -1e-3];
        for u in wild {
            let (warped, valid) = warp(&ramp(3, 2), &FlowField::filled(3, 2, [u, 0.0])).unwrap();
            assert!(!valid.get(0, 0) && warped.get(0, 0) == [0; 3], "{u}");
        }
    }

    #[test]
    fn opposite_flows_agree_and_a_gap_is_compared_with_the_tolerance() {
        let forward = FlowField::filled(20, 10, [3.0, 0.0]);
        let check = |backward: [f32; 2], tolerance| {
            let backward = FlowField::filled(20, 10, backward);
            forward_backward_check(&forward, &backward, tolerance).unwrap()
        };
        let absolute = Tolerance::Absolute { pixels: 0.5 };
        let exact = check([-3.0, 0.0], absolute);
        assert!(
            (0..20).all(|x| exact.get(x, 4) == (x <= 16)),
            "flow that leaves the frame is not consistent"
        );
        assert!(check([-2.6, 0.0], absolute).get(0, 0));
        assert!(!check([-2.4, 0.0], absolute).get(0, 0));
        // Squared gap against 0.01 (9 + b^2) + 0.5: 0.5625 < 0.6406, but 0.64 > 0.6384.
        assert!(check([-2.25, 0.0], Tolerance::UNFLOW).get(0, 0));
        assert!(!check([-2.2, 0.0], Tolerance::UNFLOW).get(0, 0));
    }

    #[test]
    fn ending_beside_an_unknown_pixel_is_not_consistent_but_ending_on_a_known_one_is() {
        let mut backward = FlowField::filled(6, 1, [-1.0, 0.0]);
        backward.set(3, 0, [f32::NAN; 2]);
        let on = FlowField::filled(6, 1, [1.0, 0.0]);
        let mask = forward_backward_check(&on, &backward, Tolerance::UNFLOW).unwrap();
        assert_eq!(mask.pixels(), [true, true, false, true, true, false]);
        let beside = FlowField::filled(6, 1, [1.25, 0.0]);
        let mask = forward_backward_check(&beside, &backward, Tolerance::UNFLOW).unwrap();
        assert_eq!(mask.pixels(), [true, false, false, true, false, false]);
    }

    #[test]
    fn sizes_must_agree() {
        let error = warp(&ramp(3, 2), &FlowField::new(2, 3)).unwrap_err();
        assert_eq!(
            error.to_string(),
            "the frame is 3x2 and the flow 2x3 (WIDTHxHEIGHT): they must have the same size"
        );
    }
}
