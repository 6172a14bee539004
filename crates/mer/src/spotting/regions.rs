//! The regions of a face whose motion is followed.

use crate::features::{Channel, FEATURE_SIDE, Features};
use srflow_core::Size;
use srflow_face::{AVERAGE_FACE, FacePoints, FrameCrop};

/// Their names. `left` is the left of the picture.
pub const REGIONS: [&str; 16] = [
    "inner-brow-left",
    "inner-brow-right",
    "outer-brow-left",
    "outer-brow-right",
    "glabella",
    "lids-left",
    "lids-right",
    "cheek-left",
    "cheek-right",
    "nostril-left",
    "nostril-right",
    "mouth-corner-left",
    "mouth-corner-right",
    "upper-lip",
    "lower-lip",
    "chin",
];

/// Those that move in a blink.
pub(super) const LIDS: [usize; 2] = [5, 6];

/// Half the side of a region, as a share of the distance of the outer corners of the eyes.
const HALF: f64 = 0.1;

/// Motion of each region, in pixels.
pub type RegionMotion = [[f64; 2]; 16];

/// Columns and rows of each region in a crop, the second of each not included.
pub type RegionBoxes = [[[usize; 2]; 2]; 16];

/// The regions in a crop of this size: about dlib's 68 points where there are any, else where an average face has them.
pub fn regions(points: Option<&FacePoints>, crop: &FrameCrop, size: Size) -> RegionBoxes {
    match points.and_then(|points| points.dlib.as_deref()) {
        Some(dlib) => boxes(&dlib.map(|point| crop.point(point)), size),
        None => boxes(&AVERAGE_FACE.map(|[x, y]| [x * size.width as f64, y * size.height as f64]), size),
    }
}

fn boxes(points: &[[f64; 2]; 68], size: Size) -> RegionBoxes {
    let (middles, corners) = about_points(points);
    let half = (HALF * corners).max(0.5);
    middles.map(|middle| {
        std::array::from_fn(|axis| {
            let len = [size.width, size.height][axis];
            // The casts clamp coordinates before the crop to its border.
            let first = ((middle[axis] - half).round() as usize).min(len.saturating_sub(1));
            [first, ((middle[axis] + half).round() as usize + 1).clamp(first + 1, len.max(first + 1))]
        })
    })
}

/// Mean motion in each region; 0 where none is known.
pub(super) fn mean_motion(
    boxes: &RegionBoxes,
    Size { width, height }: Size,
    motion: impl Fn(usize, usize) -> [f64; 2],
) -> RegionMotion {
    boxes.map(|[[left, right], [top, bottom]]| {
        let (mut sum, mut count) = ([0.0; 2], 0.0);
        for (x, y) in (top..bottom.min(height)).flat_map(|y| (left..right.min(width)).map(move |x| (x, y))) {
            let moved = motion(x, y);
            if moved.iter().all(|component| component.is_finite()) {
                sum = [0, 1].map(|axis| sum[axis] + moved[axis]);
                count += 1.0;
            }
        }
        sum.map(|sum| if count > 0.0 { sum / count } else { 0.0 })
    })
}

/// Mean flow of each region in features; dlib's points as shares of the maps' sides.
pub fn region_motion_of_features(points: &[[f64; 2]; 68], features: &Features) -> RegionMotion {
    let size = Size::new(FEATURE_SIDE, FEATURE_SIDE);
    let boxes = boxes(&Features::pixels_of_shares(points), size);
    let [u, v] = [Channel::U, Channel::V].map(|channel| features.channel(channel));
    mean_motion(&boxes, size, |x, y| [u, v].map(|map| f64::from(map[y * FEATURE_SIDE + x])))
}

/// The middles of the regions, and the distance of the outer corners of the eyes.
fn about_points(points: &[[f64; 2]; 68]) -> ([[f64; 2]; 16], f64) {
    let mean = |weights: &[(usize, f64)]| {
        [0, 1].map(|axis| weights.iter().map(|(index, weight)| points[*index][axis] * weight).sum::<f64>())
    };
    let even = |indices: &[usize]| {
        let weights: Vec<(usize, f64)> =
            indices.iter().map(|index| (*index, 1.0 / indices.len() as f64)).collect();
        mean(&weights)
    };
    let [left, right] = [points[36], points[45]];
    let corners = libm::hypot(right[0] - left[0], right[1] - left[1]);
    // The points of the brows lie on their lower edge.
    let above = |[x, y]: [f64; 2]| [x, y - 0.05 * corners];
    let middles = [
        above(even(&[20, 21])),
        above(even(&[22, 23])),
        above(even(&[17, 18])),
        above(even(&[25, 26])),
        even(&[21, 22]),
        even(&[37, 38, 40, 41]),
        even(&[43, 44, 46, 47]),
        mean(&[(41, 0.25), (36, 0.25), (48, 0.5)]),
        mean(&[(46, 0.25), (45, 0.25), (54, 0.5)]),
        points[31],
        points[35],
        points[48],
        points[54],
        points[51],
        points[57],
        mean(&[(57, 0.65), (8, 0.35)]),
    ];
    (middles, corners)
}
