//! Bringing pictures and flows to the features' size.

use srflow_field::{FlowField, Image};

/// One output pixel along one axis: four input pixels and their weights.
struct CubicTap {
    sources: [usize; 4],
    weights: [f64; 4],
}

/// `cv2.resize(image, size, interpolation=cv2.INTER_CUBIC)` of 8-bit channels, as OpenCV 4.13 and 5.0 compute it on x86-64:
/// Keys' cubic with a = -0.75 in floating point, border pixels repeated, no smoothing when the image shrinks. (OpenCV's
/// portable code has weights of 11 bits, which changes a value in twenty by 1.)
///
/// An image without pixels stays as it is.
pub fn resize_cubic(image: &Image, (width, height): (usize, usize)) -> Image {
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
        // The cast brings what a cubic overshoots to 0 and 255.
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

/// Brings a flow to another size: each pixel is the mean of what it covers (of the nearest pixels when the flow grows), in
/// pixels of the new size.
pub fn resize_flow(flow: &FlowField, (width, height): (usize, usize)) -> FlowField {
    let columns = area_taps(flow.width(), width);
    let rows = area_taps(flow.height(), height);
    let gain = [width as f32 / flow.width().max(1) as f32, height as f32 / flow.height().max(1) as f32];
    FlowField::from_fn(width, height, |x, y| {
        let mut sum = [0.0; 2];
        for &(row, row_share) in &rows[y] {
            for &(column, column_share) in &columns[x] {
                let value = flow.get(column, row);
                for component in 0..2 {
                    sum[component] += row_share * column_share * value[component];
                }
            }
        }
        [sum[0] * gain[0], sum[1] * gain[1]]
    })
}

/// For each output pixel the input pixels under it and the share of each; the shares sum to 1.
fn area_taps(input_len: usize, output_len: usize) -> Vec<Vec<(usize, f32)>> {
    let scale = input_len as f64 / output_len as f64;
    let covered = |at: usize| {
        let start = at as f64 * scale;
        let end = (start + scale).min(input_len as f64);
        let last = (end.ceil() as usize).clamp(start as usize + 1, input_len.max(1));
        let share = |i: usize| ((end.min(i as f64 + 1.0) - start.max(i as f64)) / (end - start)) as f32;
        (start as usize..last).map(|i| (i, share(i))).collect()
    };
    if input_len == 0 { vec![Vec::new(); output_len] } else { (0..output_len).map(covered).collect() }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_resized_flow_keeps_the_motion_and_its_mean() {
        // Everything moves by a tenth of the width and a twentieth of the height.
        let flow = FlowField::filled(200, 100, [20.0, 5.0]);
        for size in [(112, 112), (50, 30), (400, 300), (200, 100)] {
            let resized = resize_flow(&flow, size);
            assert_eq!(resized.size(), size);
            for [u, v] in resized.pixels() {
                assert!((u - 0.1 * size.0 as f32).abs() < 1e-3 && (v - 0.05 * size.1 as f32).abs() < 1e-3);
            }
        }
        let ramp = FlowField::from_fn(12, 6, |x, y| [x as f32, y as f32]);
        let half = resize_flow(&ramp, (6, 3));
        assert!(half.pixels().iter().enumerate().all(|(at, [u, v])| {
            let (x, y) = (at % 6, at / 6);
            (u - (x as f32 + 0.25)).abs() < 1e-5 && (v - (y as f32 + 0.25)).abs() < 1e-5
        }));
    }

    #[test]
    fn the_same_size_is_the_same_picture() {
        let image = Image::from_fn(9, 5, |x, y| [(x * 20) as u8, (y * 50) as u8, 7]);
        assert_eq!(resize_cubic(&image, (9, 5)), image);
        assert_eq!(resize_cubic(&Image::new(0, 4), (3, 3)).size(), (0, 4));
    }
}
