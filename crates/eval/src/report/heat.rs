//! The colour map of errors: black through red and orange to light yellow.

use srflow_field::{FlowField, Image, Plane};

/// Ten equidistant colours of matplotlib's `inferno` (CC0), which is perceptually uniform and survives grey printing.
const STOPS: [[f32; 3]; 10] = [
    [0.0, 0.0, 4.0],
    [27.0, 12.0, 65.0],
    [74.0, 12.0, 107.0],
    [120.0, 28.0, 109.0],
    [165.0, 44.0, 96.0],
    [207.0, 68.0, 70.0],
    [237.0, 105.0, 37.0],
    [251.0, 155.0, 6.0],
    [247.0, 209.0, 61.0],
    [252.0, 255.0, 164.0],
];

/// The colour of a pixel without ground truth.
const UNKNOWN: [u8; 3] = [150, 150, 152];

/// End-point error per pixel, in pixels; NaN without ground truth.
///
/// Both fields should have the same size; pixels outside either are ignored.
pub fn error_map(estimate: &FlowField, truth: &FlowField) -> Plane {
    let width = estimate.width().min(truth.width());
    let height = estimate.height().min(truth.height());
    Plane::from_fn(width, height, |x, y| {
        let ([u, v], [true_u, true_v]) = (estimate.get(x, y), truth.get(x, y));
        (u - true_u).hypot(v - true_v)
    })
}

/// A plane in heat colours: 0 is black, `max` and above light yellow, NaN grey.
pub fn heat(plane: &Plane, max: f32) -> Image {
    let pixels =
        plane.pixels().iter().map(|value| if value.is_nan() { UNKNOWN } else { colour(value / max) });
    Image::from_pixels(plane.width(), plane.height(), pixels.collect()).expect("one colour per pixel")
}

/// The colour at `share` of the range, clamped to `0..=1`.
pub fn colour(share: f32) -> [u8; 3] {
    let place = share.clamp(0.0, 1.0) * (STOPS.len() - 1) as f32;
    let below = (place as usize).min(STOPS.len() - 2);
    let rest = place - below as f32;
    std::array::from_fn(|c| (STOPS[below][c] * (1.0 - rest) + STOPS[below + 1][c] * rest + 0.5) as u8)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn heat_grows_brighter_with_the_error() {
        let luminance = |share: f32| colour(share).map(f32::from).iter().sum::<f32>();
        let steps: Vec<f32> = (0..=50).map(|i| luminance(i as f32 / 50.0)).collect();
        assert!(steps.windows(2).all(|pair| pair[0] <= pair[1] + 3.0), "{steps:?}");
        assert_eq!(colour(-1.0), colour(0.0));
        assert_eq!(colour(9.0), colour(1.0));
    }

    #[test]
    fn error_map_is_the_distance_and_nan_where_unknown() {
        let truth = FlowField::from_fn(2, 1, |x, _| if x == 0 { [1.0, 2.0] } else { [f32::NAN; 2] });
        let map = error_map(&FlowField::filled(2, 1, [4.0, 6.0]), &truth);
        assert_eq!(map.get(0, 0), 5.0);
        assert!(map.get(1, 0).is_nan());
        assert_eq!(heat(&map, 5.0).get(1, 0), UNKNOWN);
    }
}
