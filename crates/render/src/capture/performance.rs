//! What is captured: a person, their motion, and the cameras around them.

use glam::{EulerRot, Quat, Vec3};
use srflow_avatar::capture::HeadRecord;
use srflow_avatar::{Avatar, AvatarError};
use srflow_core::random::Key;
use srflow_head::{HeadModel, HeadPose, JointRole, Look, Motion, PoseParameters, Side};
use srflow_splat::Camera;

use super::CaptureSettings;
use crate::RenderError;
use crate::generate::SmoothPath;

/// Timesteps per second. Captures too short for expressions at this rate have fewer, so that they last at least
/// [`LEAST_SECONDS`].
const TIMESTEPS_PER_SECOND: f32 = 24.0;
const LEAST_SECONDS: f32 = 3.0;

/// Limits of the head's yaw, pitch and roll in degrees, and of its translation in metres.
const TURN_DEGREES: [f64; 3] = [14.0, 8.0, 5.0];
const TRANSLATION_METRES: f64 = 0.008;

/// Seconds between control points of the turns and the translation.
const KNOT_SECONDS: f32 = 0.9;

/// Action units at their strongest, and how far the eyes turn to the subject's left and up, in radians.
type Shown = (&'static [(u8, f32)], [f32; 2]);

/// What the face shows at first, one after the other, as in recordings for avatars.
const WARM_UP: [Shown; 13] = [
    (&[(6, 0.8), (12, 1.0), (25, 0.6)], [0.0, 0.0]),
    (&[(1, 1.0), (2, 1.0), (5, 0.8)], [0.0, 0.0]),
    (&[(26, 1.0), (25, 0.5)], [0.0, 0.0]),
    (&[(4, 1.0), (7, 0.7)], [0.0, 0.0]),
    (&[(9, 1.0), (10, 0.7)], [0.0, 0.0]),
    (&[(43, 1.0)], [0.0, 0.0]),
    (&[(15, 1.0), (17, 0.8)], [0.0, 0.0]),
    (&[(20, 1.0), (25, 0.7)], [0.0, 0.0]),
    (&[(14, 1.0), (24, 0.6)], [0.0, 0.0]),
    (&[], [0.45, 0.0]),
    (&[], [-0.45, 0.0]),
    (&[], [0.0, 0.3]),
    (&[], [0.0, -0.35]),
];

/// Share of the timesteps in which the face warms up; those of captures that are long enough to show all of it.
const WARM_UP_SHARE: f32 = 0.4;

/// The pose of the face in a timestep of `timesteps` in which it warms up: one part of [`WARM_UP`], which comes and goes.
fn warm_up(model: &HeadModel, timestep: usize, timesteps: usize) -> Option<HeadPose> {
    let each = (timesteps as f32 * WARM_UP_SHARE / WARM_UP.len() as f32).floor();
    let at = (timestep as f32 + 0.5) / each;
    let (units, [left, up]) = *WARM_UP.get(at as usize).filter(|_| each >= 2.0)?;
    let strength = libm::sinf(std::f32::consts::PI * at.fract());
    let has = |number| model.action_units.iter().any(|unit| unit.number == number);
    let units: Vec<_> = units
        .iter()
        .filter(|unit| has(unit.0))
        .map(|&(number, most)| (number, Side::Both, most * strength))
        .collect();
    // All of them are units of the model.
    let mut pose = model.pose_of_action_units(&units).ok()?;
    let gaze = Quat::from_euler(EulerRot::YXZ, left * strength, -up * strength, 0.0);
    for eye in [JointRole::LeftEye, JointRole::RightEye] {
        if let Some(joint) = model.joint(eye) {
            *pose.joint_mut(joint) *= gaze;
        }
    }
    Some(pose)
}

/// A person who moves in front of cameras.
pub struct Performance {
    pub avatar: Avatar,
    /// Which head model it is.
    pub head: HeadRecord,
    /// Pose at each timestep: first every kind of expression and gaze, then expressions, speech, blinks and gaze at random, and turns of the
    /// whole head. The translations have a mean of
    /// zero, as VHAP moves the world.
    pub poses: Vec<PoseParameters>,
    /// Numbers and true cameras.
    pub cameras: Vec<(u32, Camera)>,
}

impl Performance {
    pub fn new(settings: &CaptureSettings) -> Result<Self, RenderError> {
        let failed = |error: AvatarError| RenderError::Head {
            who: "the capture".to_owned(),
            reason: error.to_string(),
        };
        let source = settings.head.with_look(settings.look);
        let avatar = source.avatar(settings.seed).map_err(failed)?;
        let head = source.record(settings.seed, avatar.model()).map_err(failed)?;
        let timesteps = settings.timesteps as usize;
        let rate = TIMESTEPS_PER_SECOND.min(timesteps as f32 / LEAST_SECONDS).max(1.0);
        let key = Key::new(settings.seed);
        let model = avatar.model();
        let motion = Motion::new(model, settings.look, key, timesteps, rate);
        let wander = wander(key, timesteps as f32 / rate);
        let mut poses: Vec<PoseParameters> = (0..timesteps)
            .map(|timestep| {
                let warm_up = (settings.look >= Look::Second).then(|| warm_up(model, timestep, timesteps));
                let mut pose = warm_up.flatten().unwrap_or_else(|| motion.at(model, timestep).pose);
                let t = (timestep as f64 + 0.5) / timesteps as f64;
                let [yaw, pitch, roll, x, y, z] = wander.at(t).map(|value| value as f32);
                let turn =
                    Quat::from_euler(EulerRot::YXZ, yaw.to_radians(), -pitch.to_radians(), roll.to_radians());
                let root = pose.joint_mut(0);
                *root = (turn * *root).normalize();
                pose.translation += Vec3::new(x, y, z);
                PoseParameters::of(model, &pose)
            })
            .collect();
        let mean = poses.iter().map(|pose| pose.translation).sum::<Vec3>() / timesteps.max(1) as f32;
        poses.iter_mut().for_each(|pose| pose.translation -= mean);
        Ok(Self { head, poses, cameras: settings.true_cameras(avatar.home()), avatar })
    }
}

/// Yaw, pitch and roll in degrees and translation in metres of the whole head.
fn wander(key: Key, seconds: f32) -> SmoothPath<6> {
    let mut stream = key.stream("head turns");
    let knots = (seconds / KNOT_SECONDS).ceil().clamp(1.0, 1e5) as usize + 1;
    let reach = |axis: usize| TURN_DEGREES.get(axis).copied().unwrap_or(TRANSLATION_METRES);
    let points = (0..knots)
        .map(|_| std::array::from_fn(|axis| reach(axis) * f64::from(stream.uniform(-1.0, 1.0))))
        .collect();
    SmoothPath::through(points)
}
