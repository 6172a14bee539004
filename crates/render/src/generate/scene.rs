//! A scene: one moving subject in front of a moving camera. Frames can be computed in any order.

use glam::{EulerRot, Quat, Vec3};
use srflow_avatar::{Avatar, HeadModel, HeadPose, HeadSource, Moment, Motion, PoseParameters, Side};
use srflow_field::Image;
use srflow_field::random::{Key, Stream};
use srflow_splat::Camera;

use super::background::{self, Background};
use super::motion::MotionSource;
use super::path::Path;
use super::rig::{Rig, View};
use super::settings::Settings;
use crate::RenderError;
use crate::camera::record_from_camera;
use crate::record::FrameRecord;
use srflow_read::manifest::SceneEntry;

/// Frame rate of the motion. NeRSemble records 73 frames per second, at which expressions hardly move between frames.
const FRAMES_PER_SECOND: f32 = 24.0;

/// Scenes with fewer frames move less: they are too short for a whole expression.
const FRAMES_OF_FULL_MOTION: f32 = 24.0;

/// Minimum number of frames from one key view to the next.
const FRAMES_BETWEEN_VIEWS: u32 = 80;

/// Bounds of a scene's fastest rotation, in degrees per frame, drawn log-uniformly: some scenes are nearly still, others
/// fast. One degree moves the nose by about 13 px at full size.
const CAMERA_SPEEDS: (f32, f32) = (0.2, 1.4);
const SUBJECT_SPEEDS: (f32, f32) = (0.1, 0.8);

/// Limits of the camera's roll and the subject's yaw, pitch and roll, in degrees.
const CAMERA_ROLL: f32 = 6.0;
const SUBJECT_TURN: [f32; 3] = [22.0, 11.0, 8.0];

/// One moving subject in front of a moving camera.
pub(super) struct Scene {
    pub entry: SceneEntry,
    pub avatar: Avatar,
    /// The background, if it is an image.
    pub background: Option<Image>,
    action: Action,
}

/// The motion of a scene's subject and camera.
pub(crate) struct Action {
    views: Views,
    motion: Motion,
    /// See [`Avatar::home`].
    home: Vec3,
    /// The motion, where it is recorded.
    recorded: Option<Vec<PoseParameters>>,
}

/// The path of the camera around the head, and the rotation of the subject.
pub(crate) struct Views {
    pairs: u32,
    rig: Rig,
    camera_path: Path<3>,
    /// `None` where the motion is recorded: the whole head's turns are part of it.
    subject_path: Option<Path<3>>,
}

/// The state of one frame, without its pixels.
pub(crate) struct FrameState {
    pub camera: Camera,
    pub pose: HeadPose,
    view: [f64; 3],
    subject: [f64; 3],
    moment: Moment,
}

pub(super) fn subject(head: &HeadSource, entry: &SceneEntry) -> Result<Avatar, RenderError> {
    head.avatar(entry.subject)
        .map_err(|error| RenderError::Head { who: entry.name.clone(), reason: error.to_string() })
}

impl Scene {
    /// Scene `number` of a dataset.
    pub fn new(settings: &Settings, rig: &Rig, number: u32, entry: &SceneEntry) -> Result<Self, RenderError> {
        let avatar = subject(&settings.head, entry)?;
        let background = match (&settings.background, &entry.background) {
            (Background::Images(dir), Some(name)) => {
                Some(background::load(&dir.join(name), settings.width, settings.height)?)
            }
            _ => None,
        };
        let action = Action::new(settings, rig, number, entry, avatar.model());
        let action = Action { home: avatar.home(), recorded: settings.motion.poses(&avatar)?, ..action };
        Ok(Self { entry: entry.clone(), avatar, background, action })
    }

    /// The state of frame `frame`; the first and the last are seen by camera 9 with the subject facing it.
    pub fn frame(&self, frame: u32) -> FrameState {
        self.action.frame(self.avatar.model(), frame)
    }

    /// The record of a frame.
    pub fn record(&self, frame: u32, state: &FrameState) -> FrameRecord {
        record(self.avatar.model(), frame, state)
    }
}

impl Views {
    pub fn new(settings: &Settings, rig: &Rig, number: u32, pairs: u32) -> Self {
        let key = Key::new(settings.seed).scene(number);
        Self {
            pairs,
            rig: rig.clone(),
            camera_path: camera_path(&mut key.stream("camera"), pairs),
            subject_path: (settings.motion == MotionSource::Curves)
                .then(|| subject_path(&mut key.stream("subject turns"), pairs)),
        }
    }

    /// The camera of a frame, its azimuth, elevation and roll, and the subject's yaw, pitch and roll, in degrees.
    pub fn at(&self, frame: u32) -> (Camera, [f64; 3], [f64; 3]) {
        let t = f64::from(frame) / f64::from(self.pairs.max(1));
        let view = self.camera_path.at(t);
        let [azimuth, elevation, roll] = view;
        let subject = self.subject_path.as_ref().map_or([0.0; 3], |path| path.at(t));
        (self.rig.camera(View { azimuth, elevation, roll }), view, subject)
    }
}

impl Action {
    pub fn new(settings: &Settings, rig: &Rig, number: u32, entry: &SceneEntry, model: &HeadModel) -> Self {
        let key = Key::new(settings.seed).scene(number);
        Self {
            views: Views::new(settings, rig, number, entry.pairs),
            motion: Motion::new(model, key, entry.pairs as usize + 1, FRAMES_PER_SECOND),
            home: Vec3::ZERO,
            recorded: None,
        }
    }

    pub fn frame(&self, model: &HeadModel, frame: u32) -> FrameState {
        let (camera, view, subject) = self.views.at(frame);
        if let Some(parameters) = self.recorded.as_ref().and_then(|recorded| recorded.get(frame as usize)) {
            let mut pose = parameters.pose(model);
            pose.translation += self.home;
            let moment = Moment { pose: pose.clone(), action_units: Vec::new(), gaze: [0.0; 2] };
            return FrameState { camera, pose, view, subject, moment };
        }
        let mut moment = self.motion.at(model, frame as usize);
        soften(&mut moment, self.views.pairs as f32 / FRAMES_OF_FULL_MOTION);
        let mut pose = moment.pose.clone();
        let [yaw, pitch, roll] = subject.map(|degrees| degrees.to_radians() as f32);
        let turn = Quat::from_euler(EulerRot::YXZ, yaw, -pitch, roll);
        let root = pose.joint_mut(0);
        *root = (turn * *root).normalize();
        pose.translation += self.home;
        FrameState { camera, pose, view, subject, moment }
    }
}

/// The record of a frame.
pub(crate) fn record(model: &HeadModel, frame: u32, state: &FrameState) -> FrameRecord {
    let weights = model.expressions.iter().zip(&state.pose.expressions);
    FrameRecord {
        frame,
        camera: record_from_camera(&state.camera),
        view: state.view,
        subject: state.subject,
        expressions: weights
            .filter(|(_, weight)| **weight != 0.0)
            .map(|(shape, weight)| (shape.name.clone(), *weight))
            .collect(),
        joints: model
            .joints
            .iter()
            .enumerate()
            .map(|(number, joint)| (joint.name.clone(), state.pose.joint(number).to_array()))
            .collect(),
        translation: state.pose.translation.to_array(),
        gaze: state.moment.gaze,
        action_units: state
            .moment
            .action_units
            .iter()
            .map(|&(number, side, intensity)| (unit_name(number, side), intensity))
            .collect(),
    }
}

/// A moment with its strength scaled down.
fn soften(moment: &mut Moment, strength: f32) {
    if strength >= 1.0 {
        return;
    }
    moment.pose.expressions.iter_mut().for_each(|weight| *weight *= strength);
    for rotation in &mut moment.pose.joints {
        *rotation = Quat::IDENTITY.slerp(*rotation, strength);
    }
    moment.pose.translation *= strength;
    moment.gaze = moment.gaze.map(|angle| angle * strength);
    moment.action_units.iter_mut().for_each(|(_, _, intensity)| *intensity *= strength);
}

/// `AU12_L` where a unit has halves, else `AU9`.
pub(crate) fn unit_name(number: u8, side: Side) -> String {
    match side {
        Side::Both => format!("AU{number}"),
        Side::Left => format!("AU{number}_L"),
        Side::Right => format!("AU{number}_R"),
    }
}

/// From camera 9 past random cameras of the rig and back.
fn camera_path(stream: &mut Stream, pairs: u32) -> Path<3> {
    let views: Vec<View> = Rig::views().map(|(_, view)| view).collect();
    let points = (0..stops(stream, pairs)).map(|_| {
        let view = views[stream.below(views.len() as u32) as usize];
        [view.azimuth, view.elevation, f64::from(stream.uniform(-CAMERA_ROLL, CAMERA_ROLL))]
    });
    let points: Vec<[f64; 3]> = points.collect();
    from_rest_to_rest(points, pairs, speed(stream, CAMERA_SPEEDS))
}

/// From the rest pose through random rotations and back.
fn subject_path(stream: &mut Stream, pairs: u32) -> Path<3> {
    let points = (0..stops(stream, pairs))
        .map(|_| SUBJECT_TURN.map(|reach| f64::from(stream.uniform(-reach, reach))))
        .collect();
    from_rest_to_rest(points, pairs, speed(stream, SUBJECT_SPEEDS))
}

/// Number of points of a path between its ends.
fn stops(stream: &mut Stream, pairs: u32) -> u32 {
    let most = (pairs / FRAMES_BETWEEN_VIEWS).max(1);
    let fewest = (most / 3).max(1);
    fewest + stream.below(most - fewest + 1)
}

fn speed(stream: &mut Stream, (slowest, fastest): (f32, f32)) -> f64 {
    f64::from(slowest * libm::powf(fastest / slowest, stream.unit()))
}

/// A path through `points` that starts and ends at zero, scaled down until no frame turns by more than `speed` degrees.
fn from_rest_to_rest(points: Vec<[f64; 3]>, pairs: u32, speed: f64) -> Path<3> {
    let rest = [0.0; 3];
    let path = Path::through([vec![rest], points, vec![rest]].concat());
    let fastest = path.greatest_step(pairs);
    if fastest > speed { path.scaled(speed / fastest) } else { path }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn paths_start_and_end_at_camera_nine_and_keep_their_speed() {
        for scene in 0..40 {
            for pairs in [1, 2, 4, 39, 413] {
                let stream = || Key::new(5).scene(scene).stream("test");
                let (camera, subject) =
                    (camera_path(&mut stream(), pairs), subject_path(&mut stream(), pairs));
                for path in [&camera, &subject] {
                    assert_eq!((path.at(0.0), path.at(1.0)), ([0.0; 3], [0.0; 3]));
                }
                assert!(camera.greatest_step(pairs) <= f64::from(CAMERA_SPEEDS.1) * 1.0001);
                assert!(subject.greatest_step(pairs) <= f64::from(SUBJECT_SPEEDS.1) * 1.0001);
            }
        }
    }

    #[test]
    fn long_scenes_have_views_from_many_sides() {
        let widest = |scene| {
            let path = camera_path(&mut Key::new(5).scene(scene).stream("test"), 413);
            (0..=413).map(|frame| path.at(f64::from(frame) / 413.0)[0].abs()).fold(0.0, f64::max)
        };
        let angles: Vec<f64> = (0..27).map(widest).collect();
        assert!(angles.iter().filter(|angle| **angle > 15.0).count() > 9, "{angles:?}");
        assert!(angles.iter().all(|angle| *angle < 70.0), "{angles:?}");
    }
}
