//! Colour maps of errors and of other magnitudes.

use srflow_core::{FlowField, Image, Plane};

/// A perceptually uniform map from a share of a range to a colour, which survives grey printing.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ColorMap {
    /// Black through red and orange to light yellow: errors.
    Inferno,
    /// Violet through green to yellow.
    Viridis,
}

impl ColorMap {
    /// Ten equidistant colours of matplotlib's map of that name (CC0).
    fn stops(self) -> &'static [[u8; 3]; 10] {
        match self {
            Self::Inferno => &[
                [0, 0, 4],
                [27, 12, 65],
                [74, 12, 107],
                [120, 28, 109],
                [165, 44, 96],
                [207, 68, 70],
                [237, 105, 37],
                [251, 155, 6],
                [247, 209, 61],
                [252, 255, 164],
            ],
            Self::Viridis => &[
                [68, 1, 84],
                [72, 40, 120],
                [62, 74, 137],
                [49, 104, 142],
                [38, 130, 142],
                [31, 158, 137],
                [53, 183, 121],
                [110, 206, 88],
                [181, 222, 43],
                [253, 231, 37],
            ],
        }
    }

    /// The colour at `share` of the range, clamped to `0..=1`.
    pub fn color(self, share: f32) -> [u8; 3] {
        let stops = self.stops();
        let place = share.clamp(0.0, 1.0) * (stops.len() - 1) as f32;
        let below = (place as usize).min(stops.len() - 2);
        let rest = place - below as f32;
        let [low, high] = [below, below + 1].map(|stop| stops[stop].map(f32::from));
        std::array::from_fn(|c| (low[c] * (1.0 - rest) + high[c] * rest + 0.5) as u8)
    }

    /// A plane in the colours of the map: 0 has the first, `max` and above the last, NaN is grey.
    pub fn picture(self, plane: &Plane, max: f32) -> Image {
        Image::from_fn(plane.width(), plane.height(), |x, y| match plane.get(x, y) {
            value if value.is_nan() => UNKNOWN,
            value => self.color(value / max),
        })
    }
}

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
    ColorMap::Inferno.picture(plane, max)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn colours_grow_brighter_with_the_value() {
        for map in [ColorMap::Inferno, ColorMap::Viridis] {
            // Rec. 709.
            let luminance = |share: f32| {
                let [r, g, b] = map.color(share).map(f32::from);
                0.2126 * r + 0.7152 * g + 0.0722 * b
            };
            let steps: Vec<f32> = (0..=50).map(|i| luminance(i as f32 / 50.0)).collect();
            assert!(steps.windows(2).all(|pair| pair[0] < pair[1] + 1.0), "{map:?}: {steps:?}");
            assert!(steps[50] > steps[0] + 150.0, "{map:?}: {steps:?}");
            assert_eq!(map.color(-1.0), map.color(0.0));
            assert_eq!(map.color(9.0), map.color(1.0));
        }
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
