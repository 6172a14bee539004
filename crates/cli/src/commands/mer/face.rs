//! Arguments for cutting out the face.

use std::path::PathBuf;

use clap::Args;
use srflow_mer::{FaceBox, FaceCrop, Landmarks};

/// How faces are cut out; by default, frames are used whole.
#[derive(Args, Debug, Clone, Default)]
pub struct FaceArgs {
    /// Crop every frame to this box: LEFT,TOP,WIDTHxHEIGHT in pixels
    #[arg(long, value_name = "BOX", conflicts_with = "landmarks")]
    face_box: Option<FaceBox>,
    /// Align faces by the landmarks in this CSV file (dlib's 68 points or the eyes; see docs/mer.md)
    #[arg(long, value_name = "FILE")]
    landmarks: Option<PathBuf>,
}

impl FaceArgs {
    /// The face region that the arguments describe.
    ///
    /// # Errors
    /// When the landmarks cannot be read.
    pub fn crop(&self) -> anyhow::Result<FaceCrop> {
        Ok(match (&self.landmarks, self.face_box) {
            (Some(path), _) => FaceCrop::Landmarks(Landmarks::read(path)?),
            (None, Some(face)) => FaceCrop::Fixed(face),
            (None, None) => FaceCrop::Whole,
        })
    }
}
