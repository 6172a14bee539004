//! What training starts from.

use glam::{DVec3, Quat, Vec3};
use srflow_core::random::Key;
use srflow_splat::{Camera, Gaussians};

use crate::BoundGaussians;

/// One Gaussian in the middle of each of `count` triangles, of local scale 1, this opacity (0.1 in GaussianAvatars) and a nearly grey
/// colour that depends on `seed` (`create_from_pcd` in `scene/gaussian_model.py` of GaussianAvatars).
pub fn initial_gaussians(count: usize, opacity: f32, seed: u64) -> BoundGaussians {
    let mut stream = Key::new(seed).stream("initial colours");
    let local = Gaussians {
        positions: vec![Vec3::ZERO; count],
        scales: vec![Vec3::ONE; count],
        rotations: vec![Quat::IDENTITY; count],
        opacities: vec![opacity; count],
        sh_degree: 0,
        sh: (0..count).map(|_| std::array::from_fn(|_| stream.unit() / 255.0)).collect(),
        antialiased: false,
    };
    BoundGaussians::new(local, (0..count as u32).collect(), count).expect("one triangle each")
}

/// The extent of a scene in 3D Gaussian Splatting: 1.1 times the largest distance of a camera from the mean of all, in the units of
/// the world (`getNerfppNorm` in `scene/dataset_readers.py`). 0 without cameras.
pub fn camera_extent<'a>(cameras: impl Iterator<Item = &'a Camera>) -> f64 {
    let positions: Vec<_> = cameras.map(Camera::position).collect();
    let mean = positions.iter().sum::<glam::DVec3>() / positions.len().max(1) as f64;
    1.1 * positions.iter().map(|position| position.distance(mean)).fold(0.0, f64::max)
}

/// The least extent of a scene, in mean distances from its cameras to the head.
const LEAST_EXTENT: f64 = 0.5;

/// [`camera_extent`] of cameras, each with the place of the head in front of it, but no less than half of their mean distance. One camera
/// alone has no extent: no Gaussian would move, and all would be removed as too large.
pub fn scene_extent(cameras: &[(&Camera, DVec3)]) -> f64 {
    let distances = cameras.iter().map(|(camera, head)| camera.position().distance(*head));
    let mean = distances.sum::<f64>() / cameras.len().max(1) as f64;
    camera_extent(cameras.iter().map(|(camera, _)| *camera)).max(LEAST_EXTENT * mean)
}

#[cfg(test)]
mod tests {
    use glam::DMat3;
    use srflow_core::Size;

    use super::*;

    #[test]
    fn every_triangle_starts_with_one_gaussian() {
        let bound = initial_gaussians(50, 0.1, 3);
        assert!(bound.triangles().iter().copied().eq(0..50));
        let sh = bound.local().sh.as_flattened();
        assert!(sh.iter().all(|value| (0.0..1.0 / 255.0).contains(value)) && sh[0] != sh[1]);
        assert_eq!(bound.local(), initial_gaussians(50, 0.1, 3).local());
        assert_ne!(bound.local(), initial_gaussians(50, 0.1, 4).local());
    }

    #[test]
    fn the_extent_is_that_of_the_cameras_around_their_mean() {
        let camera = Camera::centred(Size::new(4, 4), [4.0; 2]);
        let at = |x: f64| camera.placed(DMat3::IDENTITY, DVec3::new(x, 5.0, 0.0));
        let cameras = [at(0.0), at(1.0), at(5.0)];
        assert!((camera_extent(cameras.iter()) - 1.1 * 3.0).abs() < 1e-12);
        assert_eq!(camera_extent([].iter()), 0.0);
        let before = |cameras: &[Camera], head: DVec3| {
            scene_extent(&cameras.iter().map(|camera| (camera, head)).collect::<Vec<_>>())
        };
        assert_eq!(before(&cameras, DVec3::new(1.0, 5.0, 1.0)), camera_extent(cameras.iter()));
        assert_eq!(before(&cameras[..1], DVec3::new(0.0, 5.0, 0.8)), 0.4, "one camera");
    }
}
