//! A scene: one moving subject in front of a moving camera. Frames can be computed in any order.

use std::sync::Arc;

use glam::{EulerRot, Quat, Vec3};
use srflow_avatar::{Avatar, Avatars, HeadSource};
use srflow_core::Image;
use srflow_core::random::{Key, Stream};
use srflow_head::motion::add_unit;
use srflow_head::{HeadModel, HeadPose, MicroExpression, Moment, Motion, PoseParameters};
use srflow_splat::Camera;

use super::background;
use super::lamps::Lamps;
use super::motion::{FRAMES_PER_SECOND, MotionSource};
use super::path::Path;
use super::rig::{Rig, View};
use super::settings::Settings;
use crate::RenderError;
use crate::action_units::{action_unit_sets, unit_name};
use crate::camera::record_from_camera;
use crate::record::FrameRecord;
use crate::recording::Recorder;
use srflow_data::manifest::SceneEntry;
use srflow_data::micro_expression::EmotionClass;

/// Shorter scenes move less: they are too short for a whole expression.
const SECONDS_OF_FULL_MOTION: f32 = 1.0;

/// Bounds of the frame rate of a scene with mixed motion, drawn log-uniformly: from a slow webcam to the cameras of
/// micro-expressions (CASME II and SAMM: 200 frames per second).
const FRAME_RATES: (f32, f32) = (6.0, 200.0);

/// Share of the scenes with mixed motion that are calm, and the strength of all but their micro-expressions.
const CALM_SHARE: f32 = 1.0 / 3.0;
const CALM_STRENGTH: f32 = 0.1;

/// Bounds of the time between micro-expressions, seconds.
const SECONDS_BETWEEN_MICRO_EXPRESSIONS: (f32, f32) = (0.05, 1.0);

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
    pub avatar: Arc<Avatar>,
    /// The background, unless it is a colour.
    pub background: Option<Image>,
    recorder: Option<Recorder>,
    /// Lamps that shade the head, if any.
    pub lamps: Option<Lamps>,
    action: Action,
}

/// The motion of a scene's subject and camera.
pub(crate) struct Action {
    views: Views,
    motion: Motion,
    micro_expressions: Vec<MicroExpression>,
    /// See [`Avatar::home`].
    home: Vec3,
    /// The motion, where it is recorded.
    recorded: Option<Vec<PoseParameters>>,
}

/// The path of the camera around the head, and the rotation of the subject.
pub(crate) struct Views {
    pairs: u32,
    pace: Pace,
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

/// How much a scene moves from frame to frame.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Pace {
    frames_per_second: f32,
    /// Strength of expressions, speech, blinks, gaze and the neck, 0 to 1.
    strength: f32,
}

impl Default for Pace {
    fn default() -> Self {
        Self { frames_per_second: FRAMES_PER_SECOND, strength: 1.0 }
    }
}

impl Pace {
    fn random(key: Key) -> Self {
        let mut stream = key.stream("pace");
        let frames_per_second = log_uniform(&mut stream, FRAME_RATES);
        let strength = if stream.unit() < CALM_SHARE { CALM_STRENGTH } else { 1.0 };
        Self { frames_per_second, strength }
    }

    /// Time between frames, relative to that of other motion.
    fn step(self) -> f32 {
        FRAMES_PER_SECOND / self.frames_per_second
    }
}

pub(super) fn subject(
    avatars: &Avatars,
    head: &HeadSource,
    entry: &SceneEntry,
) -> Result<Arc<Avatar>, RenderError> {
    avatars
        .get(head, entry.subject)
        .map_err(|error| RenderError::Head { who: entry.name.clone(), reason: error.to_string() })
}

impl Scene {
    /// Scene `number` of a dataset, of the [`subject`] of its entry.
    pub fn new(
        settings: &Settings,
        rig: &Rig,
        number: u32,
        entry: &SceneEntry,
        avatar: Arc<Avatar>,
    ) -> Result<Self, RenderError> {
        let key = Key::new(settings.seed).scene(number);
        let Settings { background, size, look, .. } = settings;
        let background = background::behind(background, entry.background.as_deref(), *size, key, *look)?;
        let action = Action::new(settings, rig, number, entry, avatar.model());
        let action = Action { home: avatar.home(), recorded: settings.motion.poses(&avatar)?, ..action };
        let recorder = (!settings.recording.is_none()).then(|| Recorder::new(&settings.recording, key));
        let lamps = settings.recording.lamps;
        let lamps = (lamps > 0.0).then(|| Lamps::random(key, lamps, settings.look));
        Ok(Self { entry: entry.clone(), avatar, background, recorder, lamps, action })
    }

    /// Turns the rendered picture of a frame into the one that the scene's camera records.
    pub fn record_picture(&self, image: &mut Image, frame: u32) {
        if let Some(recorder) = &self.recorder {
            recorder.record(image, frame, frame as f32 / self.action.views.pace.frames_per_second);
        }
    }

    /// See [`Recorder::moments`]; empty without a recorder.
    pub fn moments(&self, longest: f32) -> Vec<f32> {
        self.recorder.as_ref().map_or_else(Vec::new, |recorder| recorder.moments(longest))
    }

    /// See [`Recorder::blurs_motion`].
    pub fn blurs_motion(&self) -> bool {
        self.recorder.as_ref().is_some_and(Recorder::blurs_motion)
    }

    /// The camera at a moment between frames.
    pub fn camera(&self, frame: f64) -> Camera {
        self.action.views.at(frame).0
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
        let pace = if settings.motion == MotionSource::Mixed { Pace::random(key) } else { Pace::default() };
        Self {
            pairs,
            pace,
            rig: rig.clone(),
            camera_path: camera_path(&mut key.stream("camera"), pairs, pace),
            subject_path: (!settings.motion.is_of_files())
                .then(|| subject_path(&mut key.stream("subject turns"), pairs, pace)),
        }
    }

    /// The camera at a frame or between two, its azimuth, elevation and roll, and the subject's yaw, pitch and roll, in degrees.
    pub fn at(&self, frame: f64) -> (Camera, [f64; 3], [f64; 3]) {
        let t = frame / f64::from(self.pairs.max(1));
        let view = self.camera_path.at(t);
        let [azimuth, elevation, roll] = view;
        let subject = self.subject_path.as_ref().map_or([0.0; 3], |path| path.at(t));
        (self.rig.camera(View { azimuth, elevation, roll }), view, subject)
    }
}

impl Action {
    pub fn new(settings: &Settings, rig: &Rig, number: u32, entry: &SceneEntry, model: &HeadModel) -> Self {
        let key = Key::new(settings.seed).scene(number);
        let views = Views::new(settings, rig, number, entry.pairs);
        let rate = views.pace.frames_per_second;
        let mixed = settings.motion == MotionSource::Mixed;
        Self {
            motion: Motion::new(model, settings.look, key, entry.pairs as usize + 1, rate),
            micro_expressions: if mixed {
                micro_expressions(model, key, entry.pairs, rate)
            } else {
                Vec::new()
            },
            views,
            home: Vec3::ZERO,
            recorded: None,
        }
    }

    pub fn frame(&self, model: &HeadModel, frame: u32) -> FrameState {
        let (camera, view, subject) = self.views.at(f64::from(frame));
        if let Some(parameters) = self.recorded.as_ref().and_then(|recorded| recorded.get(frame as usize)) {
            let mut pose = parameters.pose(model);
            pose.translation += self.home;
            let moment = Moment { pose: pose.clone(), action_units: Vec::new(), gaze: [0.0; 2] };
            return FrameState { camera, pose, view, subject, moment };
        }
        let mut moment = self.motion.at(model, frame as usize);
        let Pace { frames_per_second, strength } = self.views.pace;
        soften(
            &mut moment,
            strength * (self.views.pairs as f32 / frames_per_second / SECONDS_OF_FULL_MOTION).min(1.0),
        );
        for micro_expression in &self.micro_expressions {
            add(model, &mut moment, micro_expression, frame);
        }
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

/// Micro-expressions one after the other, each of them whole.
fn micro_expressions(
    model: &HeadModel,
    key: Key,
    pairs: u32,
    frames_per_second: f32,
) -> Vec<MicroExpression> {
    let sets: Vec<&[u8]> = EmotionClass::ALL.into_iter().flat_map(action_unit_sets).copied().collect();
    let mut stream = key.stream("micro-expressions");
    let (least, most) = SECONDS_BETWEEN_MICRO_EXPRESSIONS;
    let mut pause = || (stream.uniform(least, most) * frames_per_second) as usize;
    let mut all = Vec::new();
    let mut onset = pause();
    for number in 0.. {
        // A model without such units shows none.
        let drawn = MicroExpression::random(model, &sets, key.frame(number), onset, frames_per_second);
        let Some(shown) = drawn.ok().filter(|shown| shown.offset <= pairs as usize) else { break };
        onset = shown.offset + pause();
        all.push(shown);
    }
    all
}

/// Adds a micro-expression at `frame` to a moment.
fn add(model: &HeadModel, moment: &mut Moment, micro_expression: &MicroExpression, frame: u32) {
    let units = micro_expression.action_units_at(frame as usize);
    // The units are the model's own.
    let Ok(added) = model.pose_of_action_units(&units) else { return };
    if units.is_empty() {
        return;
    }
    for (weight, added) in moment.pose.expressions.iter_mut().zip(added.expressions) {
        *weight = (*weight + added).clamp(-1.0, 1.0);
    }
    for (joint, added) in added.joints.into_iter().enumerate() {
        let rotation = moment.pose.joint_mut(joint);
        *rotation = (*rotation * added).normalize();
    }
    for (number, side, intensity) in units {
        add_unit(&mut moment.action_units, number, side, intensity);
    }
}

/// From camera 9 past random cameras of the rig and back.
fn camera_path(stream: &mut Stream, pairs: u32, pace: Pace) -> Path<3> {
    let views: Vec<View> = Rig::views().map(|(_, view)| view).collect();
    let points = (0..stops(stream, pairs, pace)).map(|_| {
        let view = views[stream.below(views.len() as u32) as usize];
        [view.azimuth, view.elevation, f64::from(stream.uniform(-CAMERA_ROLL, CAMERA_ROLL))]
    });
    let points: Vec<[f64; 3]> = points.collect();
    from_rest_to_rest(points, pairs, speed(stream, CAMERA_SPEEDS, pace))
}

/// From the rest pose through random rotations and back.
fn subject_path(stream: &mut Stream, pairs: u32, pace: Pace) -> Path<3> {
    let points = (0..stops(stream, pairs, pace))
        .map(|_| SUBJECT_TURN.map(|reach| f64::from(stream.uniform(-reach, reach))))
        .collect();
    from_rest_to_rest(points, pairs, speed(stream, SUBJECT_SPEEDS, pace))
}

/// Number of points of a path between its ends.
fn stops(stream: &mut Stream, pairs: u32, pace: Pace) -> u32 {
    let most = ((pairs as f32 * pace.step()) as u32 / FRAMES_BETWEEN_VIEWS).max(1);
    let fewest = (most / 3).max(1);
    fewest + stream.below(most - fewest + 1)
}

/// Degrees per frame.
fn speed(stream: &mut Stream, bounds: (f32, f32), pace: Pace) -> f64 {
    f64::from(log_uniform(stream, bounds) * pace.step())
}

fn log_uniform(stream: &mut Stream, (least, most): (f32, f32)) -> f32 {
    least * libm::powf(most / least, stream.unit())
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
        let pace = Pace::default();
        for scene in 0..40 {
            for pairs in [1, 2, 4, 39, 413] {
                let stream = || Key::new(5).scene(scene).stream("test");
                let (camera, subject) =
                    (camera_path(&mut stream(), pairs, pace), subject_path(&mut stream(), pairs, pace));
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
            let path = camera_path(&mut Key::new(5).scene(scene).stream("test"), 413, Pace::default());
            (0..=413).map(|frame| path.at(f64::from(frame) / 413.0)[0].abs()).fold(0.0, f64::max)
        };
        let angles: Vec<f64> = (0..27).map(widest).collect();
        assert!(angles.iter().filter(|angle| **angle > 15.0).count() > 9, "{angles:?}");
        assert!(angles.iter().all(|angle| *angle < 70.0), "{angles:?}");
    }

    #[test]
    fn the_shares_of_small_and_large_motion_are_as_documented() {
        let paces: Vec<Pace> = (0..2000).map(|scene| Pace::random(Key::new(1).scene(scene))).collect();
        let share = |wanted: fn(&Pace) -> bool| {
            paces.iter().filter(|pace| wanted(pace)).count() as f32 / paces.len() as f32
        };
        assert!((share(|pace| pace.step() < 0.5) - 0.4).abs() < 0.04);
        assert!((share(|pace| pace.step() > 1.0) - 0.4).abs() < 0.04);
        assert!((share(|pace| pace.strength < 1.0) - CALM_SHARE).abs() < 0.04);
        let (least, most) = FRAME_RATES;
        assert!(paces.iter().all(|pace| (least..=most).contains(&pace.frames_per_second)));
    }

    #[test]
    fn micro_expressions_follow_each_other_and_are_added() {
        let model = HeadModel::builtin(1);
        for (pairs, rate) in [(400, 200.0), (100, 24.0), (60, 6.0)] {
            let shown = micro_expressions(&model, Key::new(4), pairs, rate);
            assert!(!shown.is_empty() && shown.last().unwrap().offset <= pairs as usize);
            assert!(shown.windows(2).all(|both| both[0].offset <= both[1].onset));
            let pose = HeadPose { expressions: vec![0.0; model.expressions.len()], ..HeadPose::default() };
            let rest = Moment { pose, action_units: Vec::new(), gaze: [0.0; 2] };
            for one in &shown {
                let mut moment = rest.clone();
                add(&model, &mut moment, one, one.apex as u32);
                assert_eq!(moment.action_units, one.action_units);
                assert!(moment.pose != rest.pose);
                add(&model, &mut moment, one, one.offset as u32);
                assert_eq!(moment.action_units, one.action_units);
            }
        }
        assert!(micro_expressions(&model, Key::new(4), 1, 200.0).is_empty());
    }
}
