//! Imaging effects: what makes rendered frames look like recordings.

use serde::{Deserialize, Serialize};

/// The imaging effects on the frames of a dataset. Each scene draws its own camera within these bounds; 0 and `None` are no
/// effect. Flow, alpha, mask, occlusion and depth stay those of the clean geometry.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Recording {
    /// Greatest strength of sensor noise, 0 to 50: 1 is a standard deviation of 0.9 levels of 255 in black, 1.8 in mid-grey and
    /// 2.3 in white. A scene's is uniform from 0.
    #[serde(default)]
    pub noise: f32,
    /// Strength of light, 0 to 4. At 1 a scene is up to half a stop too dark or too bright, its red up to 0.2 stops too strong or
    /// too weak and its blue the opposite. Within it the light changes by up to 2 %, its gradient over the frame by up to 1.2 % to
    /// each side, and red against blue by up to 1 %, all at 0.3 to 1.5 Hz.
    #[serde(default)]
    pub lighting: f32,
    /// Greatest share, 0 to 1, of the light on the head that comes from one to three lamps around it, rather than evenly from all
    /// sides. A scene's is uniform from 0.3 times this. Light already in the head's colours stays; no shadows are cast.
    #[serde(default)]
    pub lamps: f32,
    /// Greatest share, 0 to 1, of the time between frames during which the shutter is open, centred at the frame's time. A scene's
    /// is uniform from 0.
    #[serde(default)]
    pub shutter: f32,
    /// Greatest radius in pixels, 0 to 64, of the disc over which a lens out of focus spreads a point. A scene's is uniform from 0.
    #[serde(default)]
    pub defocus: f32,
    /// Least quality of JPEG compression, 1 to 100. A scene's is uniform from here to 95, or this one if it is higher.
    #[serde(default, skip_serializing_if = "Option::is_none")]
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
