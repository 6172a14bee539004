//! The surface of the head at rest, on which Gaussians are placed.

use std::collections::HashMap;

use glam::{IVec3, Quat, Vec3};
use rayon::prelude::*;
use srflow_core::random::Stream;

use crate::{HeadModel, Region, ShapedHead, TriangleFrame, vertex_normals};

#[derive(Debug, Clone, Copy)]
pub(super) struct SurfacePoint {
    pub triangle: u32,
    /// Barycentric coordinates.
    pub weights: Vec3,
    pub position: Vec3,
    /// Unit length, interpolated between the vertices.
    pub normal: Vec3,
}

/// The shaped head at rest.
pub(super) struct Surface<'a> {
    pub model: &'a HeadModel,
    pub vertices: &'a [Vec3],
    /// Centres of the left and the right eyeball.
    pub eyes: [Vec3; 2],
    /// Vertex normals, unit length.
    pub normals: Vec<Vec3>,
    pub frames: Vec<TriangleFrame>,
    /// Distance of each triangle's farthest corner from its centroid, metres.
    pub radii: Vec<f32>,
    /// The 68 landmarks in dlib's order.
    pub landmarks: Vec<Vec3>,
    /// Size of the head: distance between the centres of the eyes divided by that of an average adult.
    pub size: f32,
}

/// Distance between the centres of an average adult's eyes, metres.
const AVERAGE_EYE_DISTANCE: f32 = 0.063;

impl<'a> Surface<'a> {
    pub fn new(model: &'a HeadModel, shaped: &'a ShapedHead) -> Self {
        let vertices = &shaped.vertices;
        let corners = |t: &[u32; 3]| t.map(|v| vertices[v as usize]);
        let frames: Vec<TriangleFrame> = model
            .triangles
            .iter()
            .map(|t| {
                let [a, b, c] = corners(t);
                TriangleFrame::of(a, b, c)
            })
            .collect();
        let radii = frames.iter().zip(&model.triangles).map(|(frame, t)| {
            let distances = corners(t).map(|corner| corner.distance(frame.origin));
            distances.into_iter().fold(0.0, f32::max)
        });
        let eyes = model.eye_centres(shaped).unwrap_or_default();
        Self {
            model,
            vertices,
            eyes,
            normals: unit_normals(vertices, model),
            radii: radii.collect(),
            frames,
            landmarks: model.landmarks_on(vertices).collect(),
            size: (eyes[0].distance(eyes[1]) / AVERAGE_EYE_DISTANCE).clamp(0.2, 5.0),
        }
    }

    pub fn corners(&self, triangle: u32) -> [Vec3; 3] {
        self.model.triangles[triangle as usize].map(|v| self.vertices[v as usize])
    }

    /// Indices of the triangles of these regions.
    pub fn triangles_of(&self, regions: &[Region]) -> Vec<u32> {
        let numbers = 0..self.model.triangles.len() as u32;
        numbers.filter(|&t| regions.contains(&self.model.regions[t as usize])).collect()
    }

    /// Whether each vertex is a corner of a triangle of these regions.
    pub fn corners_of(&self, regions: &[Region]) -> Vec<bool> {
        let mut inside = vec![false; self.vertices.len()];
        for t in self.triangles_of(regions) {
            self.model.triangles[t as usize].iter().for_each(|v| inside[*v as usize] = true);
        }
        inside
    }

    pub fn point(&self, triangle: u32, weights: Vec3) -> SurfacePoint {
        let [a, b, c] = self.corners(triangle);
        let normal = self.interpolate(&self.normals, triangle, weights).normalize_or(Vec3::Y);
        SurfacePoint { triangle, weights, position: a * weights.x + b * weights.y + c * weights.z, normal }
    }

    /// Interpolates a quantity given at the vertices.
    pub fn interpolate<T>(&self, values: &[T], triangle: u32, weights: Vec3) -> T
    where
        T: Copy + std::ops::Mul<f32, Output = T> + std::ops::Add<Output = T>,
    {
        let [a, b, c] = self.model.triangles[triangle as usize].map(|v| values[v as usize]);
        a * weights.x + b * weights.y + c * weights.z
    }

    /// As [`Self::interpolate`], at a [`SurfacePoint`].
    pub fn value<T>(&self, values: &[T], point: &SurfacePoint) -> T
    where
        T: Copy + std::ops::Mul<f32, Output = T> + std::ops::Add<Output = T>,
    {
        self.interpolate(values, point.triangle, point.weights)
    }

    /// Points scattered over `triangles` as a Poisson disc sample with variable `spacing` (metres), nearly maximal: darts are
    /// thrown uniformly over the area, and those too near to an earlier one are removed.
    pub fn scatter(
        &self,
        triangles: &[u32],
        spacing: impl Fn(&SurfacePoint) -> f32,
        stream: &mut Stream,
    ) -> Vec<SurfacePoint> {
        const DARTS_PER_POINT: f32 = 7.0;
        let centre = Vec3::splat(1.0 / 3.0);
        let mut darts = Vec::new();
        let (mut narrowest, mut widest) = (f32::MAX, 0.0_f32);
        for &t in triangles {
            let [a, b, c] = self.corners(t);
            let area = (b - a).cross(c - a).length() * 0.5;
            let distance = spacing(&self.point(t, centre));
            if distance <= 0.0 {
                continue;
            }
            (narrowest, widest) = (narrowest.min(distance), widest.max(distance));
            let expected = area / (distance * distance) * DARTS_PER_POINT;
            let count = (expected + stream.unit()).min(1e5) as u32;
            for _ in 0..count {
                let (mut u, mut v) = (stream.unit(), stream.unit());
                if u + v > 1.0 {
                    (u, v) = (1.0 - u, 1.0 - v);
                }
                darts.push((t, u, v));
            }
        }
        stream.shuffle(&mut darts);
        let mut crowd = Crowd::new(narrowest, widest);
        let points = darts.into_iter().map(|(t, u, v)| self.point(t, Vec3::new(1.0 - u - v, u, v)));
        points.filter(|point| crowd.admit(point.position, spacing(point))).collect()
    }

    /// Signed distance of each vertex to the border between `regions` and all others, metres, positive inside.
    pub fn signed_distance(&self, regions: &[Region], reach: f32) -> Vec<f32> {
        let mut inside = vec![0_u8; self.vertices.len()];
        for (triangle, region) in self.model.triangles.iter().zip(&self.model.regions) {
            let side = if regions.contains(region) { 1 } else { 2 };
            for v in triangle {
                inside[*v as usize] |= side;
            }
        }
        let mut border = Buckets::new(reach);
        for (v, side) in inside.iter().enumerate() {
            if *side == 3 {
                border.insert(self.vertices[v], v as u32);
            }
        }
        let mut distances: Vec<f32> = (0..self.vertices.len())
            .map(|v| {
                let p = self.vertices[v];
                let nearest =
                    border.near(p).map(|b| self.vertices[b as usize].distance(p)).fold(reach, f32::min);
                if inside[v] & 1 != 0 { nearest } else { -nearest }
            })
            .collect();
        for _ in 0..2 {
            self.smooth(&mut distances);
        }
        distances
    }

    /// Curvature of the surface at each vertex, 1/m: the largest change of the normal along an edge of the mesh.
    pub fn curvature(&self) -> Vec<f32> {
        let shortest = 1e-4 * self.size;
        let mut bends = vec![0.0_f32; self.vertices.len()];
        for triangle in &self.model.triangles {
            for i in 0..3 {
                let (a, b) = (triangle[i] as usize, triangle[(i + 1) % 3] as usize);
                let length = self.vertices[a].distance(self.vertices[b]).max(shortest);
                let bend = self.normals[a].distance(self.normals[b]) / length;
                (bends[a], bends[b]) = (bends[a].max(bend), bends[b].max(bend));
            }
        }
        self.smooth(&mut bends);
        bends
    }

    /// Distance of each vertex to the boundary of the mesh, metres, at most `reach`.
    pub fn rim_distance(&self, reach: f32) -> Vec<f32> {
        let mut edges: HashMap<[u32; 2], (u32, bool)> = HashMap::new();
        for (triangle, region) in self.model.triangles.iter().zip(&self.model.regions) {
            for i in 0..3 {
                let (a, b) = (triangle[i], triangle[(i + 1) % 3]);
                let edge = edges.entry([a.min(b), a.max(b)]).or_default();
                *edge = (edge.0 + 1, *region == Region::Neck);
            }
        }
        let mut is_rim = vec![false; self.vertices.len()];
        for (edge, _) in edges.iter().filter(|(_, (count, neck))| *count == 1 && *neck) {
            edge.iter().for_each(|v| is_rim[*v as usize] = true);
        }
        let mut rim = Buckets::new(reach);
        for (v, p) in self.vertices.iter().enumerate().filter(|(v, _)| is_rim[*v]) {
            rim.insert(*p, v as u32);
        }
        let nearest =
            |p: &Vec3| rim.near(*p).map(|v| self.vertices[v as usize].distance(*p)).fold(reach, f32::min);
        self.vertices.iter().map(nearest).collect()
    }

    /// Replaces each value by the mean of itself and its neighbours' mean.
    pub fn smooth<T>(&self, values: &mut [T])
    where
        T: Copy + Default + std::ops::Mul<f32, Output = T> + std::ops::Add<Output = T>,
    {
        let mut sums = vec![(T::default(), 0.0_f32); values.len()];
        for triangle in &self.model.triangles {
            for i in 0..3 {
                let (v, next) = (triangle[i] as usize, triangle[(i + 1) % 3] as usize);
                for (to, from) in [(v, next), (next, v)] {
                    sums[to] = (sums[to].0 + values[from], sums[to].1 + 1.0);
                }
            }
        }
        for (value, (sum, count)) in values.iter_mut().zip(sums) {
            if count > 0.0 {
                *value = *value * 0.5 + sum * (0.5 / count);
            }
        }
    }
}

/// A normal of each vertex of `model` where its vertices are these, of unit length.
pub(super) fn unit_normals(vertices: &[Vec3], model: &HeadModel) -> Vec<Vec3> {
    vertex_normals(vertices, &model.triangles)
        .into_par_iter()
        .with_min_len(4096)
        .map(|normal| normal.normalize_or(Vec3::Y))
        .collect()
}

/// The cell of side 1 that a point is in: its coordinates rounded down, faster than by `floor`, which is software.
pub(crate) fn cell_of(p: Vec3) -> IVec3 {
    let towards_zero = p.as_ivec3();
    towards_zero.saturating_sub(IVec3::from(p.cmplt(towards_zero.as_vec3())))
}

/// By cell.
type Cells<T> = HashMap<IVec3, T, std::hash::BuildHasherDefault<CellHasher>>;

/// Points by grid cell.
pub(super) struct Buckets {
    side: f32,
    cells: Cells<Vec<u32>>,
}

impl Buckets {
    pub fn new(side: f32) -> Self {
        Self { side, cells: Cells::default() }
    }

    pub fn insert(&mut self, p: Vec3, number: u32) {
        self.cells.entry(cell_of(p / self.side)).or_default().push(number);
    }

    /// Indices of the points in the cell of `p` and its neighbours, in a fixed order.
    pub fn near(&self, p: Vec3) -> impl Iterator<Item = u32> {
        let cell = cell_of(p / self.side);
        (0..27)
            .filter_map(move |i| self.cells.get(&(cell + IVec3::new(i % 3 - 1, i / 3 % 3 - 1, i / 9 - 1))))
            .flatten()
            .copied()
    }
}

/// Points with minimum distances. Distances vary several times between face and scalp, so there is one grid per octave: a
/// query visits at most 27 cells whatever the distance.
struct Crowd {
    narrowest: f32,
    /// Grids with cells as wide as the smallest distance, twice that, and so on.
    octaves: Vec<Grid>,
}

/// The points in each cell, as a list from the last that was added.
#[derive(Default)]
struct Grid {
    last: Cells<u32>,
    /// Each point and the number of the one before it in its cell; [`NONE`] for the first.
    points: Vec<(Vec3, u32)>,
}

const NONE: u32 = u32::MAX;

impl Crowd {
    fn new(narrowest: f32, widest: f32) -> Self {
        let mut crowd = Self { narrowest: narrowest.max(1e-5), octaves: Vec::new() };
        while crowd.octaves.is_empty()
            || crowd.side(crowd.octaves.len() - 1) <= widest && crowd.octaves.len() < 16
        {
            crowd.octaves.push(Grid::default());
        }
        crowd
    }

    /// Inserts the point unless another is nearer than `distance`.
    fn admit(&mut self, p: Vec3, distance: f32) -> bool {
        if distance <= 0.0 {
            return false;
        }
        let wider = |octave: &usize| self.side(*octave) > distance;
        let octave = (0..self.octaves.len()).find(wider).unwrap_or(self.octaves.len() - 1);
        let side = self.side(octave);
        let cell = |p: Vec3| cell_of(p / side);
        // Most points have a neighbour in their own cell.
        let own = cell(p);
        if self.has_near(octave, own, p, distance) {
            return false;
        }
        let (low, high) = (cell(p - distance), cell(p + distance));
        for x in low.x..=high.x {
            for y in low.y..=high.y {
                for z in low.z..=high.z {
                    let other = IVec3::new(x, y, z);
                    if other != own && self.has_near(octave, other, p, distance) {
                        return false;
                    }
                }
            }
        }
        for octave in 0..self.octaves.len() {
            let cell = cell_of(p / self.side(octave));
            let Grid { last, points } = &mut self.octaves[octave];
            let number = points.len() as u32;
            points.push((p, last.insert(cell, number).unwrap_or(NONE)));
        }
        true
    }

    /// Whether a point in this cell is nearer to `p` than `distance`.
    fn has_near(&self, octave: usize, cell: IVec3, p: Vec3, distance: f32) -> bool {
        let Grid { last, points } = &self.octaves[octave];
        let mut number = last.get(&cell).copied().unwrap_or(NONE);
        while let Some((q, before)) = points.get(number as usize) {
            if q.distance_squared(p) < distance * distance {
                return true;
            }
            number = *before;
        }
        false
    }

    fn side(&self, octave: usize) -> f32 {
        self.narrowest * (1 << octave) as f32
    }
}

/// Hashes the three integers of a cell; the standard hasher would take most of the time of a scatter.
#[derive(Default)]
struct CellHasher(u64);

impl std::hash::Hasher for CellHasher {
    fn finish(&self) -> u64 {
        self.0 ^ self.0 >> 29
    }

    fn write(&mut self, bytes: &[u8]) {
        for &b in bytes {
            self.0 = (self.0.rotate_left(5) ^ u64::from(b)).wrapping_mul(0x517C_C1B7_2722_0A95);
        }
    }

    fn write_i32(&mut self, i: i32) {
        self.0 = (self.0.rotate_left(23) ^ u64::from(i as u32)).wrapping_mul(0x9E37_79B9_7F4A_7C15);
    }
}

/// The rotation with x axis `along` and z axis as near as possible to `up`.
pub(super) fn rotation_along(along: Vec3, up: Vec3) -> Quat {
    let x = along.normalize_or(Vec3::X);
    let y = up.cross(x).try_normalize().unwrap_or_else(|| x.any_orthonormal_vector());
    Quat::from_mat3(&glam::Mat3::from_cols(x, y, x.cross(y)))
}
