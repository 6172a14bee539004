//! What a camera sees of a mesh.

use glam::{DVec2, DVec3, Vec3};
use rayon::prelude::*;
use srflow_core::Size;
use srflow_head::{HeadModel, Region};
use srflow_splat::Camera;

/// A point of a mesh that a camera sees.
#[derive(Debug, Clone, Copy)]
pub struct SurfacePoint {
    pub triangle: usize,
    /// Weights of the triangle's corners.
    pub weights: DVec3,
    /// Along the camera's axis.
    pub depth: f64,
}

/// The nearest point of the surface at each pixel, row by row; `None` where there is none.
pub fn visible_surface(
    vertices: &[Vec3],
    triangles: &[[u32; 3]],
    camera: &Camera,
) -> Vec<Option<SurfacePoint>> {
    let mut points = vec![None; camera.width * camera.height];
    let draw = |point: &mut Option<SurfacePoint>, triangle, by_depth: DVec3, depth| {
        if point.is_none_or(|nearest: SurfacePoint| depth < nearest.depth) {
            *point = Some(SurfacePoint { triangle, weights: by_depth * depth, depth });
        }
    };
    rasterize(vertices, triangles, camera, &mut points, draw);
    points
}

/// How far away a surface is at each pixel.
pub(crate) struct Depths {
    size: Size,
    /// Along the camera's axis, row by row; infinite where there is no surface.
    nearest: Vec<f64>,
}

impl Depths {
    /// Of what a camera sees of a mesh.
    pub fn of(vertices: &[Vec3], triangles: &[[u32; 3]], camera: &Camera) -> Self {
        let size = camera.size();
        let mut nearest = vec![f64::INFINITY; size.width * size.height];
        let draw = |nearest: &mut f64, _, _, depth: f64| *nearest = nearest.min(depth);
        rasterize(vertices, triangles, camera, &mut nearest, draw);
        Self { size, nearest }
    }

    /// Whether the surface is nearer than a depth at a pixel.
    pub fn hides(&self, pixel: DVec2, depth: f64) -> bool {
        let Size { width, height } = self.size;
        let (x, y) = (pixel.x.round(), pixel.y.round());
        let inside = x >= 0.0 && y >= 0.0 && x < width as f64 && y < height as f64;
        inside && self.nearest[y as usize * width + x as usize] < depth
    }
}

/// Calls `draw` for all pixels of all triangles, with the value of the pixel, the number of the triangle, the weights of its corners
/// divided by the depth, and the depth. The triangles come in order at each pixel.
fn rasterize<T: Send>(
    vertices: &[Vec3],
    triangles: &[[u32; 3]],
    camera: &Camera,
    pixels: &mut [T],
    draw: impl Fn(&mut T, usize, DVec3, f64) + Sync,
) {
    const ROWS: usize = 64;
    let Size { width, height } = camera.size();
    let seen: Vec<Option<(DVec2, f64)>> =
        vertices.iter().map(|vertex| camera.project(vertex.as_dvec3())).collect();
    let strip = |(strip, pixels): (usize, &mut [T])| {
        let top = strip * ROWS;
        for (number, triangle) in triangles.iter().enumerate() {
            let [Some((a, da)), Some((b, db)), Some((c, dc))] = triangle.map(|v| seen[v as usize]) else {
                continue;
            };
            let range = |axis: usize, from: usize, side: usize| {
                let low = a[axis].min(b[axis]).min(c[axis]).ceil().max(from as f64);
                let high = a[axis].max(b[axis]).max(c[axis]).floor().min(side as f64 - 1.0);
                low as usize..if high < low { low as usize } else { high as usize + 1 }
            };
            let rows = range(1, top, height.min(top + ROWS));
            let area = (b - a).perp_dot(c - a);
            if rows.is_empty() || area == 0.0 || !area.is_finite() {
                continue;
            }
            let columns = range(0, 0, width);
            for y in rows {
                for x in columns.clone() {
                    let at = DVec2::new(x as f64, y as f64);
                    let [of_b, of_c] = [(at - a).perp_dot(c - a) / area, (b - a).perp_dot(at - a) / area];
                    if of_b < 0.0 || of_c < 0.0 || of_b + of_c > 1.0 {
                        continue;
                    }
                    // On the surface the weights are those in the picture, each by its corner's depth.
                    let by_depth = DVec3::new((1.0 - of_b - of_c) / da, of_b / db, of_c / dc);
                    let depth = 1.0 / by_depth.element_sum();
                    draw(&mut pixels[(y - top) * width + x], number, by_depth, depth);
                }
            }
        }
    };
    pixels.par_chunks_mut((ROWS * width).max(1)).enumerate().for_each(strip);
}

/// An avatar this far behind the true surface is seen through it, metres: more than the depths of hair differ.
pub const SEEN_THROUGH_METRES: f64 = 0.01;

/// Triangles of the model's surface that hide what is behind them: all but clear ones, such as the cornea.
pub(crate) fn opaque_triangles(model: &HeadModel) -> Vec<[u32; 3]> {
    let (_, triangles) = model.surface(&model.template);
    let opaque = triangles.iter().zip(&model.regions).filter(|(_, region)| **region != Region::Clear);
    opaque.map(|(triangle, _)| *triangle).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_nearer_of_two_triangles_is_seen() {
        // Higher than a strip of rows.
        let camera = Camera::centred(Size::new(20, 150), [200.0; 2]);
        let triangle = |depth: f32, tilt: f32| {
            [Vec3::new(-1.0, -1.0, depth), Vec3::new(1.0, -1.0, depth), Vec3::new(0.0, 1.0, depth + tilt)]
        };
        let vertices = [triangle(4.0, 3.0), triangle(3.0, 0.0)].concat();
        let triangles = [[0, 1, 2], [3, 4, 5]];
        let points = visible_surface(&vertices, &triangles, &camera);
        let depths = Depths::of(&vertices, &triangles, &camera);
        for y in [30, 63, 64, 100] {
            let SurfacePoint { triangle, weights, depth } = points[y * 20 + 10].unwrap();
            let corners = [3, 4, 5].map(|v: usize| vertices[v].as_dvec3());
            let place: DVec3 =
                corners.iter().zip(weights.to_array()).map(|(corner, weight)| *corner * weight).sum();
            let pixel = DVec2::new(10.0, y as f64);
            assert_eq!(triangle, 1);
            assert!((camera.project(place).unwrap().0 - pixel).length() < 1e-9, "{place}");
            assert!(depths.hides(pixel, depth + 1e-9) && !depths.hides(pixel, depth));
        }
        assert!(points[0].is_none());
    }
}
