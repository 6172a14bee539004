//! MediaPipe's selfie segmentation, graph `selfie_segmentation_cpu`.

use std::path::Path;

use srflow_core::resize::resize_linear;
use srflow_core::{Image, Plane};

use crate::model::{Model, Package};
use crate::region::{Beyond, Region};
use crate::tflite::Network;
use crate::{FaceError, ModelError};

/// The general network, which sees a square; `selfie_segmentation_landscape.tflite` is another.
const MODEL: Model = Model {
    name: "selfie_segmentation.tflite",
    folder: "selfie_segmentation",
    input: [3, SIDE, SIDE],
    check,
};
/// Side of input and output in pixels.
const SIDE: usize = 256;

/// Tells persons from their background.
#[derive(Debug, Clone)]
pub struct PersonMask {
    network: Network,
}

impl PersonMask {
    /// Reads the network from MediaPipe's package: its wheel, its folder, or any folder with `selfie_segmentation.tflite`.
    ///
    /// # Errors
    /// When the file is missing, damaged, or another network.
    pub fn read(path: &Path) -> Result<Self, FaceError> {
        Ok(Self { network: Package::open(path)?.read(&MODEL)? })
    }

    /// For each pixel of the frame the probability, 0 to 1, that it shows a person.
    ///
    /// As in MediaPipe, the network sees the frame at 256x256 pixels, and its mask is resized to the frame: edges are as coarse as
    /// that.
    ///
    /// # Errors
    /// When the network does not fit together, or computes something that is no probability.
    pub fn mask(&self, frame: &Image) -> Result<Plane, FaceError> {
        if frame.pixels().is_empty() {
            return Ok(Plane::new(frame.width(), frame.height()));
        }
        let failed = |problem: String| ModelError { path: MODEL.name.into(), problem };
        let seen = Region::stretched(frame).planes(frame, [SIDE, SIDE], [0.0, 1.0], Beyond::Black);
        let probabilities = self.network.run(&seen).map_err(failed)?.into_iter().next().unwrap_or_default();
        if let Some(found) = probabilities.iter().find(|share| !(0.0..=1.0).contains(*share)) {
            return Err(failed(format!("expected probabilities from 0 to 1, found {found}")).into());
        }
        let found = probabilities.len();
        let mask = Plane::from_pixels(SIDE, SIDE, probabilities)
            .map_err(|_| failed(format!("expected a mask of {SIDE}x{SIDE} pixels, found {found} numbers")))?;
        Ok(resize_linear(&mask, frame.size(), 1.0))
    }
}

fn check(network: &Network) -> Result<(), String> {
    match network.output_lens() {
        [pixels] if *pixels == SIDE * SIDE => Ok(()),
        lens => Err(format!("expected an output of {} numbers, found {lens:?}", SIDE * SIDE)),
    }
}
