//! MediaPipe's short-range face detector: graph `face_detection_short_range`, and that of its face landmarker, `FaceDetectorGraph`.
//! It sees a frame in 128 pixels, and misses faces that are smaller than a tenth of it. Where the whole frame shows none, they are looked
//! for in parts of it, which takes ten times as long.

use srflow_core::{Image, Size};

use crate::region::{Beyond, Region};
use crate::tflite::Network;

/// A face in shares of the detector's input: left, top, right, bottom, then x and y of right eye, left eye (as the person sees
/// them), nose, mouth, and the ears.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Detection {
    pub(crate) score: f32,
    pub(crate) bounds: [f32; 4],
    pub(crate) points: [f32; 2 * POINTS],
}

const POINTS: usize = 6;
/// Numbers of a detection: centre, size, points.
const NUMBERS: usize = 4 + 2 * POINTS;
/// Side of the input in pixels.
const SIDE: usize = 128;
/// Anchors: pixels of the input per cell, and anchors of a cell (`SsdAnchorsCalculator` with strides 8, 16, 16, 16).
const CELLS: [(usize, usize); 2] = [(8, 2), (16, 6)];
/// `min_score_thresh`.
const LEAST_SCORE: f32 = 0.5;
/// `min_suppression_threshold`: faces that overlap more are one.
const MOST_OVERLAP: f32 = 0.3;
/// How much larger than the detection the region of the face mesh is.
const MARGIN: f64 = 1.5;

/// Checks that a network is the detector.
///
/// # Errors
/// A sentence with what was expected and found.
pub(crate) fn check(network: &Network) -> Result<(), String> {
    let anchors = anchors().len();
    match network.output_lens() {
        [regressors, scores] if *regressors == NUMBERS * anchors && *scores == anchors => Ok(()),
        lens => {
            Err(format!("expected outputs of {} and {anchors} numbers, found {lens:?}", NUMBERS * anchors))
        }
    }
}

/// Channels, height and width of the input.
pub(crate) const INPUT: [usize; 3] = [3, SIDE, SIDE];

/// Side of the parts of a frame, as a share of its shorter side.
const PART: f64 = 2.0 / 3.0;

/// Lengths of their sides in a frame's longer side, at most.
const MOST_IN_A_ROW: f64 = 8.0;

/// `min_score_thresh` of parts: there are many, and letters look like faces to the detector.
const LEAST_SCORE_OF_PARTS: f32 = 0.75;

/// Where faces are looked for.
#[derive(Debug, Clone, Copy)]
pub(crate) enum Extent {
    Whole,
    Parts,
}

/// Regions of the faces for the face mesh, and their scores, from the highest.
///
/// # Errors
/// When the network does not fit together.
pub(crate) fn faces(network: &Network, frame: &Image, extent: Extent) -> Result<Vec<(Region, f32)>, String> {
    match extent {
        Extent::Whole => faces_in(network, frame, &Region::of_frame(frame)),
        Extent::Parts => {
            let squares = squares(frame.size()).into_iter();
            let parts =
                squares.map(|square| faces_in(network, frame, &square)).collect::<Result<Vec<_>, _>>()?;
            let mut faces = parts.concat();
            faces.retain(|(_, score)| *score >= LEAST_SCORE_OF_PARTS);
            Ok(apart(faces))
        }
    }
}

/// Squares that cover a frame, each half over the next one.
fn squares(frame: Size) -> Vec<Region> {
    let [shorter, longer] = [frame.width.min(frame.height), frame.width.max(frame.height)];
    let side = (PART * shorter as f64).max(longer as f64 / MOST_IN_A_ROW);
    let centres = |length: usize| {
        let rest = (length as f64 - side).max(0.0);
        // Less than a pixel is no step.
        let steps = ((rest - 1.0) / (0.5 * side)).ceil().max(0.0);
        let first = 0.5 * (length as f64 - rest);
        (0..=steps as usize).map(move |step| first + rest * step as f64 / steps.max(1.0))
    };
    let of_row = |y: f64| {
        centres(frame.width).map(move |x| Region { centre: [x, y], sides: [side; 2], rotation: 0.0 })
    };
    centres(frame.height).flat_map(of_row).collect()
}

/// Without those around the same place as one with a higher score, from the highest: the border of a part may cut a face, which then
/// overlaps the whole one little.
fn apart(mut faces: Vec<(Region, f32)>) -> Vec<(Region, f32)> {
    faces.sort_by(|(_, a), (_, b)| b.total_cmp(a));
    let mut kept: Vec<(Region, f32)> = Vec::new();
    for (face, score) in faces {
        let is_same = |(other, _): &(Region, f32)| {
            let [x, y] = [0, 1].map(|axis| other.centre[axis] - face.centre[axis]);
            x.hypot(y) < 0.5 * other.sides[0].max(face.sides[0])
        };
        if !kept.iter().any(is_same) {
            kept.push((face, score));
        }
    }
    kept
}

/// The faces in a part of a frame.
fn faces_in(network: &Network, frame: &Image, region: &Region) -> Result<Vec<(Region, f32)>, String> {
    let outputs = network.run(&region.planes(frame, [SIDE; 2], [-1.0, 1.0], Beyond::Black))?;
    let [regressors, scores] = outputs.as_slice() else {
        return Err(format!("expected two outputs, found {}", outputs.len()));
    };
    let detections = merged(decoded(regressors, scores));
    Ok(detections.iter().map(|detection| (detection.region(region), detection.score)).collect())
}

/// Centres of the anchors in shares of the input.
fn anchors() -> Vec<[f32; 2]> {
    let of_cells = |(pixels, of_cell): (usize, usize)| {
        let cells = SIDE / pixels;
        let centre = move |cell: usize| (cell as f32 + 0.5) / cells as f32;
        (0..cells * cells * of_cell).map(move |index| {
            let cell = index / of_cell;
            [centre(cell % cells), centre(cell / cells)]
        })
    };
    CELLS.into_iter().flat_map(of_cells).collect()
}

/// `TensorsToDetectionsCalculator`.
fn decoded(regressors: &[f32], scores: &[f32]) -> Vec<Detection> {
    let of_anchors = regressors.chunks_exact(NUMBERS).zip(scores).zip(anchors());
    of_anchors
        .filter_map(|((numbers, score), anchor)| {
            let score = 1.0 / (1.0 + (-score.clamp(-100.0, 100.0)).exp());
            let at = |index: usize| numbers[index] / SIDE as f32;
            let centre = [at(0) + anchor[0], at(1) + anchor[1]];
            let half = [at(2) / 2.0, at(3) / 2.0];
            let bounds = [centre[0] - half[0], centre[1] - half[1], centre[0] + half[0], centre[1] + half[1]];
            let points = std::array::from_fn(|index| at(4 + index) + anchor[index % 2]);
            let sane =
                half.iter().all(|half| *half >= 0.0) && numbers.iter().all(|number| number.is_finite());
            (score >= LEAST_SCORE && sane).then_some(Detection { score, bounds, points })
        })
        .collect()
}

/// `NonMaxSuppressionCalculator`, weighted: detections that overlap become their mean, weighted by their scores.
fn merged(mut remaining: Vec<Detection>) -> Vec<Detection> {
    remaining.sort_by(|a, b| b.score.total_cmp(&a.score));
    let mut faces = Vec::new();
    while let Some(best) = remaining.first().cloned() {
        let (same, others): (Vec<_>, Vec<_>) = remaining
            .into_iter()
            .partition(|detection| overlap(&best.bounds, &detection.bounds) > MOST_OVERLAP);
        let total: f32 = same.iter().map(|detection| detection.score).sum();
        let mean = |of: &dyn Fn(&Detection) -> f32| {
            same.iter().map(|detection| of(detection) * detection.score).sum::<f32>() / total
        };
        if same.is_empty() {
            // A face without area overlaps nothing, itself included.
            remaining = others.into_iter().skip(1).collect();
            continue;
        }
        faces.push(Detection {
            score: best.score,
            bounds: std::array::from_fn(|index| mean(&|detection| detection.bounds[index])),
            points: std::array::from_fn(|index| mean(&|detection| detection.points[index])),
        });
        remaining = others;
    }
    faces
}

/// Area that two boxes share, as a share of the area of both.
fn overlap(a: &[f32; 4], b: &[f32; 4]) -> f32 {
    let length = |axis: usize| (a[axis + 2].min(b[axis + 2]) - a[axis].max(b[axis])).max(0.0);
    let area = |bounds: &[f32; 4]| (bounds[2] - bounds[0]) * (bounds[3] - bounds[1]);
    let shared = length(0) * length(1);
    let both = area(a) + area(b) - shared;
    if both > 0.0 { shared / both } else { 0.0 }
}

impl Detection {
    /// `DetectionsToRectsCalculator` and `RectTransformationCalculator`: upright by the eyes, square by the longer side.
    fn region(&self, seen: &Region) -> Region {
        let place = |x: f32, y: f32| seen.place([f64::from(x), f64::from(y)]);
        let [left, top, right, bottom] = self.bounds;
        let [from, to] = [place(self.points[0], self.points[1]), place(self.points[2], self.points[3])];
        let side = (f64::from(right - left) * seen.sides[0]).max(f64::from(bottom - top) * seen.sides[1]);
        Region {
            centre: place((left + right) / 2.0, (top + bottom) / 2.0),
            sides: [MARGIN * side; 2],
            rotation: libm::atan2(to[1] - from[1], to[0] - from[0]),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn detection(score: f32, bounds: [f32; 4]) -> Detection {
        Detection { score, bounds, points: [0.5; 2 * POINTS] }
    }

    #[test]
    fn anchors_are_those_of_the_graph() {
        let anchors = anchors();
        assert_eq!(anchors.len(), 896);
        assert_eq!(
            [anchors[0], anchors[1], anchors[2]],
            [[1.0 / 32.0; 2], [1.0 / 32.0; 2], [3.0 / 32.0, 1.0 / 32.0]]
        );
        assert_eq!([anchors[512], anchors[895]], [[1.0 / 16.0; 2], [15.0 / 16.0; 2]]);
    }

    #[test]
    fn detections_of_one_face_become_their_weighted_mean() {
        let faces = merged(vec![
            detection(0.6, [0.12, 0.1, 0.32, 0.3]),
            detection(0.7, [0.6, 0.6, 0.8, 0.8]),
            detection(0.9, [0.1, 0.1, 0.3, 0.3]),
            detection(0.8, [0.4, 0.4, 0.4, 0.4]),
        ]);
        assert_eq!(faces.iter().map(|face| face.score).collect::<Vec<_>>(), [0.9, 0.7]);
        assert!((faces[0].bounds[0] - (0.9 * 0.1 + 0.6 * 0.12) / 1.5).abs() < 1e-6);
        assert_eq!(faces[1].bounds, [0.6, 0.6, 0.8, 0.8]);
    }

    #[test]
    fn squares_cover_a_frame_to_its_border_and_overlap_by_half() {
        let cases =
            [((1920, 1080), 10), ((256, 256), 4), ((1080, 1920), 10), ((10_000, 100), 15), ((1, 1), 1)];
        for ((width, height), count) in cases {
            let squares = squares(Size::new(width, height));
            assert_eq!(squares.len(), count, "{width}x{height}");
            for axis in 0..2 {
                let length = [width, height][axis] as f64;
                let mut places: Vec<[f64; 2]> = squares
                    .iter()
                    .map(|square| [-0.5, 0.5].map(|half| square.centre[axis] + half * square.sides[axis]))
                    .collect();
                places.sort_by(|a, b| a[0].total_cmp(&b[0]));
                let [first, last] = [places[0], places[places.len() - 1]];
                assert!(first[0] < 1.0 && last[1] > length - 1.0, "{width}x{height}: {places:?}");
                let side = squares[0].sides[axis];
                assert!(places.windows(2).all(|pair| pair[1][0] - pair[0][0] <= 0.5 * side + 1.0));
            }
        }
        assert!(squares(Size::new(30_000, 1)).len() < 20);
    }

    #[test]
    fn a_face_that_several_parts_show_counts_once() {
        let face = |x: f64, score| (Region { centre: [x, 10.0], sides: [40.0; 2], rotation: 0.0 }, score);
        let kept = apart(vec![face(10.0, 0.6), face(100.0, 0.7), face(20.0, 0.9)]);
        assert_eq!(kept, [face(20.0, 0.9), face(100.0, 0.7)]);
    }

    #[test]
    fn the_region_is_upright_by_the_eyes() {
        let seen = Region { centre: [100.0, 50.0], sides: [200.0; 2], rotation: 0.0 };
        let mut face = detection(1.0, [0.4, 0.45, 0.6, 0.55]);
        face.points[..4].copy_from_slice(&[0.45, 0.45, 0.55, 0.55]);
        let region = face.region(&seen);
        assert!((region.rotation - std::f64::consts::FRAC_PI_4).abs() < 1e-6);
        assert!((region.sides[0] - 60.0).abs() < 1e-4 && (region.centre[0] - 100.0).abs() < 1e-4);
    }
}
