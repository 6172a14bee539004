//! The mouth of a person who speaks.

use srflow_core::random::{Key, Stream};

use super::curve::Curve;
use super::quintic;
use crate::{Look, Side};

/// How jaw and lips move while a person speaks.
#[derive(Debug, Clone)]
pub struct Speech(Voice);

#[derive(Debug, Clone)]
enum Voice {
    /// The jaw, and width and rounding of the lips; of heads of the first look.
    Curves([Curve; 3]),
    /// One sound after the other.
    Sounds(Vec<Sound>),
}

/// A sound, and what the mouth does for it at its middle.
#[derive(Debug, Clone, Copy)]
struct Sound {
    start: f32,
    seconds: f32,
    viseme: Viseme,
}

/// Action units at the middle of a sound.
type Viseme = &'static [(u8, f32)];

/// What the mouth does for vowels, after the classes of MPEG-4 (ISO/IEC 14496-2, table of visemes): as in far, bed, see, coat, food. Each with
/// how often it comes.
const VOWELS: [(Viseme, f32); 5] = [
    (&[(25, 0.8), (26, 0.7)], 0.27),
    (&[(25, 0.75), (26, 0.4), (20, 0.25), (16, 0.3)], 0.27),
    (&[(25, 0.6), (26, 0.15), (20, 0.45), (10, 0.15)], 0.24),
    (&[(25, 0.55), (26, 0.35), (18, 0.55)], 0.12),
    (&[(25, 0.3), (26, 0.12), (18, 0.9)], 0.10),
];

/// And for consonants: put and mill, far, think and doll, call, chair, sir, red.
const CONSONANTS: [(Viseme, f32); 7] = [
    (&[(24, 0.45), (17, 0.15)], 0.16),
    (&[(25, 0.2), (26, 0.08), (17, 0.35), (10, 0.2)], 0.07),
    (&[(25, 0.45), (26, 0.2), (16, 0.25)], 0.32),
    (&[(25, 0.45), (26, 0.28)], 0.11),
    (&[(25, 0.4), (26, 0.1), (18, 0.5), (10, 0.2)], 0.05),
    (&[(25, 0.35), (26, 0.06), (20, 0.3), (16, 0.2)], 0.17),
    (&[(25, 0.4), (26, 0.15), (18, 0.35)], 0.12),
];

/// Between words, the lips nearly meet.
const PAUSE: Viseme = &[(25, 0.1)];

/// A sound forms the mouth for so many seconds before it begins and after it ends.
const COARTICULATION_SECONDS: f32 = 0.06;

impl Speech {
    /// About four syllables a second, without an end.
    pub fn random(key: Key, seconds: f32, look: Look) -> Self {
        if look < Look::Second {
            let curve = |purpose: &str, knot_seconds: f32| {
                Curve::random(&mut key.stream(purpose), seconds, knot_seconds, 1.0)
            };
            return Self(Voice::Curves([
                curve("speech jaw", 0.13),
                curve("speech width", 0.19),
                curve("speech lips", 0.16),
            ]));
        }
        let mut stream = key.stream("speech sounds");
        let mut sounds = Vec::new();
        let mut start = 0.0;
        while start < seconds {
            for (viseme, seconds) in word(&mut stream) {
                sounds.push(Sound { start, seconds, viseme });
                start += seconds;
            }
        }
        Self(Voice::Sounds(sounds))
    }

    /// Action units at a time, of those that a model has; `loudness` multiplies them.
    pub fn units_at(&self, available: &[(u8, Side)], time: f32, loudness: f32) -> Vec<(u8, Side, f32)> {
        let units = match &self.0 {
            Voice::Curves(curves) => spoken_by_curves(curves, time),
            Voice::Sounds(sounds) => spoken_by_sounds(sounds, time),
        };
        let sided = |(number, strength): (u8, [f32; 2])| {
            let sides = available.iter().filter(move |(n, _)| *n == number);
            let [weight, factor] = strength;
            sides.map(move |&(n, side)| (n, side, weight * loudness * factor)).collect::<Vec<_>>()
        };
        units.into_iter().flat_map(sided).collect()
    }
}

/// One to three syllables and the pause after them, with their durations in seconds.
fn word(stream: &mut Stream) -> Vec<(Viseme, f32)> {
    let mut sounds = Vec::new();
    for _ in 0..=stream.below(3) {
        if stream.unit() < 0.85 {
            sounds.push((draw(stream, &CONSONANTS), stream.uniform(0.05, 0.10)));
        }
        sounds.push((draw(stream, &VOWELS), stream.uniform(0.07, 0.16)));
        if stream.unit() < 0.4 {
            sounds.push((draw(stream, &CONSONANTS), stream.uniform(0.05, 0.10)));
        }
    }
    if stream.unit() < 0.3 {
        sounds.push((PAUSE, stream.uniform(0.08, 0.25)));
    }
    sounds
}

/// One of several, by their frequencies, whose sum is 1.
fn draw(stream: &mut Stream, visemes: &[(Viseme, f32)]) -> Viseme {
    let mut left = stream.unit();
    let drawn = visemes.iter().find(|(_, frequency)| {
        left -= frequency;
        left < 0.0
    });
    drawn.unwrap_or(&visemes[0]).0
}

/// Units as a weight and a factor: [`Speech::units_at`] multiplies in an order that keeps the bits of datasets of the first look.
fn spoken_by_curves(curves: &[Curve; 3], time: f32) -> Vec<(u8, [f32; 2])> {
    const SPEECH: [(u8, f32, usize); 7] =
        [(25, 0.8, 0), (26, 0.55, 0), (20, 0.3, 1), (10, 0.25, 1), (16, 0.35, 1), (18, 0.5, 2), (17, 0.3, 2)];
    let at = |curve: &Curve| (curve.at(time) * 0.9 + 0.45).clamp(0.0, 1.0);
    SPEECH.map(|(number, weight, curve)| (number, [weight, at(&curves[curve])])).to_vec()
}

/// The mean of the sounds around a time, weighted by how near they are.
fn spoken_by_sounds(sounds: &[Sound], time: f32) -> Vec<(u8, [f32; 2])> {
    let first = sounds.partition_point(|sound| sound.start + sound.seconds + COARTICULATION_SECONDS <= time);
    let near = sounds[first..].iter().take_while(|sound| sound.start - COARTICULATION_SECONDS < time);
    let weighted: Vec<(&Sound, f32)> = near.map(|sound| (sound, sound.weight_at(time))).collect();
    let all: f32 = weighted.iter().map(|(_, weight)| weight).sum();
    let mut units: Vec<(u8, [f32; 2])> = Vec::new();
    for (sound, weight) in weighted {
        for &(number, strength) in sound.viseme {
            let part = strength * weight / all.max(1e-6);
            match units.iter_mut().find(|unit| unit.0 == number) {
                Some(unit) => unit.1[0] += part,
                None => units.push((number, [part, 1.0])),
            }
        }
    }
    units
}

/// When a person speaks: sentences of one to three seconds, with pauses of one to four between.
#[derive(Debug, Clone, Default)]
pub struct Sentences {
    spans: Vec<[f32; 2]>,
}

/// A voice is at full loudness so many seconds after a sentence begins.
const RAMP_SECONDS: f32 = 0.15;

impl Sentences {
    pub fn random(key: Key, seconds: f32) -> Self {
        let mut stream = key.stream("sentences");
        let mut spans = Vec::new();
        let mut start = stream.uniform(0.0, 4.0);
        while start < seconds {
            let end = start + stream.uniform(1.0, 3.0);
            spans.push([start, end]);
            start = end + stream.uniform(1.0, 4.0);
        }
        Self { spans }
    }

    /// First and last second of every sentence.
    pub fn spans(&self) -> impl Iterator<Item = [f32; 2]> {
        self.spans.iter().copied()
    }

    /// `0..=1`.
    pub fn loudness_at(&self, time: f32) -> f32 {
        let spoken = self.spans.iter().find(|[first, last]| (*first..*last).contains(&time));
        spoken.map_or(0.0, |[first, last]| {
            quintic((time - first) / RAMP_SECONDS) * quintic((last - time) / RAMP_SECONDS)
        })
    }
}

impl Sound {
    /// 1 at the middle, 0 where the sound does not form the mouth yet or any more.
    fn weight_at(&self, time: f32) -> f32 {
        let half = self.seconds / 2.0 + COARTICULATION_SECONDS;
        let middle = self.start + self.seconds / 2.0;
        quintic(1.0 - (time - middle).abs() / half)
    }
}
