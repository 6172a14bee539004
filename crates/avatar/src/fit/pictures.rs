//! Alignment of pictures with each other: photometric bundle adjustment over points of face and neck.
//!
//! A point has one colour. In a picture it is changed by the light, which depends on the point's normal, and by the
//! exposure. In each channel, `ln level = colour + light(normal) + exposure`, where the light is a spherical harmonic function up to
//! the second order (Ramamoorthi and Hanrahan 2001). The parameters of the head move until all pictures agree, coarse to fine. This is
//! the photometric energy of VHAP (`vhap/model/tracker.py`) with points in place of a rendered texture, and solved together with the
//! landmarks. The identity stays that of the landmarks: folds and shadows, which are no colours of points, would change it.

use std::cell::OnceCell;
use std::collections::HashSet;

use glam::{DVec2, DVec3, Vec3};
use rayon::prelude::*;
use serde::Serialize;
use srflow_core::dense::{inverse, product};
use srflow_core::resize::shrink_area;
use srflow_core::{Image, Plane, Size, median};
use srflow_files::FileError;
use srflow_head::{HeadModel, HeadPoints, JointRole, Region, ShapedHead, vertex_normals};
use srflow_splat::Camera;

use super::LandmarkView;
use super::problem::{EYE_CORNERS, Heads, Problem, Projection, Terms, Window};
use super::robust::geman_mcclure;
use crate::surface::Depths;

/// Reads the picture of a view.
pub type ReadPicture<'a> = &'a (dyn Fn(&LandmarkView) -> Result<Image, FileError> + Sync);

/// How well the pictures agree with each other.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct PictureFit {
    /// Points of face and neck.
    pub points: usize,
    /// Standard deviation of the levels of the face's points from what is expected, as a share of the level, with the fit to the
    /// landmarks alone.
    pub noise_before: f64,
    /// The same after alignment.
    pub noise: f64,
    /// Timesteps in which the irises were found. In the others, the eyes turn as in their neighbours.
    pub gazes: usize,
    /// Pictures in which something hides the face, and which take no part; `None` if the colours of the face change too much to tell.
    pub hidden: Option<Vec<HiddenView>>,
}

/// A picture in which something hides the face.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
pub struct HiddenView {
    pub timestep: u32,
    pub camera_index: u32,
}

/// Pixels between the outer corners of the eyes at each level.
const LEVELS: [f64; 3] = [16.0, 32.0, 64.0];

/// How often colours and light are found anew at each level.
const ROUNDS: usize = 4;

/// A step of less gain ends the search for parameters between two rounds.
const ENOUGH: f64 = 1e-3;

/// Distance between points, in distances between the outer corners of the eyes.
const SPACING: f64 = 1.0 / 24.0;

/// Residuals of neighbouring points and of channels are alike: all of them tell as much as this share of independent ones.
const INDEPENDENT: f64 = 0.1;

/// Added to levels before the logarithm: dark ones are mostly noise.
const DARK: f64 = 8.0;

/// Points that face away from the camera are not looked at: the least cosine.
const FACING: f64 = 0.3;

/// A point this far behind the visible surface is hidden, in distances between the outer corners of the eyes.
const HIDDEN: f64 = 0.03;

/// Pictures in which a point must be visible.
const FEWEST_VIEWS: usize = 3;

/// For three normally distributed channels, the median distance in standard deviations.
const MEDIAN_DISTANCE: f64 = 1.538_17;

/// The noise is not estimated below this.
const LEAST_NOISE: f64 = 0.005;

/// Harmonics of the light but for the constant one, which is part of the colours.
const HARMONICS: usize = 8;

/// Adds to the precision of the light, per observation: a head that keeps its pose does not show the light.
const LIGHT_PRECISION: f64 = 1e-3;

/// Logarithms of the levels around a face.
pub(super) struct Patch {
    pub camera: Camera,
    pub channels: [Plane; 3],
    /// Pixels between the outer corners of the eyes.
    corners: f64,
}

/// What is to be seen of each point in one picture; `None` where it is hidden.
type Expected = Vec<Option<[f64; 3]>>;

/// How a point looks in a picture.
pub(super) struct Difference {
    /// Logarithms of the levels less what was to be seen.
    pub levels: [f64; 3],
    /// How fast the levels change there, per distance between the outer corners of the eyes.
    pub slope: f64,
}

pub(super) struct Pictures {
    /// Vertices of the model: those of the face, then those of the neck.
    pub vertices: Vec<u32>,
    /// How many of them are of the face.
    pub of_face: usize,
    points: HeadPoints,
    /// Of each view of each timestep, at the finest level; `None` where nothing of it is in the picture.
    finest: Vec<Vec<Option<Patch>>>,
    /// Pixels between the outer corners of the eyes, at most.
    level: f64,
    /// Those of this level.
    patches: Vec<Vec<Option<Patch>>>,
    expected: Vec<Vec<Expected>>,
    /// Standard deviation of the levels from what is expected: on the face, and on the neck, where hair and clothes may be.
    pub noise: [f64; 2],
}

/// A point in a picture.
struct Observation {
    timestep: usize,
    view: usize,
    /// Number of the picture.
    picture: usize,
    point: usize,
    levels: [f64; 3],
    harmonics: [f64; HARMONICS],
    weight: f64,
}

impl Patch {
    fn of(image: &Image, camera: &Camera, positions: &[DVec3], corners: f64) -> Option<Self> {
        let seen: Vec<DVec2> = positions.iter().filter_map(|p| Some(camera.project(*p)?.0)).collect();
        let low = seen.iter().copied().reduce(DVec2::min)? - corners / 4.0;
        let high = seen.iter().copied().reduce(DVec2::max)? + corners / 4.0;
        let inside = |at: f64, side: usize| at.round().clamp(0.0, side as f64) as usize;
        let (left, right) = (inside(low.x, camera.width), inside(high.x, camera.width));
        let (top, bottom) = (inside(low.y, camera.height), inside(high.y, camera.height));
        let size = Size::new(right.saturating_sub(left), bottom.saturating_sub(top));
        if size.width < 8 || size.height < 8 {
            return None;
        }
        let logarithms: Vec<f32> = (0..256).map(|level| libm::log(f64::from(level) + DARK) as f32).collect();
        let channel = |channel: usize| {
            let level = |x, y| image.get(left + x, top + y)[channel];
            Plane::from_fn(size.width, size.height, |x, y| logarithms[usize::from(level(x, y))])
        };
        let cropped = Camera {
            width: size.width,
            height: size.height,
            cx: camera.cx - left as f64,
            cy: camera.cy - top as f64,
            ..*camera
        };
        let [.., finest] = LEVELS;
        Some(Self { camera: cropped, channels: [0, 1, 2].map(channel), corners }.shrunk(finest))
    }

    /// With so many pixels between the corners of the eyes, or all of them.
    fn shrunk(&self, corners: f64) -> Self {
        let factor = (corners / self.corners).min(1.0);
        let side = |side: usize| ((side as f64 * factor).round() as usize).max(1);
        let size = Size::new(side(self.camera.width), side(self.camera.height));
        let channels = self.channels.each_ref().map(|channel| shrink_area(channel, size, 1.0));
        Self { camera: self.camera.resized(size), channels, corners: self.corners * factor }
    }

    /// The levels at a pixel, and how they change to the right and downwards; `None` outside.
    fn sample(&self, at: DVec2) -> Option<([f64; 3], [DVec2; 3])> {
        let (x, y) = (at.x.floor(), at.y.floor());
        let inside = |at: f64, side: usize| at >= 0.0 && at + 1.0 < side as f64;
        if !inside(x, self.camera.width) || !inside(y, self.camera.height) {
            return None;
        }
        let (right, down) = (at.x - x, at.y - y);
        let (x, y) = (x as usize, y as usize);
        let sampled = self.channels.each_ref().map(|channel| {
            let [a, b] = [0, 1].map(|dx| f64::from(channel.get(x + dx, y)));
            let [c, d] = [0, 1].map(|dx| f64::from(channel.get(x + dx, y + 1)));
            let (above, below) = (a + (b - a) * right, c + (d - c) * right);
            let slope = DVec2::new((b - a) * (1.0 - down) + (d - c) * down, below - above);
            (above + (below - above) * down, slope)
        });
        Some((sampled.map(|(level, _)| level), sampled.map(|(_, slope)| slope)))
    }
}

impl Pictures {
    /// Reads the pictures around the heads.
    ///
    /// # Errors
    /// When a picture cannot be read.
    pub fn read(problem: &Problem, heads: &Heads, read: ReadPicture) -> Result<Self, FileError> {
        let spacing = SPACING * problem.corners.mean.length();
        let mut vertices = face_points(problem.model, spacing);
        let of_face = vertices.len();
        vertices.extend(neck_points(problem.model, spacing));
        let points = HeadPoints::vertices(problem.model, vertices.iter().copied());
        let patches = |(timestep, views): (usize, &Vec<&LandmarkView>)| {
            let positions = points.positions(heads.state(timestep));
            let corners = problem.corner_pixels(heads.state(timestep), views);
            let of_view = |(view, corners): (&&LandmarkView, Option<f64>)| match corners {
                Some(corners) if corners >= LEVELS[0] / 2.0 => {
                    Ok(Patch::of(&read(view)?, &view.camera, &positions, corners))
                }
                _ => Ok(None),
            };
            views.iter().zip(corners).map(of_view).collect::<Result<Vec<_>, FileError>>()
        };
        let finest = problem.views.par_iter().enumerate().map(patches).collect::<Result<Vec<_>, _>>()?;
        Ok(Self {
            vertices,
            of_face,
            points,
            finest,
            level: 0.0,
            patches: Vec::new(),
            expected: Vec::new(),
            noise: [LEAST_NOISE; 2],
        })
    }

    /// Standard deviation of the levels of a point.
    fn noise_of(&self, point: usize) -> f64 {
        self.noise[self.part(point)]
    }

    /// 0 for a point of the face, 1 for one of the neck.
    fn part(&self, point: usize) -> usize {
        usize::from(point >= self.of_face)
    }

    /// Those of a timestep, at the finest level.
    pub fn of_timestep(&self, timestep: usize) -> impl Iterator<Item = &Patch> {
        self.finest[timestep].iter().flatten()
    }

    fn set_level(&mut self, corners: f64) {
        if self.level == corners {
            return;
        }
        self.level = corners;
        let of_view = |patch: &Option<Patch>| patch.as_ref().map(|patch| patch.shrunk(corners));
        self.patches = self.finest.par_iter().map(|views| views.iter().map(of_view).collect()).collect();
    }

    /// Finds colours, light and exposures, and with them what is to be seen in each picture, with so many pixels between the corners of
    /// the eyes.
    pub fn look(&mut self, problem: &Problem, heads: &Heads, corners: f64) {
        self.set_level(corners);
        let mut picture = 0;
        let mut numbers = Vec::new();
        for views in &self.patches {
            numbers.push(picture);
            picture += views.len();
        }
        let shaped = problem.shaped(heads);
        let observed: Vec<Vec<Observation>> = (0..self.patches.len())
            .into_par_iter()
            .map(|timestep| self.observe(problem, heads, &shaped, timestep, numbers[timestep]))
            .collect();
        let mut observations: Vec<Observation> = observed.into_iter().flatten().collect();
        let mut views = vec![0; self.points.len()];
        observations.iter().for_each(|seen| views[seen.point] += 1);
        observations.retain(|seen| views[seen.point] >= FEWEST_VIEWS);

        let limit = problem.options.outlier.powi(2);
        let mut look = Look::new(self.points.len(), picture);
        for _ in 0..4 {
            look.fit(&observations);
            let distances: Vec<f64> = observations.iter().map(|seen| look.distance(seen)).collect();
            let noise = [0, 1].map(|part| {
                let pairs = observations.iter().zip(&distances);
                let inside = pairs.filter(|(seen, _)| self.part(seen.point) == part);
                let inside: Vec<f64> = inside.map(|(_, distance)| *distance).collect();
                if inside.is_empty() { LEAST_NOISE } else { median(inside) / MEDIAN_DISTANCE }
            });
            let of_face = noise[0].max(LEAST_NOISE);
            // Black clothes have no noise, but say nothing about the light.
            self.noise = [of_face, noise[1].max(of_face)];
            for (seen, distance) in observations.iter_mut().zip(distances) {
                let noise = self.noise_of(seen.point);
                let (_, weight) = geman_mcclure((distance / noise).powi(2), limit);
                seen.weight = (of_face / noise).powi(2) * weight;
            }
        }
        let unseen = vec![None; self.points.len()];
        self.expected = self.patches.iter().map(|views| vec![unseen.clone(); views.len()]).collect();
        for seen in &observations {
            self.expected[seen.timestep][seen.view][seen.point] = Some(look.levels(seen));
        }
    }

    /// The visible points in the pictures of a timestep. `first` is the number of the first picture.
    fn observe(
        &self,
        problem: &Problem,
        heads: &Heads,
        shaped: &ShapedHead,
        timestep: usize,
        first: usize,
    ) -> Vec<Observation> {
        let (model, state) = (problem.model, heads.state(timestep));
        let mut posed = Vec::new();
        model.vertices(shaped, &state.pose(), &mut posed);
        let (surface, triangles) = model.surface(&posed);
        let normals = vertex_normals(surface, triangles);
        let hidden = HIDDEN * problem.size(state).0;
        let mut observations = Vec::new();
        for (view, patch) in self.patches[timestep].iter().enumerate() {
            let Some(patch) = patch else { continue };
            let depths = Depths::of(surface, triangles, &patch.camera);
            let eye = patch.camera.position();
            for (point, &vertex) in self.vertices.iter().enumerate() {
                let position = surface[vertex as usize].as_dvec3();
                let normal = normals[vertex as usize].as_dvec3().normalize_or_zero();
                if normal.dot((eye - position).normalize_or_zero()) < FACING {
                    continue;
                }
                let Some((pixel, depth)) = patch.camera.project(position) else { continue };
                let Some((levels, _)) = patch.sample(pixel) else { continue };
                if depths.hides(pixel, depth - hidden) {
                    continue;
                }
                let (picture, harmonics) = (first + view, harmonics(normal));
                observations.push(Observation {
                    timestep,
                    view,
                    picture,
                    point,
                    levels,
                    harmonics,
                    weight: 1.0,
                });
            }
        }
        observations
    }

    /// How the face's points look, of each timestep and view with a picture; `None` for points that are not to be seen.
    pub fn differences(&self, heads: &Heads) -> Vec<([usize; 2], Vec<Option<Difference>>)> {
        let of_timestep = |(timestep, views): (usize, &Vec<Expected>)| {
            let positions = self.points.positions(heads.state(timestep));
            let of_face = &positions[..self.of_face];
            let of_view = |(view, expected): (usize, &Expected)| {
                let patch = self.patches[timestep][view].as_ref()?;
                let of_point = |(position, expected): (&DVec3, &Option<[f64; 3]>)| {
                    let (levels, slopes) = patch.sample(patch.camera.project(*position)?.0)?;
                    let expected = (*expected)?;
                    let slope = slopes.iter().map(|slope| slope.length_squared()).sum::<f64>().sqrt();
                    Some(Difference {
                        levels: std::array::from_fn(|channel| levels[channel] - expected[channel]),
                        slope: slope * patch.corners,
                    })
                };
                Some(([timestep, view], of_face.iter().zip(expected).map(of_point).collect()))
            };
            views.iter().enumerate().filter_map(of_view).collect::<Vec<_>>()
        };
        self.expected.par_iter().enumerate().flat_map_iter(of_timestep).collect()
    }

    /// Takes a picture out.
    pub fn remove(&mut self, timestep: usize, view: usize) {
        self.finest[timestep][view] = None;
        self.patches[timestep][view] = None;
    }

    /// Adds the pictures of a timestep to the terms of its own parameters.
    pub fn add(&self, problem: &Problem, heads: &Heads, timestep: usize, terms: &mut Terms) {
        let Some(expected) = self.expected.get(timestep) else { return };
        let state = heads.state(timestep);
        let linearised = self.points.linearised(state);
        let columns = problem.own_columns();
        let n = columns.len();
        let limit = problem.options.outlier * problem.options.outlier;
        let mut gradient = vec![0.0; n];
        let mut rows: Vec<f64> = Vec::new();
        for point in 0..self.points.len() {
            // All views of a point share its derivatives in the world.
            let moving = OnceCell::new();
            for (patch, expected) in self.patches[timestep].iter().zip(expected) {
                let (Some(patch), Some(expected)) = (patch, expected[point]) else { continue };
                let (position, values) = moving.get_or_init(|| linearised.point(point));
                let projection = Projection::of(&patch.camera, *position);
                let sampled = projection.as_ref().and_then(|at| Some((at, patch.sample(at.pixel)?)));
                let Some((projection, (levels, slopes))) = sampled else {
                    terms.cost += INDEPENDENT * limit;
                    continue;
                };
                let residuals: [f64; 3] = std::array::from_fn(|channel| levels[channel] - expected[channel]);
                let precision = self.noise_of(point).powi(-2);
                let square = residuals.iter().map(|residual| residual * residual).sum::<f64>() * precision;
                let (cost, weight) = geman_mcclure(square, limit);
                terms.cost += INDEPENDENT * cost;
                let weight = INDEPENDENT * weight * precision;
                let (mut pull, mut information) = (DVec2::ZERO, [0.0; 3]);
                for (residual, slope) in residuals.iter().zip(slopes) {
                    pull += slope * (weight * residual);
                    information[0] += weight * slope.x * slope.x;
                    information[1] += weight * slope.x * slope.y;
                    information[2] += weight * slope.y * slope.y;
                }
                // Rows of L^T J with information L L^T.
                let across = information[0].sqrt();
                if across == 0.0 {
                    continue;
                }
                let both = information[1] / across;
                let down = (information[2] - both * both).max(0.0).sqrt();
                let start = rows.len();
                rows.resize(start + 2 * n, 0.0);
                let (first, second) = rows[start..].split_at_mut(n);
                for (i, column) in columns.iter().enumerate() {
                    let moves = DVec2::new(
                        values[*column].dot(projection.across),
                        values[*column].dot(projection.down),
                    );
                    gradient[i] += moves.dot(pull);
                    first[i] = across * moves.x + both * moves.y;
                    second[i] = down * moves.y;
                }
            }
        }
        let hessian = squares(&rows, n);
        let (shared, total) = (problem.shared(), problem.shared() + n);
        for i in 0..n {
            terms.gradient[shared + i] += gradient[i];
            let row = (shared + i) * total + shared;
            let sums = terms.hessian[row..=row + i].iter_mut();
            sums.zip(&hessian[i * n..]).for_each(|(sum, value)| *sum += value);
        }
    }
}

/// The lower triangle of the sum of squares of rows of `n` numbers.
fn squares(rows: &[f64], n: usize) -> Vec<f64> {
    let mut sum = vec![0.0; n * n];
    // Eight rows at a time: the sums are read and written less often.
    for rows in rows.chunks(8 * n) {
        for i in 0..n {
            let of_row = &mut sum[i * n..=i * n + i];
            for row in rows.chunks_exact(n) {
                let weight = row[i];
                of_row.iter_mut().zip(row).for_each(|(sum, value)| *sum += weight * value);
            }
        }
    }
    sum
}

/// Colours of points, the light, and exposures of pictures, in logarithms of levels.
struct Look {
    colors: Vec<[f64; 3]>,
    light: [[f64; HARMONICS]; 3],
    exposures: Vec<[f64; 3]>,
}

impl Look {
    fn new(points: usize, pictures: usize) -> Self {
        Self {
            colors: vec![[0.0; 3]; points],
            light: [[0.0; HARMONICS]; 3],
            exposures: vec![[0.0; 3]; pictures],
        }
    }

    /// What is to be seen.
    fn levels(&self, seen: &Observation) -> [f64; 3] {
        std::array::from_fn(|channel| {
            self.colors[seen.point][channel] + self.lit(seen, channel) + self.exposures[seen.picture][channel]
        })
    }

    fn lit(&self, seen: &Observation, channel: usize) -> f64 {
        self.light[channel].iter().zip(seen.harmonics).map(|(a, b)| a * b).sum()
    }

    fn distance(&self, seen: &Observation) -> f64 {
        let apart = self.levels(seen).into_iter().zip(seen.levels).map(|(a, b)| (a - b) * (a - b));
        apart.sum::<f64>().sqrt()
    }

    /// Least squares by turns: light and colours, then exposures.
    fn fit(&mut self, observations: &[Observation]) {
        let points = self.colors.len();
        let means = Means::of(observations, points, |seen| seen.point);
        // The light is that of how a point changes: colours take up the rest.
        let rest = means.mean(observations, |seen| seen.harmonics);
        let apart = |seen: &Observation| -> [f64; HARMONICS] {
            std::array::from_fn(|k| seen.harmonics[k] - rest[seen.point][k])
        };
        let mut matrix = vec![0.0; HARMONICS * HARMONICS];
        let mut total = 0.0;
        for seen in observations {
            let apart = apart(seen);
            total += seen.weight;
            for i in 0..HARMONICS {
                for j in 0..HARMONICS {
                    matrix[i * HARMONICS + j] += seen.weight * apart[i] * apart[j];
                }
            }
        }
        for i in 0..HARMONICS {
            matrix[i * HARMONICS + i] += LIGHT_PRECISION * total.max(1.0);
        }
        let Some(inverse) = inverse(matrix, HARMONICS) else { return };
        let in_pictures = Means::of(observations, self.exposures.len(), |seen| seen.picture);
        for _ in 0..4 {
            let exposed: Vec<[f64; 3]> = observations
                .iter()
                .map(|seen| std::array::from_fn(|c| seen.levels[c] - self.exposures[seen.picture][c]))
                .collect();
            for channel in 0..3 {
                let mut right = vec![0.0; HARMONICS];
                for (seen, levels) in observations.iter().zip(&exposed) {
                    let apart = apart(seen);
                    right
                        .iter_mut()
                        .zip(apart)
                        .for_each(|(sum, k)| *sum += seen.weight * k * levels[channel]);
                }
                let light = product(&inverse, &right, HARMONICS, 1);
                self.light[channel].copy_from_slice(&light);
            }
            self.colors = means.mean(observations, |seen| {
                std::array::from_fn(|c| seen.levels[c] - self.exposures[seen.picture][c] - self.lit(seen, c))
            });
            self.exposures = in_pictures.mean(observations, |seen| {
                std::array::from_fn(|c| seen.levels[c] - self.colors[seen.point][c] - self.lit(seen, c))
            });
        }
    }
}

/// Weighted means over groups of observations.
struct Means<G> {
    group: G,
    weights: Vec<f64>,
}

impl<G: Fn(&Observation) -> usize> Means<G> {
    fn of(observations: &[Observation], groups: usize, group: G) -> Self {
        let mut weights = vec![0.0; groups];
        observations.iter().for_each(|seen| weights[group(seen)] += seen.weight);
        Self { group, weights }
    }

    /// Zero for groups without observations.
    fn mean<const N: usize>(
        &self,
        observations: &[Observation],
        value: impl Fn(&Observation) -> [f64; N],
    ) -> Vec<[f64; N]> {
        let mut sums = vec![[0.0; N]; self.weights.len()];
        for seen in observations {
            let sum = &mut sums[(self.group)(seen)];
            sum.iter_mut().zip(value(seen)).for_each(|(sum, value)| *sum += seen.weight * value);
        }
        for (sum, weight) in sums.iter_mut().zip(&self.weights) {
            sum.iter_mut().for_each(|sum| *sum /= weight.max(f64::MIN_POSITIVE));
        }
        sums
    }
}

/// Spherical harmonics of the first and second order, but for their factors.
fn harmonics(DVec3 { x, y, z }: DVec3) -> [f64; HARMONICS] {
    [x, y, z, x * y, y * z, x * z, x * x - y * y, z * z - 1.0 / 3.0]
}

/// Vertices of the face's skin, one in each cell of this side, metres.
pub(super) fn face_points(model: &HeadModel, spacing: f64) -> Vec<u32> {
    let landmarks: Vec<Vec3> = model.landmarks_on(&model.template).collect();
    // In front of the ears, and below the hair of most people.
    let behind = landmarks[0].z.min(landmarks[16].z);
    let brows = landmarks[19].y.max(landmarks[24].y);
    let top = brows + 0.6 * landmarks[EYE_CORNERS[0]].distance(landmarks[EYE_CORNERS[1]]);
    let facial = [Region::Skin, Region::Brow, Region::Lips, Region::LidMargin];
    vertices_of(model, &facial, spacing, |at| at.z >= behind && at.y <= top)
}

/// Vertices of neck and shoulders, one in each cell of this side, metres. None if the model has no joint of the neck: its neck moves
/// rigidly with the head.
pub(super) fn neck_points(model: &HeadModel, spacing: f64) -> Vec<u32> {
    if model.joint(JointRole::Neck).is_none() {
        return Vec::new();
    }
    vertices_of(model, &[Region::Neck], spacing, |_| true)
}

/// Vertices of regions where `inside` holds at rest, one in each cell of this side, metres.
fn vertices_of(
    model: &HeadModel,
    regions: &[Region],
    spacing: f64,
    inside: impl Fn(&Vec3) -> bool,
) -> Vec<u32> {
    let mut of_regions = vec![false; model.template.len()];
    // Carriers of an avatar's own Gaussians are no skin.
    let (_, surface) = model.surface(&model.template);
    for (triangle, _) in surface.iter().zip(&model.regions).filter(|(_, region)| regions.contains(region)) {
        triangle.iter().for_each(|vertex| of_regions[*vertex as usize] = true);
    }
    let mut taken = HashSet::new();
    let is_chosen = |(vertex, at): (usize, &Vec3)| {
        let is_first =
            of_regions[vertex] && inside(at) && taken.insert((*at / spacing as f32).floor().as_ivec3());
        is_first.then_some(vertex as u32)
    };
    model.template.iter().enumerate().filter_map(is_chosen).collect()
}

impl Problem<'_> {
    /// Aligns the pictures, and says how well they agree. `progress` gets how many steps of how many are done.
    ///
    /// # Errors
    /// When a picture cannot be read.
    pub fn align(
        &self,
        heads: &mut Heads,
        noise: f64,
        read: ReadPicture,
        mut progress: impl FnMut(usize, usize),
    ) -> Result<PictureFit, FileError> {
        let window = Window::all(heads.states.len());
        let noise = noise.max(self.usual_noise(heads, &window));
        let mut pictures = Pictures::read(self, heads, read)?;
        let [.., finest] = LEVELS;
        pictures.look(self, heads, finest);
        let [before, _] = pictures.noise;
        let hidden = pictures.leave_out_hidden(self, heads);
        let rounds = LEVELS.iter().flat_map(|level| [*level; ROUNDS]);
        for (done, level) in rounds.enumerate() {
            progress(done, LEVELS.len() * ROUNDS);
            pictures.look(self, heads, level);
            self.optimise(heads, &window, noise, Some(&pictures), ENOUGH);
        }
        pictures.look(self, heads, finest);
        let gazes = self.turn_eyes(heads, &pictures);
        let [noise, _] = pictures.noise;
        Ok(PictureFit { points: pictures.points.len(), noise_before: before, noise, gazes, hidden })
    }
}
