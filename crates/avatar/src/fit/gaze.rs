//! Where the eyes look: the disc of the iris is darker than the white of the eye around it. Landmarks of lids do not show it.

use glam::{DQuat, DVec3};
use rayon::prelude::*;
use srflow_head::{JointRole, ShapedHead};

use super::pictures::Pictures;
use super::problem::{Heads, Problem};
use crate::surface::opaque_triangles;
use crate::{Similarity, SurfacePoint, visible_surface};

/// Angle at the centre of the eye between the middle and the rim of the iris: a radius of 5.9 mm in eyeballs of 12 mm.
const IRIS: f64 = 0.513;

/// The rim is as soft as this, radians.
const RIM: f64 = 0.09;

/// How far the eyes turn from rest, radians: to a side, and up or down.
const FARTHEST: [f64; 2] = [0.65, 0.45];

/// Steps of the two searches, radians.
const STEPS: [f64; 2] = [0.05, 0.01];

/// Fewer pixels of both eyes do not show the iris: the lids are closed.
const FEWEST: usize = 12;

/// The iris is found if the picture correlates with it by more than this.
const FOUND: f64 = 0.35;

/// The iris contrasts most in red, where skin and blue eyes differ from the white too.
const CHANNEL: usize = 0;

/// An eyeball in a picture.
struct Eye {
    /// Directions from its centre to what is seen of it, at rest, and how dark that is.
    seen: Vec<(DVec3, f64)>,
}

impl Problem<'_> {
    /// Turns the eyes of each timestep to where their irises are in the pictures. Returns the number of timesteps in which they were
    /// found; the others follow from their neighbours.
    pub fn turn_eyes(&self, heads: &mut Heads, pictures: &Pictures) -> usize {
        let joints = [JointRole::LeftEye, JointRole::RightEye].map(|role| self.model.joint(role));
        let [Some(left), Some(right)] = joints else { return 0 };
        let eyes = [left, right];
        let shaped = self.shaped(heads);
        let gazes: Vec<Option<[f64; 2]>> = (0..heads.states.len())
            .into_par_iter()
            .map(|timestep| self.gaze(heads, pictures, &shaped, eyes, timestep))
            .collect();
        for (state, gaze) in heads.states.iter_mut().zip(filled(&gazes)) {
            let Some(gaze) = gaze else { continue };
            eyes.iter().for_each(|eye| *state.joint_mut(*eye) = turn(gaze));
        }
        gazes.iter().flatten().count()
    }

    /// The gaze at a timestep, radians: to the subject's left, and up.
    fn gaze(
        &self,
        heads: &Heads,
        pictures: &Pictures,
        shaped: &ShapedHead,
        eyes: [usize; 2],
        timestep: usize,
    ) -> Option<[f64; 2]> {
        let (model, state) = (self.model, heads.state(timestep));
        let mut posed = Vec::new();
        model.vertices(shaped, &state.pose(), &mut posed);
        let (surface, _) = model.surface(&posed);
        let triangles = opaque_triangles(model);
        let mut seen = Vec::new();
        for patch in pictures.of_timestep(timestep) {
            let points = visible_surface(surface, &triangles, &patch.camera);
            for (joint, eyeball) in eyes.into_iter().zip(&model.eyeballs) {
                let corners =
                    |vertex: &u32| [&shaped.vertices, &posed].map(|at| at[*vertex as usize].as_dvec3());
                let pairs: Vec<_> =
                    eyeball.iter().map(corners).map(|[rest, posed]| (rest, posed, 1.0)).collect();
                let world_from_rest = Similarity::rigid(&pairs)?;
                let centre = world_from_rest.apply(shaped.joints[joint].as_dvec3());
                let rest_from_world = state.joint(joint) * world_from_rest.rotation.inverse();
                let of_pixel = |(point, dark): (&Option<SurfacePoint>, &f32)| {
                    let point = (*point)?;
                    let corners = triangles[point.triangle];
                    if !belongs_to(eyeball, corners) {
                        return None;
                    }
                    let weighted = corners.iter().zip(point.weights.to_array());
                    let at: DVec3 =
                        weighted.map(|(corner, weight)| surface[*corner as usize].as_dvec3() * weight).sum();
                    Some((rest_from_world * (at - centre).normalize_or_zero(), -f64::from(*dark)))
                };
                let pixels = points.iter().zip(patch.channels[CHANNEL].pixels());
                seen.push(Eye { seen: pixels.filter_map(of_pixel).collect() });
            }
        }
        if seen.iter().map(|eye| eye.seen.len()).sum::<usize>() < FEWEST {
            return None;
        }
        let score = |gaze: [f64; 2]| -> f64 {
            let count = seen.iter().filter(|eye| !eye.seen.is_empty()).count() as f64;
            seen.iter().map(|eye| eye.correlation(turn(gaze) * DVec3::Z)).sum::<f64>() / count
        };
        let [coarse, fine] = STEPS;
        let best = highest([0.0; 2], FARTHEST, coarse, score).0;
        let (gaze, found) = highest(best, [coarse; 2], fine, score);
        (found > FOUND).then_some(gaze)
    }
}

impl Eye {
    /// Of its darkness with an iris in a direction; 0 where nothing of it is seen.
    fn correlation(&self, axis: DVec3) -> f64 {
        let count = self.seen.len() as f64;
        let iris = |direction: DVec3| {
            let inside = (IRIS - direction.angle_between(axis)) / RIM;
            (0.5 + 0.5 * inside).clamp(0.0, 1.0)
        };
        let (mut sums, mut squares, mut product) = ([0.0; 2], [0.0; 2], 0.0);
        for (direction, dark) in &self.seen {
            for (number, value) in [iris(*direction), *dark].into_iter().enumerate() {
                sums[number] += value;
                squares[number] += value * value;
            }
            product += iris(*direction) * dark;
        }
        let [iris, dark] = [0, 1].map(|number| squares[number] - sums[number] * sums[number] / count);
        let both = product - sums[0] * sums[1] / count;
        if iris * dark > 0.0 { both / (iris * dark).sqrt() } else { 0.0 }
    }
}

/// Whether a triangle belongs to an eyeball.
pub(super) fn belongs_to(eyeball: &[u32], corners: [u32; 3]) -> bool {
    corners.iter().all(|corner| eyeball.binary_search(corner).is_ok())
}

/// The eyes' rotation.
fn turn([left, up]: [f64; 2]) -> DQuat {
    DQuat::from_rotation_y(left) * DQuat::from_rotation_x(-up)
}

/// The best place of a grid around `middle`, and its score.
fn highest(middle: [f64; 2], reach: [f64; 2], step: f64, score: impl Fn([f64; 2]) -> f64) -> ([f64; 2], f64) {
    let count = |reach: f64| (reach / step).round() as i32;
    let mut best = (middle, f64::NEG_INFINITY);
    for left in -count(reach[0])..=count(reach[0]) {
        for up in -count(reach[1])..=count(reach[1]) {
            let at = [middle[0] + f64::from(left) * step, middle[1] + f64::from(up) * step];
            let score = score(at);
            if score > best.1 {
                best = (at, score);
            }
        }
    }
    best
}

/// Without gaps: linear between neighbours, and constant before the first and after the last one.
fn filled(gazes: &[Option<[f64; 2]>]) -> Vec<Option<[f64; 2]>> {
    let known: Vec<(usize, [f64; 2])> =
        gazes.iter().enumerate().filter_map(|(place, gaze)| Some((place, (*gaze)?))).collect();
    let at = |place: usize| {
        let after = known.partition_point(|(other, _)| *other < place);
        match (after.checked_sub(1).map(|before| known[before]), known.get(after)) {
            (Some((before, a)), Some((after, b))) => {
                let share = (place - before) as f64 / (after - before) as f64;
                Some([0, 1].map(|axis| a[axis] + (b[axis] - a[axis]) * share))
            }
            (only, other) => only.or(other.copied()).map(|(_, gaze)| gaze),
        }
    };
    (0..gazes.len()).map(at).collect()
}
