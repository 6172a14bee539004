//! Faces in frames: found with MediaPipe's networks, which the user brings, or given as landmarks in a table; and crops that hold a face
//! upright.
//!
//! MediaPipe's short-range detector (BlazeFace, Bazarevsky et al. 2019) finds faces and six of their points; its face mesh (Kartynnik
//! et al. 2019) finds 468 points in each. Both come as TFLite files in the package `mediapipe` 0.10.5 to 0.10.21 (Apache-2.0), and are
//! computed here as MediaPipe's graphs `face_detection_short_range` and `face_landmark_front_cpu` do for single images. So is its selfie
//! segmentation, graph `selfie_segmentation_cpu`, which tells persons from their background. The newer networks of MediaPipe's face
//! landmarker are in `face_landmarker.task`: they find 478 points, with the irises, and 52 blend shapes.

mod average;
mod blendshapes;
mod crop;
mod detector;
mod error;
mod finder;
mod mesh;
mod model;
mod person;
mod points;
mod region;
mod table;
mod tflite;

pub use average::AVERAGE_FACE;
pub use blendshapes::{BLEND_SHAPES, BlendShapes};
pub use crop::{FaceBox, FrameCrop};
pub use error::{FaceError, ModelError};
pub use finder::{Face, FaceFinder};
pub use model::MODEL_SOURCES;
pub use person::PersonMask;
pub use points::FacePoints;
pub use table::{LandmarkRow, LandmarkTable, write_landmarks};
