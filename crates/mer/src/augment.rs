//! Changed copies of training clips: more to learn from, and no side or angle to learn by heart.

use srflow_core::random::Stream;
use srflow_core::{named, serialize_as_text};

use crate::features::Features;

/// How training clips are changed.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Augment {
    /// They are not.
    #[default]
    None,
    /// They are mirrored: networks see every second clip so, `linear` sees both.
    Mirror,
    /// They are mirrored and rotated: networks by up to 10 degrees, `linear` sees each also rotated by 5 degrees to both sides.
    MirrorRotate,
}

named!(Augment, "a way to change training clips", { None => "none", Mirror => "mirror", MirrorRotate => "mirror-rotate" });
serialize_as_text!(Augment);

/// The most that a clip is rotated at random, in degrees.
const LARGEST_ANGLE: f32 = 10.0;

/// The angles of fixed copies, in degrees: about as far from 0 as random ones are on average.
const FIXED_ANGLES: [f32; 2] = [-5.0, 5.0];

impl Augment {
    /// A clip as it is seen once; `None` where it is as it was.
    pub(crate) fn drawn(self, features: &Features, stream: &mut Stream) -> Option<Features> {
        if self == Self::None {
            return None;
        }
        let mirrored = (stream.below(2) == 1).then(|| features.mirrored());
        if self == Self::Mirror {
            return mirrored;
        }
        let angle = stream.uniform(-LARGEST_ANGLE, LARGEST_ANGLE);
        Some(mirrored.as_ref().unwrap_or(features).rotated(angle))
    }

    /// The clips that are learned from beside a clip, where each is seen once.
    pub(crate) fn copies(self, features: &Features) -> Vec<Features> {
        if self == Self::None {
            return Vec::new();
        }
        let mut copies = vec![features.mirrored()];
        if self == Self::MirrorRotate {
            let rotated = |features: &Features| FIXED_ANGLES.map(|angle| features.rotated(angle));
            copies.extend([rotated(features), rotated(&copies[0])].into_iter().flatten());
        }
        copies
    }
}
