//! The mouth of a person who speaks.

use srflow_core::random::Key;

use super::curve::Curve;
use crate::Side;

/// How jaw and lips move while a person speaks.
#[derive(Debug, Clone)]
pub struct Speech {
    channels: [Curve; 3],
}

impl Speech {
    pub fn random(key: Key, seconds: f32) -> Self {
        let curve = |purpose: &str, knot_seconds: f32| {
            Curve::random(&mut key.stream(purpose), seconds, knot_seconds, 1.0)
        };
        Self {
            channels: [curve("speech jaw", 0.13), curve("speech width", 0.19), curve("speech lips", 0.16)],
        }
    }

    /// Opening of the jaw, and width and rounding of the lips, `0..=1`.
    pub(super) fn channels_at(&self, time: f32) -> [f32; 3] {
        [0, 1, 2].map(|channel| (self.channels[channel].at(time) * 0.9 + 0.45).clamp(0.0, 1.0))
    }

    /// Action units at a time, of those that a model has; `loudness` multiplies them.
    pub fn units_at(&self, available: &[(u8, Side)], time: f32, loudness: f32) -> Vec<(u8, Side, f32)> {
        let channels = self.channels_at(time);
        let spoken = |(number, side, weight)| (number, side, weight * loudness * channels[channel(number)]);
        speech_units(available).into_iter().map(spoken).collect()
    }
}

/// The channel that moves a unit: jaw, widened lips or rounded lips.
pub(super) fn channel(number: u8) -> usize {
    match number {
        25 | 26 => 0,
        20 | 10 | 16 => 1,
        _ => 2,
    }
}

pub(super) fn speech_units(available: &[(u8, Side)]) -> Vec<(u8, Side, f32)> {
    const SPEECH: [(u8, f32); 7] =
        [(25, 0.8), (26, 0.55), (20, 0.3), (10, 0.25), (16, 0.35), (18, 0.5), (17, 0.3)];
    let listed = |&(number, weight): &(u8, f32)| {
        let sides = available.iter().filter(move |(n, _)| *n == number);
        sides.map(move |&(n, side)| (n, side, weight)).collect::<Vec<_>>()
    };
    SPEECH.iter().flat_map(listed).collect()
}
