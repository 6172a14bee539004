//! The camera rig: 16 calibrated portrait cameras on an arc in front of the head, as in NeRSemble (Kirschstein et al. 2023).

use glam::{DMat3, DMat4, DVec3, DVec4};
use srflow_core::Size;
use srflow_splat::Camera;

use crate::camera::record_from_camera;
use srflow_data::manifest::RigCamera;

/// Size of NeRSemble's frames, to which the focal length refers.
pub const FULL_SIZE: Size = Size::new(2200, 3208);

/// Number of the frontal camera, counted from 1 as in the paper.
pub const CANONICAL_CAMERA: u32 = 9;

/// Focal length at [`FULL_SIZE`], in pixels, and distance of each camera from the head's centre, in metres: close to
/// NeRSemble's calibration, so that the head fills the portrait frame as there.
const FOCAL_PIXELS: f64 = 8190.0;
const DISTANCE: f64 = 1.0;

/// Azimuth (positive towards the subject's left) and elevation of each camera, in degrees.
const DIRECTIONS: [(f64, f64); 16] = [
    (-45.0, 8.0),
    (-45.0, -8.0),
    (-33.0, 14.0),
    (-33.0, -2.0),
    (-22.0, -14.0),
    (-22.0, 6.0),
    (-11.0, 16.0),
    (-11.0, -6.0),
    (0.0, 0.0),
    (11.0, 12.0),
    (11.0, -10.0),
    (22.0, 4.0),
    (22.0, -16.0),
    (33.0, 12.0),
    (33.0, -5.0),
    (45.0, 2.0),
];

/// Position and roll of a camera at the rig's distance, in degrees.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct View {
    /// Azimuth about the head, positive towards the subject's left.
    pub azimuth: f64,
    /// Elevation, positive upwards.
    pub elevation: f64,
    /// Rotation about the optical axis, positive turns the image clockwise.
    pub roll: f64,
}

/// Cameras at one distance from the head's centre, all pointing at it.
#[derive(Debug, Clone, PartialEq)]
pub struct Rig {
    size: Size,
    centre: DVec3,
}

impl Rig {
    /// A rig for frames of this size about the head's `centre`, in metres. The field of view is
    /// NeRSemble's, or wider along one axis where the proportions differ from 2200x3208.
    pub fn new(size: Size, centre: DVec3) -> Self {
        Self { size, centre }
    }

    /// Position of each camera, by number from 1.
    pub fn views() -> impl Iterator<Item = (u32, View)> {
        (1..).zip(DIRECTIONS.map(|(azimuth, elevation)| View { azimuth, elevation, roll: 0.0 }))
    }

    pub fn cameras(&self) -> Vec<RigCamera> {
        Self::views()
            .map(|(number, view)| RigCamera { number, camera: record_from_camera(&self.camera(view)) })
            .collect()
    }

    pub fn camera(&self, view: View) -> Camera {
        let Size { width, height } = self.size;
        let scale = (width as f64 / FULL_SIZE.width as f64).min(height as f64 / FULL_SIZE.height as f64);
        // Facing the subject: its left (+x) is on the right, up (+y) is up, forward is -z.
        let facing = DMat3::from_diagonal(DVec3::new(1.0, -1.0, -1.0));
        let orbit = DMat3::from_rotation_y(view.azimuth.to_radians())
            * DMat3::from_rotation_x(-view.elevation.to_radians());
        let rotation = DMat3::from_rotation_z(view.roll.to_radians()) * facing * orbit.transpose();
        let translation = DVec3::new(0.0, 0.0, DISTANCE) - rotation * self.centre;
        Camera {
            camera_from_world: DMat4::from_cols(
                rotation.x_axis.extend(0.0),
                rotation.y_axis.extend(0.0),
                rotation.z_axis.extend(0.0),
                DVec4::from((translation, 1.0)),
            ),
            ..Camera::centred(self.size, [FOCAL_PIXELS * scale; 2])
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const CENTRE: DVec3 = DVec3::new(0.01, 0.2, -0.03);

    fn view_of(number: u32) -> View {
        Rig::views().find(|(n, _)| *n == number).unwrap().1
    }

    #[test]
    fn every_camera_sees_the_head_in_the_middle_at_one_metre() {
        let rig = Rig::new(FULL_SIZE, CENTRE);
        assert_eq!(rig.cameras().len(), 16);
        for (number, view) in Rig::views() {
            let (pixel, depth) = rig.camera(view).project(CENTRE).unwrap();
            assert!(
                (pixel.x - 1099.5).abs() < 1e-6 && (pixel.y - 1603.5).abs() < 1e-6,
                "camera {number}: {pixel}"
            );
            assert!((depth - DISTANCE).abs() < 1e-9);
        }
    }

    #[test]
    fn the_canonical_camera_faces_the_subject_upright() {
        let camera = Rig::new(FULL_SIZE, CENTRE).camera(view_of(CANONICAL_CAMERA));
        let (left, _) = camera.project(CENTRE + DVec3::X * 0.1).unwrap();
        let (crown, _) = camera.project(CENTRE + DVec3::Y * 0.1).unwrap();
        let (_, nose) = camera.project(CENTRE + DVec3::Z * 0.1).unwrap();
        assert!(
            left.x > 1900.0 && (left.y - 1603.5).abs() < 1e-6,
            "the subject's left is on the right: {left}"
        );
        assert!(crown.y < 800.0 && (crown.x - 1099.5).abs() < 1e-6, "the crown is above: {crown}");
        assert!(nose < DISTANCE);
    }

    #[test]
    fn azimuth_elevation_and_roll_have_the_right_sign() {
        let rig = Rig::new(FULL_SIZE, CENTRE);
        let seen = |view, offset| rig.camera(view).project(CENTRE + offset).unwrap();
        let from_the_left = View { azimuth: 30.0, ..View::default() };
        assert!(seen(from_the_left, DVec3::X * 0.1).1 < 0.96, "the subject's left is nearer");
        let from_above = View { elevation: 10.0, ..View::default() };
        assert!(seen(from_above, DVec3::Y * 0.1).1 < 0.99, "the crown is nearer");
        let rolled = View { roll: 10.0, ..View::default() };
        assert!(seen(rolled, DVec3::Y * 0.1).0.x > 1100.0, "the crown leans to the right, clockwise");
    }

    #[test]
    fn another_size_shows_the_same_view() {
        let view = View { azimuth: 20.0, elevation: -5.0, roll: 3.0 };
        let point = CENTRE + DVec3::new(0.05, 0.1, 0.08);
        let (full, _) = Rig::new(FULL_SIZE, CENTRE).camera(view).project(point).unwrap();
        let (tiny, _) = Rig::new(Size::new(110, 160), CENTRE).camera(view).project(point).unwrap();
        let scale = 160.0 / 3208.0;
        assert!(((full.x - 1099.5) * scale - (tiny.x - 54.5)).abs() < 1e-9);
        assert!(((full.y - 1603.5) * scale - (tiny.y - 79.5)).abs() < 1e-9);
    }
}
