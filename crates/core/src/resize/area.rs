use crate::{FlowField, Plane, Size};

/// OpenCV's `INTER_AREA` to a smaller or equal size: each output pixel is the mean of the input area that it covers, multiplied by
/// `gain`.
pub fn shrink_area(input: &Plane, Size { width, height }: Size, gain: f32) -> Plane {
    let columns = spans(input.width(), width);
    let rows = spans(input.height(), height);
    Plane::from_fn(width, height, |x, y| {
        let across = |row: usize| -> f32 {
            let line = input.row(row);
            columns[x].iter().map(|&(column, share)| line[column] * share).sum()
        };
        rows[y].iter().map(|&(row, share)| across(row) * share).sum::<f32>() * gain
    })
}

/// Resizes a flow: each pixel is the mean of the area that it covers (of the nearest pixels when upscaling), in pixels of the new
/// size.
pub fn resize_flow_area(flow: &FlowField, Size { width, height }: Size) -> FlowField {
    let columns = spans(flow.width(), width);
    let rows = spans(flow.height(), height);
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

/// For every output pixel, the mean over the known input pixels in its area, weighted by overlap; row by row.
pub fn area_means<const N: usize>(
    from: Size,
    to: Size,
    value: impl Fn(usize, usize) -> Option<[f32; N]>,
) -> Vec<Option<[f32; N]>> {
    // Slivers that are due to rounding alone would make an unknown area known.
    let spans = |from: usize, to: usize| {
        let mut spans = spans(from, to);
        spans.iter_mut().for_each(|span| span.retain(|(_, share)| *share > 1e-6));
        spans
    };
    let (columns, rows) = (spans(from.width, to.width), spans(from.height, to.height));
    let mut means = Vec::with_capacity(to.pixels());
    for row in &rows {
        for column in &columns {
            let (mut sum, mut total) = ([0.0; N], 0.0);
            for &(y, y_share) in row {
                for &(x, x_share) in column {
                    let Some(value) = value(x, y) else { continue };
                    let weight = x_share * y_share;
                    total += weight;
                    sum.iter_mut().zip(value).for_each(|(sum, value)| *sum += weight * value);
                }
            }
            means.push((total > 0.0).then(|| sum.map(|sum| sum / total)));
        }
    }
    means
}

/// For each output pixel, the input pixels in its area and their shares, which sum to 1.
fn spans(input_len: usize, output_len: usize) -> Vec<Vec<(usize, f32)>> {
    let scale = input_len as f64 / output_len as f64;
    let covered = |at: usize| {
        let start = at as f64 * scale;
        let end = (start + scale).min(input_len as f64);
        let last = (end.ceil() as usize).clamp(start as usize + 1, input_len.max(start as usize + 1));
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
        for (width, height) in [(112, 112), (50, 30), (400, 300), (200, 100)] {
            let resized = resize_flow_area(&flow, Size { width, height });
            assert_eq!((resized.width(), resized.height()), (width, height));
            for [u, v] in resized.pixels() {
                assert!((u - 0.1 * width as f32).abs() < 1e-3 && (v - 0.05 * height as f32).abs() < 1e-3);
            }
        }
        let ramp = FlowField::from_fn(12, 6, |x, y| [x as f32, y as f32]);
        let half = resize_flow_area(&ramp, Size::new(6, 3));
        assert!(half.pixels().iter().enumerate().all(|(at, [u, v])| {
            let (x, y) = (at % 6, at / 6);
            (u - (x as f32 + 0.25)).abs() < 1e-5 && (v - (y as f32 + 0.25)).abs() < 1e-5
        }));
    }
}
