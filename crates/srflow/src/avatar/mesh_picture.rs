//! A mesh as a camera sees it, over a picture.

use glam::Vec3;
use srflow_avatar::visible_surface;
use srflow_core::{Image, Plane};
use srflow_splat::Camera;

/// How brightly the surface is lit from the camera at each pixel, from 0.25 to 1; 0 where there is none.
pub fn shading(vertices: &[Vec3], triangles: &[[u32; 3]], camera: &Camera) -> Plane {
    let eye = camera.position();
    let lit: Vec<f32> = triangles
        .iter()
        .map(|triangle| {
            let [p, q, r] = triangle.map(|v| vertices[v as usize].as_dvec3());
            let normal = (q - p).cross(r - p).normalize_or_zero();
            (0.25 + 0.75 * normal.dot((eye - p).normalize_or_zero()).abs()) as f32
        })
        .collect();
    let points = visible_surface(vertices, triangles, camera);
    Plane::from_fn(camera.width, camera.height, |x, y| {
        points[y * camera.width + x].map_or(0.0, |point| lit[point.triangle])
    })
}

/// The picture with the surface over it, through which it is seen.
pub fn overlay(image: &Image, shading: &Plane) -> Image {
    const SURFACE: [f32; 3] = [90.0, 190.0, 255.0];
    Image::from_fn(image.width(), image.height(), |x, y| {
        let (pixel, shade) = (image.get(x, y), shading.get(x, y));
        let share = if shade > 0.0 { 0.55 } else { 0.0 };
        std::array::from_fn(|c| {
            (f32::from(pixel[c]) * (1.0 - share) + SURFACE[c] * shade * share).round() as u8
        })
    })
}

#[cfg(test)]
mod tests {
    use srflow_core::Size;

    use super::*;

    #[test]
    fn the_nearer_of_two_triangles_is_lit() {
        let camera = Camera::centred(Size::new(20, 20), [20.0; 2]);
        let triangle = |depth: f32, tilt: f32| {
            [Vec3::new(-1.0, -1.0, depth), Vec3::new(1.0, -1.0, depth), Vec3::new(0.0, 1.0, depth + tilt)]
        };
        let vertices = [triangle(4.0, 3.0), triangle(3.0, 0.0)].concat();
        let both = shading(&vertices, &[[0, 1, 2], [3, 4, 5]], &camera);
        let near = shading(&vertices, &[[3, 4, 5]], &camera);
        assert_eq!(both.get(10, 10), near.get(10, 10));
        assert!(near.get(10, 10) > 0.9 && near.get(1, 1) == 0.0);
    }
}
