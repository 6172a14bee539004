//! What a model says about a clip.

use std::fmt;

use serde::Serialize;

/// What a model says about a clip.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Recognition {
    /// By class.
    pub probabilities: Vec<f64>,
    /// Number of the most probable class.
    pub class: usize,
    /// Why its class is no answer; `None` where it is one.
    pub doubt: Option<Doubt>,
}

/// Why a model does not know.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Doubt {
    /// The most probable class is less probable than was asked for.
    Improbable,
    /// The face moves less than in any clip that the model was trained on. In pixels of the feature map.
    Still { motion_px: f64, least_px: f64 },
    /// The face moves further than in any clip that the model was trained on. In pixels of the feature map.
    Far { motion_px: f64, most_px: f64 },
    /// The pattern of motion is unlike those of the clips that the model was trained on: so much of it they do not explain, 0 to 1.
    Unlike { unexplained: f64, most: f64 },
    /// The face is smaller than in any clip that the model was trained on.
    Small { face_px: usize, least_px: usize },
}

impl fmt::Display for Doubt {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Improbable => f.write_str("no class is probable enough"),
            Self::Still { motion_px, least_px } => {
                write!(f, "moves less ({motion_px:.2} px of 112) than the model's clips ({least_px:.2})")
            }
            Self::Far { motion_px, most_px } => {
                write!(f, "moves further ({motion_px:.2} px of 112) than the model's clips ({most_px:.2})")
            }
            Self::Unlike { unexplained, most } => {
                write!(
                    f,
                    "moves unlike the model's clips ({:.0} % unexplained, at most {:.0})",
                    100.0 * unexplained,
                    100.0 * most
                )
            }
            Self::Small { face_px, least_px } => {
                write!(f, "face of {face_px} px is smaller than those of the model's clips ({least_px} px)")
            }
        }
    }
}
