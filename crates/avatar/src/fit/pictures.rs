//! Alignment of pictures with each other: photometric bundle adjustment over points of face and neck.
//!
//! A point has one colour. In a picture it is changed by the light, which depends on the point's normal, and by the
//! exposure. In each channel, `ln level = colour + light(normal) + exposure`, where the light is a spherical harmonic function up to
//! the second order (Ramamoorthi and Hanrahan 2001). The parameters of the head move until all pictures agree, coarse to fine. This is
//! the photometric energy of VHAP (`vhap/model/tracker.py`) with points in place of a rendered texture, and solved together with the
//! landmarks. The colours follow the identity (variable projection, Golub and Pereyra 1973): otherwise, fixed colours would hold the identity where it is.

use std::cell::OnceCell;
use std::collections::HashSet;

use glam::{DVec2, DVec3, Vec3};
use rayon::prelude::*;
use serde::Serialize;
use srflow_core::resize::shrink_area;
use srflow_core::{Image, Plane, Size, median};
use srflow_files::FileError;
use srflow_head::{HeadModel, HeadPoints, JointRole, Region, ShapedHead, vertex_normals};
use srflow_splat::Camera;

use super::LandmarkView;
use super::look::{Look, Observation, harmonics};
use super::problem::{EYE_CORNERS, Heads, Problem, Projection, Search, Terms, Window};
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

/// How often colours and light are found anew at each level. The identity needs many rounds: colours hold it back.
const ROUNDS: [usize; LEVELS.len()] = [4, 16, 10];

/// Rows of the linearised pictures that are in memory at once.
const MOST_ROWS: usize = 4096;

/// So many parts of the timesteps are summed up in parallel.
const PARTS: usize = 16;

/// The search for parameters between two rounds. Robust loss and noisy slopes make the steps of the normal equations too short.
const SEARCH: Search = Search { steps: 2, least_gain: 1e-3, stride: 2.0 };

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

/// Logarithms of the levels around a face.
pub(super) struct Patch {
    pub camera: Camera,
    pub channels: [Plane; 3],
    /// Pixels between the outer corners of the eyes.
    pub corners: f64,
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
    /// Distance between the pupils by the landmarks, metres, if each timestep has one view: such pictures do not show the size of the head.
    pub eye_distance: Option<f64>,
    /// Of each view of each timestep, at the finest level; `None` where nothing of it is in the picture.
    finest: Vec<Vec<Option<Patch>>>,
    /// Pixels between the outer corners of the eyes, at most.
    level: f64,
    /// Those of this level.
    patches: Vec<Vec<Option<Patch>>>,
    expected: Vec<Vec<Expected>>,
    following: Option<Following>,
    /// Standard deviation of the levels from what is expected: on the face, and on the neck, where hair and clothes may be.
    pub noise: [f64; 2],
}

/// How the colours change with the identity.
struct Following {
    /// The identity for which the colours were found.
    identity: Vec<f64>,
    /// Of each point, channel and identity weight.
    slopes: Vec<f64>,
}

/// The levels where a point is in a picture, and how they change.
struct Sampled<'a> {
    levels: [f64; 3],
    /// With its position in the world.
    slopes: [DVec3; 3],
    /// How each parameter moves it.
    moves: &'a [DVec3],
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
        let one_view_each = problem.views.iter().all(|views| views.len() <= 1);
        Ok(Self {
            vertices,
            of_face,
            points,
            eye_distance: one_view_each.then(|| problem.eye_distance(heads.state(0))),
            finest,
            level: 0.0,
            patches: Vec::new(),
            expected: Vec::new(),
            following: None,
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
        self.following = None;
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

    /// Adds the pictures of a timestep to its terms. With an identity that moves, [`Self::follow_identity`] comes first.
    pub fn add(&self, problem: &Problem, heads: &Heads, timestep: usize, window: &Window, terms: &mut Terms) {
        let identities = if window.identity { problem.identities } else { 0 };
        let columns: Vec<usize> = (0..identities).chain(problem.own_columns()).collect();
        let n = columns.len();
        let limit = problem.options.outlier * problem.options.outlier;
        let then = self.following.iter().flat_map(|following| &following.identity);
        let now = &heads.state(timestep).identity[..identities];
        let moved: Vec<f64> = now.iter().zip(then).map(|(now, then)| now - then).collect();
        let (mut gradient, mut hessian) = (vec![0.0; n], vec![0.0; n * n]);
        let mut rows: Vec<f64> = Vec::new();
        self.for_each_point(heads, timestep, |point, expected, seen| {
            let Some(Sampled { levels, slopes, moves }) = seen else {
                terms.cost += INDEPENDENT * limit;
                return;
            };
            let residuals: [f64; 3] = std::array::from_fn(|channel| {
                let changes = self.color_slopes(point, channel, identities).iter().zip(&moved);
                let color = changes.map(|(slope, moved)| slope * moved).sum::<f64>();
                levels[channel] - expected[channel] - color
            });
            let precision = self.noise_of(point).powi(-2);
            let square = residuals.iter().map(|residual| residual * residual).sum::<f64>() * precision;
            let (cost, weight) = geman_mcclure(square, limit);
            terms.cost += INDEPENDENT * cost;
            let weight = (INDEPENDENT * weight * precision).sqrt();
            for (channel, (residual, slope)) in residuals.iter().zip(slopes).enumerate() {
                let start = rows.len();
                rows.extend(columns.iter().map(|column| weight * moves[*column].dot(slope)));
                let row = &mut rows[start..];
                let of_color = self.color_slopes(point, channel, identities);
                row.iter_mut().zip(of_color).for_each(|(value, slope)| *value -= weight * slope);
                gradient.iter_mut().zip(row).for_each(|(sum, value)| *sum += weight * residual * *value);
            }
            if rows.len() >= MOST_ROWS * n {
                add_squares(&mut hessian, &rows, n);
                rows.clear();
            }
        });
        add_squares(&mut hessian, &rows, n);
        let total = problem.shared() + problem.own();
        let place = |i: usize| if i < identities { i } else { problem.shared() + i - identities };
        for i in 0..n {
            terms.gradient[place(i)] += gradient[i];
            let row = &mut terms.hessian[place(i) * total..];
            (0..=i).for_each(|j| row[place(j)] += hessian[i * n + j]);
        }
    }

    /// How the colour of a point changes with each of the identity weights, in a channel.
    fn color_slopes(&self, point: usize, channel: usize, identities: usize) -> &[f64] {
        let Some(following) = &self.following else { return &[] };
        &following.slopes[(3 * point + channel) * identities..][..identities]
    }

    /// Finds how the colours follow the identity: a colour is the mean of what the pictures show.
    pub fn follow_identity(&mut self, problem: &Problem, heads: &Heads) {
        let identities = problem.identities;
        let mut views = vec![0; self.points.len()];
        for expected in self.expected.iter().flatten() {
            views
                .iter_mut()
                .zip(expected)
                .for_each(|(count, expected)| *count += usize::from(expected.is_some()));
        }
        let add = |mut sums: Vec<f64>, timestep: usize| {
            self.for_each_point(heads, timestep, |point, _, seen| {
                let Some(Sampled { slopes, moves, .. }) = seen else { return };
                for (channel, slope) in slopes.into_iter().enumerate() {
                    let sums = &mut sums[(3 * point + channel) * identities..][..identities];
                    let slope = slope / views[point] as f64;
                    sums.iter_mut().zip(moves).for_each(|(sum, moves)| *sum += moves.dot(slope));
                }
            });
            sums
        };
        // Sums do not depend on the number of threads.
        let timesteps: Vec<usize> = (0..self.patches.len()).collect();
        let zero = || vec![0.0; 3 * self.points.len() * identities];
        let parts = timesteps
            .par_chunks(timesteps.len().div_ceil(PARTS).max(1))
            .map(|part| part.iter().copied().fold(zero(), add));
        let slopes = parts.collect::<Vec<_>>().into_iter().fold(zero(), |mut sum, part| {
            sum.iter_mut().zip(part).for_each(|(sum, part)| *sum += part);
            sum
        });
        let identity = heads.states.first().map_or_else(Vec::new, |state| state.identity.clone());
        self.following = Some(Following { identity, slopes });
    }

    /// Whether they say anything about the head.
    fn show_anything(&self) -> bool {
        self.expected.iter().flatten().flatten().any(Option::is_some)
    }

    /// Calls `act` with each point that a picture of a timestep shows, what is expected of it, and how it is seen; `None` outside of
    /// the picture.
    fn for_each_point(
        &self,
        heads: &Heads,
        timestep: usize,
        mut act: impl FnMut(usize, [f64; 3], Option<Sampled>),
    ) {
        let Some(expected) = self.expected.get(timestep) else { return };
        let linearised = self.points.linearised(heads.state(timestep));
        for point in 0..self.points.len() {
            // All views of a point share its derivatives in the world.
            let moving = OnceCell::new();
            for (patch, expected) in self.patches[timestep].iter().zip(expected) {
                let (Some(patch), Some(expected)) = (patch, expected[point]) else { continue };
                let (position, moves) = moving.get_or_init(|| linearised.point(point));
                let seen = Projection::of(&patch.camera, *position).and_then(|at| {
                    let (levels, slopes) = patch.sample(at.pixel)?;
                    let slopes = slopes.map(|slope| at.across * slope.x + at.down * slope.y);
                    Some(Sampled { levels, slopes, moves })
                });
                act(point, expected, seen);
            }
        }
    }
}

/// Adds the squares of rows of `n` numbers to the lower triangle of their sum.
fn add_squares(sum: &mut [f64], rows: &[f64], n: usize) {
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
        let rounds = (0..LEVELS.len()).flat_map(|level| vec![level; ROUNDS[level]]);
        let count = ROUNDS.iter().sum();
        for (done, level) in rounds.enumerate() {
            progress(done, count);
            pictures.look(self, heads, LEVELS[level]);
            // The coarsest level is for the pose.
            let with_identity = level > 0 && pictures.show_anything();
            let window = if with_identity { window.clone().with_identity() } else { window.clone() };
            if with_identity {
                pictures.follow_identity(self, heads);
            }
            self.optimise(heads, &window, noise, Some(&pictures), &SEARCH);
        }
        pictures.look(self, heads, finest);
        self.close_lids(heads, &pictures);
        let gazes = self.turn_eyes(heads, &pictures);
        let [noise, _] = pictures.noise;
        Ok(PictureFit { points: pictures.points.len(), noise_before: before, noise, gazes, hidden })
    }
}
