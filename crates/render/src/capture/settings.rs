//! The settings of a capture.

use glam::{DMat3, DQuat, DVec3, Vec3};
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};
use srflow_avatar::HeadSource;
use srflow_core::random::Key;
use srflow_core::{Color, Size};
use srflow_head::Look;
use srflow_splat::Camera;

use crate::RenderError;
use crate::clap::Args;
use crate::error::{check_size, require};
use crate::generate::Rig;
use crate::head;

/// Name of the file with the arguments of a capture.
pub(super) const MANIFEST_NAME: &str = "capture.json";

/// Numbers of the rig's cameras, in the order in which fewer than all are chosen: the front one first, then by how much they add
/// to the views of those before.
const CHOSEN: [u32; 16] = [8, 1, 15, 4, 11, 6, 10, 2, 14, 0, 13, 5, 12, 7, 9, 3];

/// Standard deviations of the calibration at noise 1: rotation in degrees, position in metres, and focal length as a share. At
/// 550x802 each moves the picture by about a third of a pixel.
const ROTATION_DEGREES: f64 = 0.01;
const POSITION_METRES: f64 = 0.0002;
const FOCAL_SHARE: f64 = 0.0005;

/// The settings of a capture.
#[derive(Args, Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct CaptureSettings {
    /// Head model
    #[arg(long, value_name = "HEAD", default_value_t = Self::default().head, help = crate::generate::head_help())]
    pub head: HeadSource,
    /// Version of how heads look; 1 keeps the bytes of earlier datasets
    #[arg(long, value_name = "1|2", default_value_t = Self::default().look)]
    #[serde(skip_serializing_if = "Look::is_unrecorded")]
    pub look: Look,
    /// Number of cameras, 1 to 16, always including the front camera, number 8
    #[arg(long, value_name = "N", default_value_t = Self::default().cameras)]
    pub cameras: usize,
    /// Number of timesteps
    #[arg(long, value_name = "N", default_value_t = Self::default().timesteps)]
    pub timesteps: u32,
    /// Size of the pictures, WIDTHxHEIGHT
    #[arg(long, value_name = "SIZE", default_value_t = Self::default().size)]
    pub size: Size,
    /// Background colour: white, black, #rrggbb or R,G,B (0 to 255 each)
    #[arg(long, value_name = "COLOUR", default_value_t = Self::default().background)]
    pub background: Color,
    /// Sensor noise on the head; 1 is a standard deviation of about 1.8 of 255 in mid-grey
    #[arg(long, value_name = "FACTOR", default_value_t)]
    pub noise: f32,
    /// Error of the cameras in transforms.json; 1 is about half a pixel at 550x802
    #[arg(long, value_name = "FACTOR", default_value_t)]
    pub calibration_noise: f32,
    /// Standard deviation of the landmarks in landmarks.csv, in pixels
    #[arg(long, value_name = "PIXELS", default_value_t)]
    pub landmark_noise: f32,
    /// Random seed of the person, the motion and the noise
    #[arg(long, value_name = "N", default_value_t = Self::default().seed)]
    pub seed: u64,
}

impl Default for CaptureSettings {
    fn default() -> Self {
        Self {
            head: HeadSource::builtin(),
            look: Look::default(),
            cameras: CHOSEN.len(),
            timesteps: 100,
            size: Size::new(550, 802),
            seed: 1,
            background: Color([255; 3]),
            noise: 0.0,
            calibration_noise: 0.0,
            landmark_noise: 0.0,
        }
    }
}

impl CaptureSettings {
    pub(super) fn validate(&self) -> Result<(), RenderError> {
        let cameras = (1..=CHOSEN.len()).contains(&self.cameras);
        require("cameras", self.cameras, "1 to 16", cameras)?;
        let timesteps = (1..=100_000).contains(&self.timesteps);
        require("timesteps", self.timesteps, "1 to 100000", timesteps)?;
        check_size(self.size, 16..=16_384)?;
        for (field, value) in [
            ("noise", self.noise),
            ("calibration_noise", self.calibration_noise),
            ("landmark_noise", self.landmark_noise),
        ] {
            require(field, value, "0 to 100", (0.0..=100.0).contains(&value))?;
        }
        Ok(())
    }

    /// What `capture.json` holds.
    pub(super) fn arguments(&self) -> Result<Value, RenderError> {
        let mut arguments = json!(self);
        arguments["srflow_version"] = env!("CARGO_PKG_VERSION").into();
        arguments["head"] = head::recorded(&self.head)?.into();
        arguments["width"] = self.size.width.into();
        arguments["height"] = self.size.height.into();
        if let Some(arguments) = arguments.as_object_mut() {
            arguments.remove("size");
        }
        Ok(arguments)
    }

    /// Numbers of the cameras, ascending.
    pub(super) fn camera_indices(&self) -> Vec<u32> {
        indices(self.cameras)
    }

    /// The true cameras, around a head that has to be moved by `home` to be where the built-in heads are.
    pub(super) fn true_cameras(&self, home: Vec3) -> Vec<(u32, Camera)> {
        let rig = Rig::new(self.size, head::centre(&self.head) - home.as_dvec3());
        let views: Vec<_> = Rig::views().map(|(_, view)| view).collect();
        let camera = |index: u32| (index, rig.camera(views[index as usize]));
        self.camera_indices().into_iter().map(camera).collect()
    }

    /// The cameras as a calibration finds them.
    pub(super) fn calibrated(&self, cameras: &[(u32, Camera)]) -> Vec<(u32, Camera)> {
        if self.calibration_noise == 0.0 {
            return cameras.to_vec();
        }
        let noise = f64::from(self.calibration_noise);
        let calibrated = |&(index, camera): &(u32, Camera)| {
            let mut stream = Key::new(self.seed).scene(index).stream("calibration noise");
            let mut vector = |deviation: f64| {
                DVec3::from_array([0; 3].map(|_| f64::from(stream.normal()))) * deviation * noise
            };
            let turn = DQuat::from_scaled_axis(vector(ROTATION_DEGREES.to_radians()));
            let moved = vector(POSITION_METRES);
            let focal = 1.0 + vector(FOCAL_SHARE).x;
            let rotation = DMat3::from_mat4(camera.camera_from_world);
            let world_from_camera = (DMat3::from_quat(turn) * rotation).transpose();
            let placed = camera.placed(world_from_camera, camera.position() + moved);
            (index, Camera { fx: camera.fx * focal, fy: camera.fy * focal, ..placed })
        };
        cameras.iter().map(calibrated).collect()
    }
}

/// The cameras of a capture with so many, ascending.
pub(super) fn indices(cameras: usize) -> Vec<u32> {
    let mut chosen: Vec<u32> = CHOSEN.into_iter().take(cameras).collect();
    chosen.sort_unstable();
    chosen
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_front_camera_is_always_one_and_has_number_eight() {
        for cameras in 1..=16 {
            let settings = CaptureSettings { cameras, ..CaptureSettings::default() };
            let chosen = settings.true_cameras(Vec3::ZERO);
            assert_eq!(chosen.len(), cameras);
            assert!(chosen.is_sorted_by_key(|(index, _)| *index));
            let (_, front) = chosen.iter().find(|(index, _)| *index == 8).expect("the front camera");
            let ahead = front.camera_from_world.inverse().transform_vector3(DVec3::Z);
            assert!((ahead - -DVec3::Z).length() < 1e-9, "{ahead}");
        }
        assert_eq!(indices(16), (0..16).collect::<Vec<_>>());
    }

    #[test]
    fn calibration_noise_moves_pictures_by_about_half_a_pixel() {
        let settings = CaptureSettings { calibration_noise: 1.0, ..CaptureSettings::default() };
        let cameras = settings.true_cameras(Vec3::ZERO);
        let point = head::centre(&settings.head) + DVec3::new(0.05, 0.08, 0.06);
        let found = settings.calibrated(&cameras);
        let shifts = cameras.iter().zip(&found).map(|((_, truth), (_, found))| {
            found.validate().unwrap();
            (truth.project(point).unwrap().0 - found.project(point).unwrap().0).length()
        });
        let mean = shifts.sum::<f64>() / 16.0;
        assert!((0.3..1.2).contains(&mean), "{mean}");
        assert_eq!(CaptureSettings::default().calibrated(&cameras), cameras);
    }

    #[test]
    fn wrong_settings_are_named() {
        let error = |settings: CaptureSettings| settings.validate().unwrap_err().to_string();
        let base = CaptureSettings::default;
        assert!(error(CaptureSettings { cameras: 17, ..base() }).contains("cameras 17: expected 1 to 16"));
        assert!(error(CaptureSettings { timesteps: 0, ..base() }).contains("timesteps 0"));
        assert!(
            error(CaptureSettings { size: Size { width: 8, ..base().size }, ..base() })
                .contains("size 8x802")
        );
        assert!(error(CaptureSettings { noise: f32::NAN, ..base() }).contains("noise NaN"));
        assert!(error(CaptureSettings { landmark_noise: -1.0, ..base() }).contains("landmark_noise -1"));
    }
}
