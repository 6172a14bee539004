//! Placing the evaluated window in a frame.

use srflow_core::{Mask, Size};

/// A window of a frame, in pixels.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Window {
    /// First column.
    pub left: usize,
    /// First row.
    pub top: usize,
    /// Width in pixels.
    pub width: usize,
    /// Height in pixels.
    pub height: usize,
}

impl Window {
    /// Itself, if it has pixels and lies in a frame of this size.
    pub(crate) fn inside(self, frame: Size) -> Result<Self, String> {
        let fits = |start: usize, len: usize, size: usize| {
            len > 0 && start.checked_add(len).is_some_and(|end| end <= size)
        };
        match fits(self.left, self.width, frame.width) && fits(self.top, self.height, frame.height) {
            true => Ok(self),
            false => Err(format!("expected a window inside of the frame of {frame}, found {self:?}")),
        }
    }
}

#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error(
    "the crop {crop} does not fit the frame of {frame} (WIDTHxHEIGHT): choose a crop that is no larger than the frames"
)]
pub struct CropError {
    /// What was requested.
    pub crop: Size,
    pub frame: Size,
}

/// The window of `crop` around the head: centred on the centroid of `head`, then moved inside the frame.
/// Without a mask, or with an empty one, it is centred on the frame.
///
/// # Errors
/// When the crop is larger than the frame, or empty.
pub fn head_window(frame: Size, crop: Size, head: Option<&Mask>) -> Result<Window, CropError> {
    let centre = head.filter(|head| head.size() == frame).and_then(centroid);
    let middle = ((frame.width as f64 - 1.0) / 2.0, (frame.height as f64 - 1.0) / 2.0);
    window_about(frame, crop, centre.unwrap_or(middle))
}

/// The window of `crop` centred on a pixel (column, row), then moved inside the frame.
///
/// # Errors
/// When the crop is larger than the frame, or empty.
pub fn window_about(frame: Size, crop: Size, (x, y): (f64, f64)) -> Result<Window, CropError> {
    let Size { width, height } = crop;
    if width > frame.width || height > frame.height || width == 0 || height == 0 {
        return Err(CropError { crop, frame });
    }
    // The first pixel of the window centred nearest; casting a negative number gives 0.
    let first = |centre: f64, size: usize, limit: usize| {
        ((centre - (size as f64 - 1.0) / 2.0).round() as usize).min(limit - size)
    };
    Ok(Window { left: first(x, width, frame.width), top: first(y, height, frame.height), width, height })
}

/// Mean column and row of the pixels that are set; `None` when none is.
fn centroid(mask: &Mask) -> Option<(f64, f64)> {
    let (mut count, mut x_sum, mut y_sum) = (0_u64, 0_u64, 0_u64);
    for y in 0..mask.height() {
        for (x, _) in mask.row(y).iter().enumerate().filter(|(_, set)| **set) {
            count += 1;
            x_sum += x as u64;
            y_sum += y as u64;
        }
    }
    (count > 0).then(|| (x_sum as f64 / count as f64, y_sum as f64 / count as f64))
}

#[cfg(test)]
mod tests {
    use super::*;

    const FRAME: Size = Size::new(220, 320);

    fn head_at(centre: (usize, usize)) -> Mask {
        Mask::from_fn(220, 320, |x, y| x.abs_diff(centre.0) <= 10 && y.abs_diff(centre.1) <= 15)
    }

    #[test]
    fn window_is_centred_on_the_head() {
        let window = head_window(FRAME, Size::new(101, 161), Some(&head_at((90, 170)))).unwrap();
        assert_eq!(window, Window { left: 40, top: 90, width: 101, height: 161 });
    }

    #[test]
    fn window_stays_inside_the_frame() {
        let corner = head_window(FRAME, Size::new(120, 160), Some(&head_at((12, 300)))).unwrap();
        assert_eq!((corner.left, corner.top), (0, 160));
        let whole = head_window(FRAME, FRAME, Some(&head_at((12, 300)))).unwrap();
        assert_eq!((whole.left, whole.top), (0, 0));
    }

    #[test]
    fn window_without_a_head_is_in_the_middle() {
        let empty = Mask::new(220, 320);
        for head in [None, Some(&empty)] {
            let window = head_window(FRAME, Size::new(120, 160), head).unwrap();
            assert_eq!((window.left, window.top), (50, 80));
        }
    }

    #[test]
    fn window_larger_than_the_frame_is_an_error_with_both_sizes() {
        let error = head_window(FRAME, Size::new(1200, 1600), None).unwrap_err().to_string();
        assert!(error.contains("1200x1600") && error.contains("220x320"), "{error}");
        assert!(head_window(FRAME, Size::new(0, 10), None).is_err());
    }
}
