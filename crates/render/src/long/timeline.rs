//! What happens in a long video.

use srflow_avatar::{Avatar, PosedHead};
use srflow_core::random::Key;
use srflow_data::micro_expression::EmotionClass;
use srflow_data::micro_expression::intervals::{ExpressionKind, Interval};
use srflow_head::motion::{Speech, available_units, quintic};
use srflow_head::{HeadModel, HeadModelError, HeadPose, MicroExpression, Side};
use srflow_splat::{Camera, Gaussians};

use super::settings::LongSettings;
use crate::action_units::{action_unit_sets, coded_units};
use crate::distractors::{Distractors, Strengths};
use crate::generate::SmoothPath;
use crate::recording::Light;
use crate::synth::portrait::{camera, drift, landmarks_in_image, move_head};

/// Maximum rotation (yaw, pitch, roll in degrees) and translation (metres) of the head, at drift 1.
const DRIFT_DEGREES: [f32; 3] = [1.5, 1.0, 0.8];
const DRIFT_METRES: f32 = 0.002;

/// Seconds between control points of the head's motion.
const DRIFT_KNOT_SECONDS: f32 = 1.2;

/// A macro-expression is so many times stronger than a micro-expression of intensity 1.
const MACRO_STRENGTH: f32 = 2.5;

/// One subject's video.
pub struct Video {
    pub name: String,
    pub timeline: Timeline,
    pub camera: Camera,
    pub light: Light,
    pub key: Key,
    /// dlib's 68 points in the first frame, in pixels.
    pub landmarks: Vec<[f64; 2]>,
    pub avatar: Avatar,
}

impl Video {
    pub fn new(
        name: String,
        avatar: Avatar,
        settings: &LongSettings,
        subject: u32,
        frames: u32,
    ) -> Result<Self, HeadModelError> {
        let key = Key::new(settings.seed).scene(subject);
        let camera = camera(&avatar, settings.side, &mut key.stream("framing"));
        let light = Light::random(key, settings.lighting);
        let timeline = Timeline::random(avatar.model(), settings, key, frames)?;
        let mut video = Self { name, timeline, camera, light, key, landmarks: Vec::new(), avatar };
        let mut head = PosedHead::default();
        video.gaussians(1, &mut head, &mut Gaussians::default())?;
        video.landmarks = landmarks_in_image(&video.avatar, &head, &video.camera);
        Ok(video)
    }

    /// Writes the Gaussians of a frame, from 1, into `out`.
    pub fn gaussians(
        &self,
        frame: u32,
        head: &mut PosedHead,
        out: &mut Gaussians,
    ) -> Result<(), HeadModelError> {
        let pose = self.timeline.pose(self.avatar.model(), frame)?;
        self.avatar.gaussians_into(&pose, head, out);
        Ok(())
    }
}

/// The events of a video, the motion of its head and what disturbs.
pub struct Timeline {
    events: Vec<Event>,
    distractors: Distractors,
    speech: Speech,
    head: SmoothPath<6>,
    available: Vec<(u8, Side)>,
    settings: LongSettings,
    frames: u32,
}

/// An expression or a sentence. Frames count from 1; at the first and the last one the face is at rest.
struct Event {
    what: What,
    units: Vec<(u8, Side, f32)>,
    onset: u32,
    /// The first and the last frame of full strength.
    peak: [u32; 2],
    offset: u32,
}

#[derive(Debug, Clone, Copy, PartialEq)]
enum What {
    Expression(ExpressionKind, EmotionClass),
    Sentence,
}

impl Event {
    fn strength(&self, frame: u32) -> f32 {
        let ramp = |from: u32, to: u32| (frame as f32 - from as f32) / (to as f32 - from as f32);
        let [first, last] = self.peak;
        quintic(ramp(self.onset, first)) * quintic(ramp(self.offset, last))
    }
}

impl Timeline {
    fn random(
        model: &HeadModel,
        settings: &LongSettings,
        key: Key,
        frames: u32,
    ) -> Result<Self, HeadModelError> {
        let seconds = frames as f32 / settings.fps;
        let LongSettings { blinks, glances, gestures, .. } = *settings;
        let strengths = Strengths { blinks, glances, gestures };
        let points = (seconds / DRIFT_KNOT_SECONDS).ceil().clamp(1.0, 1e5) as usize + 1;
        Ok(Self {
            events: events(model, settings, key, frames)?,
            distractors: Distractors::random(key, seconds, strengths),
            speech: Speech::random(key, seconds, settings.look),
            head: drift(&mut key.stream("drift"), points, DRIFT_DEGREES, DRIFT_METRES, settings.drift),
            available: available_units(model),
            settings: settings.clone(),
            frames,
        })
    }

    fn pose(&self, model: &HeadModel, frame: u32) -> Result<HeadPose, HeadModelError> {
        let LongSettings { fps, speech, .. } = self.settings;
        let time = (frame - 1) as f32 / fps;
        let mut units = Vec::new();
        for event in &self.events {
            let strength = event.strength(frame);
            if strength > 0.0 {
                let shown = match event.what {
                    What::Sentence => self.speech.units_at(&self.available, time, strength * speech),
                    What::Expression(..) => event
                        .units
                        .iter()
                        .map(|&(number, side, full)| (number, side, full * strength))
                        .collect(),
                };
                units.extend(shown);
            }
        }
        let mut pose = self.distractors.pose(model, units, time)?;
        move_head(&mut pose, self.head.at(f64::from(frame - 1) / f64::from(self.frames)));
        Ok(pose)
    }

    /// The truth of spotting.
    pub fn intervals(&self, video: &str) -> impl Iterator<Item = Interval> {
        self.events.iter().filter_map(move |event| match event.what {
            What::Sentence => None,
            What::Expression(kind, class) => Some(Interval {
                video: video.to_owned(),
                kind,
                onset: event.onset.into(),
                apex: Some(event.peak[0].into()),
                offset: event.offset.into(),
                label: class.name().to_owned(),
                action_units: coded_units(&event.units),
            }),
        })
    }

    /// What else happens, with its first and last frame.
    pub fn disturbances(&self) -> Vec<(&'static str, [u32; 2])> {
        let LongSettings { fps, speech, .. } = self.settings;
        let frame = |second: f32| 1 + (second * fps) as u32;
        let besides = self
            .distractors
            .spans()
            .map(|(what, span)| (what, span.map(|second| frame(second).min(self.frames))));
        let spoken = self.events.iter().filter(|event| speech > 0.0 && event.what == What::Sentence);
        besides.chain(spoken.map(|event| ("speech", [event.onset, event.offset]))).collect()
    }
}

/// Expressions and sentences, one after another with pauses of 1.5 to 6 seconds: half of them are micro-expressions.
fn events(
    model: &HeadModel,
    settings: &LongSettings,
    key: Key,
    frames: u32,
) -> Result<Vec<Event>, HeadModelError> {
    let fps = settings.fps;
    let count = |seconds: f32| ((seconds * fps) as u32).max(1);
    let mut stream = key.stream("events");
    let mut events = Vec::new();
    let mut onset = count(stream.uniform(1.0, 3.0));
    loop {
        let kind = stream.unit();
        let class = EmotionClass::ALL[stream.below(3) as usize];
        let drawn = |onset: u32| {
            let key = key.frame(events.len() as u32);
            MicroExpression::random(model, action_unit_sets(class), key, onset as usize, fps)
        };
        let strong = |units: Vec<(u8, Side, f32)>, factor: f32| -> Vec<(u8, Side, f32)> {
            units
                .into_iter()
                .map(|(number, side, full)| (number, side, (full * factor).clamp(0.0, 1.0)))
                .collect()
        };
        let event = if kind < 0.5 {
            let MicroExpression { action_units, apex, offset, .. } = drawn(onset)?;
            let [apex, offset] = [apex, offset].map(|frame| frame as u32);
            Event {
                what: What::Expression(ExpressionKind::Micro, class),
                units: strong(action_units, settings.intensity),
                onset,
                peak: [apex; 2],
                offset,
            }
        } else {
            let sentence = kind >= 0.75;
            let rise = onset + count(stream.uniform(0.3, 0.7));
            let hold = if sentence { stream.uniform(0.8, 2.0) } else { stream.uniform(0.2, 1.5) };
            let held = rise + count(hold);
            let offset = held + count(stream.uniform(0.3, 0.8));
            Event {
                what: match sentence {
                    true => What::Sentence,
                    false => What::Expression(ExpressionKind::Macro, class),
                },
                units: if sentence { Vec::new() } else { strong(drawn(onset)?.action_units, MACRO_STRENGTH) },
                onset,
                peak: [rise, held],
                offset,
            }
        };
        if event.offset >= frames {
            return Ok(events);
        }
        onset = event.offset + count(stream.uniform(1.5, 6.0));
        events.push(event);
    }
}
