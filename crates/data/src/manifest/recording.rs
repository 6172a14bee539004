//! Imaging effects: what makes rendered frames look like recordings.

use serde::{Deserialize, Serialize};

use crate::clap::Args;

/// The imaging effects on the frames of a dataset. Each scene draws its own strength of every effect, up to the one given here; 0 and
/// `None` are no effect. Flow, alpha, mask, occlusion and depth stay those of the clean geometry.
#[derive(Args, Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
#[command(next_help_heading = "Frames like recordings")]
#[serde(default, deny_unknown_fields)]
pub struct Recording {
    /// Sensor noise, 0 to 50; at 1 a standard deviation of 0.9 levels of 255 in black, 1.8 in mid-grey and 2.3 in white
    #[arg(long, value_name = "F", default_value_t)]
    pub noise: f32,
    /// Exposure and white balance, 0 to 4; at 1 off by up to half a stop, with changes of 2 % within a scene
    ///
    /// At 1 a scene is up to half a stop too dark or too bright, its red up to 0.2 stops too strong or too weak and its blue the
    /// opposite. Within it the light changes by up to 2 %, its gradient over the frame by up to 1.2 % to each side, and red against
    /// blue by up to 1 %, all at 0.3 to 1.5 Hz.
    #[arg(long, value_name = "F", default_value_t)]
    pub lighting: f32,
    /// Share of the head's light from one to three lamps, 0 to 1
    ///
    /// A scene's is uniform from 0.3 times this. Light already in the head's colours stays; lamps cast no shadows.
    #[arg(long, value_name = "SHARE", default_value_t)]
    pub lamps: f32,
    /// Motion blur: share of the time between frames during which the shutter is open, 0 to 1, centred at the frame's time
    #[arg(long, value_name = "SHARE", default_value_t)]
    pub shutter: f32,
    /// Blur radius of a lens out of focus, 0 to 64 pixels
    #[arg(long, value_name = "PX", default_value_t)]
    pub defocus: f32,
    /// Minimum JPEG quality, 1 to 100; each scene draws one from here to 95, or uses this one if it is higher
    #[arg(long, value_name = "QUALITY")]
    #[serde(skip_serializing_if = "Option::is_none")]
    pub jpeg: Option<u8>,
}

impl Recording {
    /// Clean frames.
    pub fn none() -> Self {
        Self::default()
    }

    /// What a good training set has: the preset `wild`.
    pub fn wild() -> Self {
        Self { noise: 2.0, lighting: 1.0, lamps: 0.8, shutter: 0.8, defocus: 1.5, jpeg: Some(40) }
    }

    pub fn is_none(&self) -> bool {
        *self == Self::none()
    }
}
