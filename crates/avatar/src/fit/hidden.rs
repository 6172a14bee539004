//! Pictures in which something is before the face, such as a hand: they do not look there as the other pictures say.

use glam::Vec3;
use rayon::prelude::*;
use srflow_core::median;

use super::pictures::{Differences, HiddenView, Pictures};
use super::problem::{Heads, Problem};

/// Points nearer than this are neighbours, in distances between the outer corners of the eyes. A shadow darkens them all, and the edge
/// of a finger does not.
const NEIGHBOURS: f64 = 0.25;

/// A point looks another way if it differs from its neighbours by more than this times what is usual for it.
const FAR: f64 = 2.5;

/// Part of the noise of the colours that is added to what is usual.
const USUAL: f64 = 0.5;

/// The face is unlike itself where more than this share of its points look another way. In a video of a woman who wipes her face, that is
/// 0.10 to 0.25 with her hand before it, 0.06 to 0.11 in frames with a strong frown, and 0 to 0.06 in most others; but 0.15 to 0.18 in five
/// frames with the head bent to the side, where the fit is off.
const UNLIKE: f64 = 0.1;

/// A point must be visible in so many pictures.
const FEWEST: usize = 8;

impl Pictures {
    /// Leaves out the pictures in which something hides the face, at two timesteps after each other or more: the strongest moment of an
    /// expression is as unusual, but alone. `None` if it would be so in most pictures, since it is then unknown how the face looks.
    pub(super) fn leave_out_hidden(&mut self, problem: &Problem, heads: &Heads) -> Option<Vec<HiddenView>> {
        let (places, seen): (Vec<[usize; 2]>, Vec<Differences>) = self.differences(heads).into_iter().unzip();
        let of_face = &self.vertices[..self.of_face];
        let positions: Vec<Vec3> =
            of_face.iter().map(|vertex| problem.model.template[*vertex as usize]).collect();
        let reach = NEIGHBOURS * problem.corners.mean.length();
        let unlike: Vec<[usize; 2]> = unlike(&positions, reach, self.noise[0], &seen)
            .into_iter()
            .map(|picture| places[picture])
            .collect();
        let camera = |[timestep, view]: [usize; 2]| problem.views[timestep][view].camera_index;
        let stays = |place: &&[usize; 2]| {
            let follows =
                |other: &[usize; 2]| other[0].abs_diff(place[0]) == 1 && camera(*other) == camera(**place);
            unlike.iter().any(follows)
        };
        let hidden: Vec<[usize; 2]> = unlike.iter().filter(stays).copied().collect();
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

/// The numbers of the pictures in which a face of these points is unlike the others. Neighbours are at most `reach` apart; `noise` is that
/// of the differences.
fn unlike(points: &[Vec3], reach: f64, noise: f64, pictures: &[Differences]) -> Vec<usize> {
    let neighbours: Vec<Vec<usize>> = points
        .par_iter()
        .map(|point| {
            let is_near = |other: &usize| f64::from(points[*other].distance(*point)) < reach;
            (0..points.len()).filter(is_near).collect()
        })
        .collect();
    let from_neighbours = |seen: &Differences| -> Vec<Option<f64>> {
        let of_point = |(point, near): (usize, &Vec<usize>)| {
            let own = seen[point]?;
            let usual = |channel: usize| median(near.iter().filter_map(|point| Some(seen[*point]?[channel])));
            Some((0..3).map(|channel| (own[channel] - usual(channel)).powi(2)).sum::<f64>().sqrt())
        };
        neighbours.iter().enumerate().map(of_point).collect()
    };
    let distances: Vec<Vec<Option<f64>>> = pictures.par_iter().map(from_neighbours).collect();
    let usual: Vec<Option<f64>> = (0..points.len())
        .map(|point| {
            let seen: Vec<f64> = distances.iter().filter_map(|picture| picture[point]).collect();
            (seen.len() >= FEWEST).then(|| median(seen) + USUAL * noise)
        })
        .collect();
    let share = |picture: &[Option<f64>]| {
        let ratios: Vec<f64> = picture
            .iter()
            .zip(&usual)
            .filter_map(|(distance, usual)| Some((*distance)? / (*usual)?))
            .collect();
        ratios.iter().filter(|ratio| **ratio > FAR).count() as f64 / ratios.len().max(1) as f64
    };
    (0..pictures.len()).filter(|picture| share(&distances[*picture]) > UNLIKE).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pictures_with_other_levels_at_some_points_are_unlike_and_those_with_shadows_are_not() {
        // A face of 20 x 20 points in 20 pictures, with noise. Points at the edge are not always to be seen.
        let points: Vec<Vec3> =
            (0..400).map(|at| Vec3::new((at % 20) as f32, (at / 20) as f32, 0.0)).collect();
        let picture = |picture: usize| -> Differences {
            let level = |at: usize| {
                let noise = 0.04 * (((at * 7919 + picture * 104_729) % 101) as f64 / 101.0 - 0.5);
                let (x, y) = (at % 20, at / 20);
                let fingers = picture == 7 && (4..14).contains(&y) && x % 4 == 1;
                let touch = picture == 11 && y < 3 && x % 4 == 1;
                let shadow = if picture == 15 { 0.5 * x as f64 / 20.0 } else { 0.0 };
                noise + shadow + if fingers || touch { 0.7 } else { 0.0 }
            };
            (0..400).map(|at| (at % 9 != picture % 9).then(|| [level(at); 3])).collect()
        };
        let pictures: Vec<Differences> = (0..20).map(picture).collect();
        assert_eq!(unlike(&points, 4.0, 0.02, &pictures), [7]);
        assert!(unlike(&points, 4.0, 0.02, &[]).is_empty());
    }
}
