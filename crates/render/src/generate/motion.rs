//! The motion of the subjects: random curves, or recorded parameters.

use std::fmt;
use std::path::PathBuf;
use std::str::FromStr;

use srflow_avatar::Avatar;
use srflow_avatar::capture::Capture;
use srflow_head::{Clip, HeadParameters, PoseParameters};

use crate::RenderError;
use crate::error::require;

/// Frame rate of the motion. NeRSemble records 73 frames per second, at which expressions hardly move between frames.
pub(super) const FRAMES_PER_SECOND: f32 = 24.0;

/// Where the motion of the subjects comes from.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub enum MotionSource {
    /// Random expressions, speech, blinks, gaze and turns, of each scene its own.
    #[default]
    Curves,
    /// As curves, with micro-expressions in between, at frame rates from 6 to 200 per second, and in one scene of three hardly
    /// anything else: small and large motion.
    Mixed,
    /// The motion that an avatar was trained on, which is in its files.
    Own,
    /// A file of parameters (`flame_param.npz`), the folder of a capture, or a clip of a glTF file ([`Clip`]), of the same kind of head.
    Recorded(PathBuf),
}

impl MotionSource {
    /// Whether it is in files, an avatar's own or others.
    pub(crate) fn is_of_files(&self) -> bool {
        matches!(self, Self::Own | Self::Recorded(_))
    }

    fn clip(&self) -> Option<Clip> {
        let Self::Recorded(path) = self else { return None };
        Clip::parse(path)
    }

    /// The recorded poses for `avatar`; `None` for random motion.
    ///
    /// # Errors
    /// When the file cannot be read, is of another kind of head, or the avatar has no motion of its own.
    pub fn poses(&self, avatar: &Avatar) -> Result<Option<Vec<PoseParameters>>, RenderError> {
        self.poses_of(self.read()?, avatar)
    }

    /// The recorded parameters; `None` for motion that is not in files of its own, or in one that names its parts as the head does.
    ///
    /// # Errors
    /// When the file cannot be read.
    pub fn read(&self) -> Result<Option<HeadParameters>, RenderError> {
        let Self::Recorded(path) = self else { return Ok(None) };
        if self.clip().is_some() {
            return Ok(None);
        }
        Ok(Some(if path.is_dir() { Capture::read(path)?.parameters()? } else { HeadParameters::read(path)? }))
    }

    /// As [`MotionSource::poses`], with the parameters that [`MotionSource::read`] returned.
    ///
    /// # Errors
    /// When they are of another kind of head, or the avatar has no motion of its own.
    pub fn poses_of(
        &self,
        recorded: Option<HeadParameters>,
        avatar: &Avatar,
    ) -> Result<Option<Vec<PoseParameters>>, RenderError> {
        let parameters = match self {
            Self::Own => {
                let motion = avatar.own_motion().to_vec();
                let expected = "curves or a file for this head: only the avatars of `head` avatar:DIR have a motion of their \
                                own";
                require("motion", "own", expected, !motion.is_empty())?;
                return Ok(Some(motion));
            }
            Self::Curves | Self::Mixed | Self::Recorded(_) => match (recorded, self.clip()) {
                (Some(parameters), _) => parameters,
                (None, Some(clip)) => return Ok(Some(clip.poses(avatar.model(), FRAMES_PER_SECOND)?)),
                (None, None) => return Ok(None),
            },
        };
        // The identity stays the avatar's: only the motion is of another.
        let motion = HeadParameters { poses: parameters.poses, ..HeadParameters::default() };
        motion.check(avatar.model()).or_else(|error| {
            let expected = format!("the motion of the same kind of head ({error})");
            require("motion", self, expected, false)
        })?;
        Ok(Some(motion.poses))
    }
}

impl FromStr for MotionSource {
    type Err = std::convert::Infallible;

    fn from_str(text: &str) -> Result<Self, Self::Err> {
        Ok(match text {
            "curves" => Self::Curves,
            "mixed" => Self::Mixed,
            "own" => Self::Own,
            path => Self::Recorded(path.into()),
        })
    }
}

impl fmt::Display for MotionSource {
    /// As [`MotionSource::from_str`] reads it.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Curves => f.pad("curves"),
            Self::Mixed => f.pad("mixed"),
            Self::Own => f.pad("own"),
            Self::Recorded(path) => path.display().fmt(f),
        }
    }
}

srflow_core::serialize_as_text!(MotionSource);
