use std::path::PathBuf;

use srflow_core::{Size, printable};
use srflow_files::FileError;

use crate::FaceBox;

/// Why a face could not be found or cropped.
#[derive(Debug, thiserror::Error)]
pub enum FaceError {
    /// A file could not be read or written.
    #[error(transparent)]
    File(#[from] FileError),
    /// The landmarks cannot be read.
    #[error("{}: {reason}", printable(&.path.to_string_lossy()))]
    Landmarks {
        path: PathBuf,
        /// What was expected, and what was found.
        reason: String,
    },
    /// The file of landmarks has no row for a face.
    #[error("{}: no landmarks of {of}; add a row for it", printable(&.path.to_string_lossy()))]
    NoLandmarks {
        path: PathBuf,
        /// Of which clip or pair.
        of: String,
    },
    /// An eye is far outside the frame: the landmarks are those of another frame, or wrong.
    #[error(
        "the landmarks put an eye at ({:.0}, {:.0}), far outside of the frame of {frame} (WIDTHxHEIGHT); mend \
         their row or leave it out", .eye[0], .eye[1]
    )]
    FarOutside {
        /// The eye in pixels.
        eye: [f64; 2],
        frame: Size,
    },
    /// The box is not inside the frame.
    #[error("the box {face} does not lie in a frame of {frame} (WIDTHxHEIGHT)")]
    Outside { face: FaceBox, frame: Size },
    /// The detector finds nothing.
    #[error(
        "no face is found; the detector sees faces that are turned by less than about 60 degrees and take at least a \
         fifteenth of the frame's shorter side: crop the frame around the face (`face_box`), or give landmarks (`landmarks`)"
    )]
    NoFace,
    /// The detector finds several faces, and none was chosen.
    #[error("{} faces are found, from left to right: {}; choose one by `face_index` 1 to {}", .boxes.len(), listed(.boxes), .boxes.len())]
    Several {
        /// From left to right.
        boxes: Vec<FaceBox>,
    },
    /// The chosen face is not there.
    #[error("`face_index` {index}: expected 1 to {found}, the number of faces that are found")]
    NoSuchFace {
        /// From 1.
        index: usize,
        found: usize,
    },
    /// The networks cannot be used.
    #[error(transparent)]
    Model(#[from] ModelError),
}

fn listed(boxes: &[FaceBox]) -> String {
    boxes.iter().map(FaceBox::to_string).collect::<Vec<_>>().join(" ")
}

/// Why a file with a network of MediaPipe's cannot be used.
#[derive(Debug, thiserror::Error)]
#[error("{}: {problem}", printable(&.path.to_string_lossy()))]
pub struct ModelError {
    pub path: PathBuf,
    /// What was expected, what was found, and what to do.
    pub problem: String,
}
