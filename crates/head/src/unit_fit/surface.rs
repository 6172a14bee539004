//! Points of a surface that are nearest to others.

use std::collections::HashMap;

use glam::{IVec3, Vec3};

use crate::dress::{cell_of, nearest_weights};

/// Cells that one triangle may touch; larger triangles are not part of a face.
const MOST_CELLS: f32 = 4096.0;

/// Cells around a point that are searched.
const REACH: i32 = 3;

/// Triangles in a grid of cells.
pub(super) struct Surface<'a> {
    vertices: &'a [Vec3],
    triangles: &'a [[u32; 3]],
    cell: f32,
    /// Numbers of the triangles that touch each cell.
    cells: HashMap<IVec3, Vec<u32>>,
}

/// A point of a surface.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Nearest {
    pub corners: [u32; 3],
    /// Barycentric coordinates.
    pub weights: Vec3,
    pub distance: f32,
}

impl<'a> Surface<'a> {
    /// The surface of `triangles`, in cells of the size `cell`, metres.
    pub(super) fn new(vertices: &'a [Vec3], triangles: &'a [[u32; 3]], cell: f32) -> Self {
        let mut cells: HashMap<IVec3, Vec<u32>> = HashMap::new();
        for (number, triangle) in (0..).zip(triangles) {
            let corners = triangle.map(|v| cell_of(vertices[v as usize] / cell));
            let [low, high] =
                [corners[0].min(corners[1]).min(corners[2]), corners[0].max(corners[1]).max(corners[2])];
            let size = high.as_vec3() - low.as_vec3() + 1.0;
            if size.element_product() > MOST_CELLS {
                continue;
            }
            for cell in between(low, high) {
                cells.entry(cell).or_default().push(number);
            }
        }
        Self { vertices, triangles, cell, cells }
    }

    /// The point nearest to `p` of the triangles whose normals are within 70 degrees of `normal`; `None` if none is within three cells.
    pub(super) fn nearest(&self, p: Vec3, normal: Vec3) -> Option<Nearest> {
        let at = cell_of(p / self.cell);
        // Whatever is outside of the cells around is further away than one cell, or three.
        let near = self.nearest_within(p, normal, at, 1).filter(|nearest| nearest.distance <= self.cell);
        near.or_else(|| self.nearest_within(p, normal, at, REACH))
            .filter(|nearest| nearest.distance <= REACH as f32 * self.cell)
    }

    fn nearest_within(&self, p: Vec3, normal: Vec3, at: IVec3, reach: i32) -> Option<Nearest> {
        let low = at.map(|cell| cell.saturating_sub(reach));
        let high = at.map(|cell| cell.saturating_add(reach));
        let numbers = between(low, high).filter_map(|cell| self.cells.get(&cell)).flatten();
        let mut best: Option<(Nearest, u32)> = None;
        for &number in numbers {
            let corners = self.triangles[number as usize];
            let [a, b, c] = corners.map(|v| self.vertices[v as usize]);
            if (b - a).cross(c - a).normalize_or_zero().dot(normal) < 0.35 {
                continue;
            }
            let weights = nearest_weights([a, b, c], p);
            let distance = (a * weights.x + b * weights.y + c * weights.z).distance(p);
            let is_nearer = best.is_none_or(|(best, of)| (distance, number) < (best.distance, of));
            if is_nearer {
                best = Some((Nearest { corners, weights, distance }, number));
            }
        }
        best.map(|(nearest, _)| nearest)
    }
}

fn between(low: IVec3, high: IVec3) -> impl Iterator<Item = IVec3> {
    (low.z..=high.z).flat_map(move |z| {
        (low.y..=high.y).flat_map(move |y| (low.x..=high.x).map(move |x| IVec3::new(x, y, z)))
    })
}
