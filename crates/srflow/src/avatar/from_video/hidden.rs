//! Frames in which something is before the face, such as a hand: the colours at some points of its mesh are not those that the points
//! have in other frames.

use srflow_core::{Image, Size};
use srflow_face::Face;

use super::hull::Hull;

/// Points nearer to the outline of the face, in widths of it, are not looked at: a small error is background there.
const OUTLINE: f64 = 0.1;

/// A colour is another if it is farther from the usual one than this times its usual distance.
const FAR: f64 = 6.0;

/// Added to the usual distance, for the noise of the camera; logarithms of levels.
const NOISE: f64 = 0.02;

/// A face is hidden where more than this share of its points have other colours. On a video of a woman who wipes her face, that is 0 to
/// 0.03 of the points in frames without her hand, 0.02 to 0.04 where it touches the mouth, and 0.04 to 0.13 where it covers the nose.
const HIDDEN: f64 = 0.035;

/// Logarithms of levels at the points of a face's mesh, without its brightness and tint; `None` near the outline.
pub struct FaceColours(Vec<Option<[f64; 3]>>);

impl FaceColours {
    pub fn of(image: &Image, face: &Face) -> Self {
        let hull = Hull::of(&face.mesh);
        let across = |axis: usize| {
            let all = || face.mesh.iter().map(|point| point[axis]);
            all().fold(f64::NEG_INFINITY, f64::max) - all().fold(f64::INFINITY, f64::min)
        };
        let width = across(0);
        let reach = (width / 80.0).round().max(1.0) as i64;
        let colours = face
            .mesh
            .iter()
            .map(|point| (hull.depth(*point) > OUTLINE * width).then(|| colour(image, *point, reach)));
        let mut colours: Vec<Option<[f64; 3]>> = colours.collect();
        for channel in 0..3 {
            let usual = median(colours.iter().flatten().map(|colour| colour[channel]).collect());
            colours.iter_mut().flatten().for_each(|colour| colour[channel] -= usual);
        }
        Self(colours)
    }
}

/// For each frame whether something hides the face.
pub fn hidden(frames: &[FaceColours]) -> Vec<bool> {
    let points = frames.iter().map(|frame| frame.0.len()).min().unwrap_or(0);
    // Distances to the usual colour of each point, and how large they usually are.
    let distances: Vec<Vec<Option<f64>>> = (0..points)
        .map(|point| {
            let seen = || frames.iter().filter_map(|frame| frame.0[point]);
            let usual = [0, 1, 2].map(|channel| median(seen().map(|colour| colour[channel]).collect()));
            let distance = |colour: [f64; 3]| {
                colour.iter().zip(usual).map(|(level, usual)| (level - usual).abs()).sum::<f64>() / 3.0
            };
            let distances: Vec<Option<f64>> =
                frames.iter().map(|frame| frame.0[point].map(distance)).collect();
            let spread = median(distances.iter().flatten().copied().collect()) + NOISE;
            distances.into_iter().map(|distance| Some(distance? / spread)).collect()
        })
        .collect();
    let share = |frame: usize| {
        let of_frame: Vec<f64> = distances.iter().filter_map(|point| point[frame]).collect();
        of_frame.iter().filter(|distance| **distance > FAR).count() as f64 / of_frame.len().max(1) as f64
    };
    (0..frames.len()).map(|frame| share(frame) > HIDDEN).collect()
}

/// Mean around a place of the logarithms of levels.
fn colour(image: &Image, point: [f64; 2], reach: i64) -> [f64; 3] {
    let Size { width, height } = image.size();
    let range = |at: f64, side: usize| {
        let at = at.round() as i64;
        (at - reach..=at + reach).map(move |at| at.clamp(0, side as i64 - 1) as usize)
    };
    let mut sums = [0.0; 3];
    for y in range(point[1], height) {
        for x in range(point[0], width) {
            for (sum, level) in sums.iter_mut().zip(image.get(x, y)) {
                *sum += f64::from(level);
            }
        }
    }
    // Dark levels are mostly noise.
    sums.map(|sum| (sum / ((2 * reach + 1) * (2 * reach + 1)) as f64 + 8.0).ln())
}

/// 0 of none.
fn median(mut numbers: Vec<f64>) -> f64 {
    if numbers.is_empty() {
        return 0.0;
    }
    let middle = numbers.len() / 2;
    *numbers.select_nth_unstable_by(middle, f64::total_cmp).1
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn frames_with_other_colours_at_some_points_are_hidden() {
        // A face of 200 points in 20 frames, with noise; points near the outline turn with the head.
        let level = |point: usize, frame: usize| {
            let noise = ((point * 7919 + frame * 104_729) % 101) as f64 / 101.0 - 0.5;
            (point % 13) as f64 / 10.0 + 0.04 * noise
        };
        let frame = |frame: usize| {
            let of_point = |point: usize| {
                let covered = frame == 7 && point < 30 || frame == 11 && point < 5;
                let level = if covered { level(point, frame) + 0.7 } else { level(point, frame) };
                (point % 9 != frame % 9).then_some([level; 3])
            };
            FaceColours((0..200).map(of_point).collect())
        };
        let found = hidden(&(0..20).map(frame).collect::<Vec<_>>());
        assert_eq!(
            found.iter().enumerate().filter(|(_, hidden)| **hidden).map(|(at, _)| at).collect::<Vec<_>>(),
            [7]
        );
        assert!(hidden(&[]).is_empty());
    }
}
