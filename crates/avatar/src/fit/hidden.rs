//! Pictures in which something is before the face, such as a hand: they do not look there as the other pictures say.

use glam::Vec3;
use rayon::prelude::*;
use srflow_core::median;

use super::pictures::{Difference, HiddenView, Pictures};
use super::problem::{Heads, Problem};

// Distances are in those between the outer corners of the eyes.

/// Points nearer than this are neighbours. A shadow darkens them all, and the edge of a finger does not.
const NEIGHBOURS: f64 = 0.25;

/// All points nearer than this must be visible too: at the edge of the face, the background is near.
const BORDER: f64 = 1.0 / 12.0;

/// A point looks another way if it differs from its neighbours by more than this times what is usual for it.
const FAR: f64 = 3.0;

/// Part of the noise of the colours that is added to what is usual.
const USUAL: f64 = 0.5;

/// An expression that the landmarks do not follow shifts lips and folds by so much: what is usual grows where the colours change fast.
const SHIFT: f64 = 0.05;

/// The face is unlike itself where more than this share of its points look another way. In a video of a woman who wipes her face, that is
/// 0.014 to 0.06 with her hand before it, less where the hand only touches the chin, and at most 0.007 in the others. In nine videos of
/// persons who speak, laugh, and make faces, it is at most 0.013 where the landmarks fit: the limit is close to both.
const UNLIKE: f64 = 0.0135;

/// Pictures at most so many timesteps apart show the same hand, and those between them too.
const STAYS: usize = 2;

/// A point must be visible in so many pictures.
const FEWEST: usize = 8;

impl Pictures {
    /// Leaves out the pictures in which something hides the face: it stays, where the strongest moment of an expression is soon over.
    /// `None` if it would be so in most pictures, since it is then unknown how the face looks.
    pub(super) fn leave_out_hidden(&mut self, problem: &Problem, heads: &Heads) -> Option<Vec<HiddenView>> {
        let (places, seen): (Vec<[usize; 2]>, Vec<_>) = self.differences(heads).into_iter().unzip();
        let size = problem.corners.mean.length() as f32;
        let of_face = &self.vertices[..self.of_face];
        let points: Vec<Vec3> =
            of_face.iter().map(|vertex| problem.model.template[*vertex as usize] / size).collect();
        let unlike: Vec<[usize; 2]> =
            unlike(&points, self.noise[0], &seen).into_iter().map(|picture| places[picture]).collect();
        let camera = |[timestep, view]: [usize; 2]| problem.views[timestep][view].camera_index;
        // From one timestep to the next one that is unlike too.
        let spans = |&from: &[usize; 2]| {
            let follows = move |to: &&[usize; 2]| {
                camera(**to) == camera(from) && (1..=STAYS).contains(&to[0].wrapping_sub(from[0]))
            };
            unlike.iter().filter(follows).map(move |to| (camera(from), from[0]..=to[0]))
        };
        let spans: Vec<_> = unlike.iter().flat_map(spans).collect();
        let is_hidden = |place: &&[usize; 2]| {
            spans.iter().any(|(of, timesteps)| *of == camera(**place) && timesteps.contains(&place[0]))
        };
        let hidden: Vec<[usize; 2]> = places.iter().filter(is_hidden).copied().collect();
        if 2 * hidden.len() > seen.len() {
            return None;
        }
        let leave_out = |[timestep, view]: [usize; 2]| {
            self.remove(timestep, view);
            let camera_index = problem.views[timestep][view].camera_index;
            HiddenView { timestep: problem.timesteps[timestep], camera_index }
        };
        Some(hidden.into_iter().map(leave_out).collect())
    }
}

/// The numbers of the pictures in which a face of these points is unlike the others. `noise` is that of the differences.
fn unlike(points: &[Vec3], noise: f64, pictures: &[Vec<Option<Difference>>]) -> Vec<usize> {
    let within = |reach: f64| -> Vec<Vec<usize>> {
        let of_point = |point: &Vec3| {
            let is_near = |other: &usize| f64::from(points[*other].distance(*point)) < reach;
            (0..points.len()).filter(is_near).collect()
        };
        points.par_iter().map(of_point).collect()
    };
    let (neighbours, around) = (within(NEIGHBOURS), within(BORDER));
    let from_neighbours = |seen: &Vec<Option<Difference>>| -> Vec<Option<f64>> {
        let of_point = |(point, near): (usize, &Vec<usize>)| {
            let own = seen[point].as_ref()?.levels;
            let usual = |channel: usize| {
                median(near.iter().filter_map(|at| Some(seen[*at].as_ref()?.levels[channel])))
            };
            Some((0..3).map(|channel| (own[channel] - usual(channel)).powi(2)).sum::<f64>().sqrt())
        };
        neighbours.iter().enumerate().map(of_point).collect()
    };
    let distances: Vec<Vec<Option<f64>>> = pictures.par_iter().map(from_neighbours).collect();
    let usual = |point: usize| {
        let distances: Vec<f64> = distances.iter().filter_map(|picture| picture[point]).collect();
        let slopes = pictures.iter().filter_map(|picture| Some(picture[point].as_ref()?.slope));
        (distances.len() >= FEWEST).then(|| median(distances) + USUAL * noise + SHIFT * median(slopes))
    };
    let usual: Vec<Option<f64>> = (0..points.len()).map(usual).collect();
    let share = |picture: &[Option<f64>]| {
        let ratio = |point: usize| {
            let is_inside = around[point].iter().all(|other| picture[*other].is_some());
            is_inside.then(|| Some(picture[point]? / usual[point]?)).flatten()
        };
        let ratios: Vec<f64> = (0..points.len()).filter_map(ratio).collect();
        ratios.iter().filter(|ratio| **ratio > FAR).count() as f64 / ratios.len().max(points.len() / 4) as f64
    };
    (0..pictures.len()).filter(|picture| share(&distances[*picture]) > UNLIKE).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pictures_with_other_levels_at_some_points_are_unlike_and_those_with_shadows_are_not() {
        // A face of 20 x 20 points in 20 pictures, with noise. Points at its left edge are not always to be seen.
        let points: Vec<Vec3> =
            (0..400).map(|at| Vec3::new((at % 20) as f32, (at / 20) as f32, 0.0) / 16.0).collect();
        let picture = |picture: usize| -> Vec<Option<Difference>> {
            let level = |at: usize| {
                let noise = 0.04 * (((at * 7919 + picture * 104_729) % 101) as f64 / 101.0 - 0.5);
                let (x, y) = (at % 20, at / 20);
                let fingers = picture == 7 && (4..14).contains(&y) && x % 4 == 1;
                let touch = picture == 11 && y == 2 && x % 8 == 5;
                let shadow = if picture == 15 { 0.5 * x as f64 / 20.0 } else { 0.0 };
                // The lips, whose edges are steep.
                let smile = picture == 3 && (15..17).contains(&y);
                // Beside the face.
                let background = picture == 17 && x == picture % 3;
                let other = fingers || touch || smile || background;
                noise + shadow + if other { 0.7 } else { 0.0 }
            };
            let slope = |at: usize| if (15..17).contains(&(at / 20)) { 10.0 } else { 0.1 };
            let difference = |at: usize| Difference { levels: [level(at); 3], slope: slope(at) };
            (0..400).map(|at| (at % 20 >= picture % 3).then(|| difference(at))).collect()
        };
        let pictures: Vec<_> = (0..20).map(picture).collect();
        assert_eq!(unlike(&points, 0.02, &pictures), [7]);
        assert!(unlike(&points, 0.02, &[]).is_empty());
    }
}
