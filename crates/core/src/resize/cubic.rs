use crate::{Image, Size};

/// One output pixel along one axis: four input pixels and their weights.
struct CubicTap {
    sources: [usize; 4],
    weights: [f64; 4],
}

/// `cv2.resize(image, size, interpolation=cv2.INTER_CUBIC)` of 8-bit channels, as in OpenCV 4.13 and 5.0 on x86-64: Keys' cubic
/// with a = -0.75 in floating point, border pixels repeated, no smoothing when downscaling. (OpenCV's portable code uses
/// 11-bit weights, which changes one value in twenty by 1.)
///
/// An image without pixels is returned unchanged.
pub fn resize_cubic(image: &Image, Size { width, height }: Size) -> Image {
    if image.width() == 0 || image.height() == 0 {
        return image.clone();
    }
    let columns = cubic_taps(image.width(), width);
    let rows = cubic_taps(image.height(), height);
    let across = |row: usize, tap: &CubicTap| -> [f64; 3] {
        let line = image.row(row);
        let mut sum = [0.0; 3];
        for (source, weight) in tap.sources.iter().zip(tap.weights) {
            for channel in 0..3 {
                sum[channel] += weight * f64::from(line[*source][channel]);
            }
        }
        sum
    };
    let stretched: Vec<Vec<[f64; 3]>> =
        (0..image.height()).map(|row| columns.iter().map(|tap| across(row, tap)).collect()).collect();
    Image::from_fn(width, height, |x, y| {
        let tap = &rows[y];
        let mut sum = [0.0; 3];
        for (source, weight) in tap.sources.iter().zip(tap.weights) {
            for channel in 0..3 {
                sum[channel] += weight * stretched[*source][x][channel];
            }
        }
        // The cast clamps overshoot to 0..=255.
        sum.map(|sum| sum.round_ties_even() as u8)
    })
}

fn cubic_taps(input_len: usize, output_len: usize) -> Vec<CubicTap> {
    let scale = input_len as f64 / output_len as f64;
    let last = input_len as i64 - 1;
    let tap = |at: usize| {
        let position = (at as f64 + 0.5) * scale - 0.5;
        let whole = position.floor();
        let sources = [-1, 0, 1, 2].map(|offset| (whole as i64 + offset).clamp(0, last) as usize);
        CubicTap { sources, weights: cubic_weights(position - whole) }
    };
    (0..output_len).map(tap).collect()
}

fn cubic_weights(x: f64) -> [f64; 4] {
    const A: f64 = -0.75;
    let w0 = ((A * (x + 1.0) - 5.0 * A) * (x + 1.0) + 8.0 * A) * (x + 1.0) - 4.0 * A;
    let w1 = ((A + 2.0) * x - (A + 3.0)) * x * x + 1.0;
    let w2 = ((A + 2.0) * (1.0 - x) - (A + 3.0)) * (1.0 - x) * (1.0 - x) + 1.0;
    [w0, w1, w2, 1.0 - w0 - w1 - w2]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_same_size_is_the_same_picture() {
        let image = Image::from_fn(9, 5, |x, y| [(x * 20) as u8, (y * 50) as u8, 7]);
        assert_eq!(resize_cubic(&image, Size::new(9, 5)), image);
        assert_eq!(resize_cubic(&Image::new(0, 4), Size::new(3, 3)).size(), Size::new(0, 4));
    }
}
