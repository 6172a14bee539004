//! MediaPipe's blend shapes of a face, graph `FaceBlendshapesGraph` of its face landmarker.

use crate::model::Model;
use crate::tflite::Network;

pub(crate) const MODEL: Model = Model {
    name: "face_blendshapes.tflite",
    folder: "face_landmarker",
    // Coordinates, and points.
    input: [2, 1, MESH_POINTS.len()],
    check,
};

/// How far a face shows each of [`BLEND_SHAPES`], 0 to 1.
pub type BlendShapes = [f32; BLEND_SHAPES.len()];

/// Names of the blend shapes. All but the first, which says nothing, are those of ARKit; left and right are the person's.
pub const BLEND_SHAPES: [&str; 52] = [
    "_neutral",
    "browDownLeft",
    "browDownRight",
    "browInnerUp",
    "browOuterUpLeft",
    "browOuterUpRight",
    "cheekPuff",
    "cheekSquintLeft",
    "cheekSquintRight",
    "eyeBlinkLeft",
    "eyeBlinkRight",
    "eyeLookDownLeft",
    "eyeLookDownRight",
    "eyeLookInLeft",
    "eyeLookInRight",
    "eyeLookOutLeft",
    "eyeLookOutRight",
    "eyeLookUpLeft",
    "eyeLookUpRight",
    "eyeSquintLeft",
    "eyeSquintRight",
    "eyeWideLeft",
    "eyeWideRight",
    "jawForward",
    "jawLeft",
    "jawOpen",
    "jawRight",
    "mouthClose",
    "mouthDimpleLeft",
    "mouthDimpleRight",
    "mouthFrownLeft",
    "mouthFrownRight",
    "mouthFunnel",
    "mouthLeft",
    "mouthLowerDownLeft",
    "mouthLowerDownRight",
    "mouthPressLeft",
    "mouthPressRight",
    "mouthPucker",
    "mouthRight",
    "mouthRollLower",
    "mouthRollUpper",
    "mouthShrugLower",
    "mouthShrugUpper",
    "mouthSmileLeft",
    "mouthSmileRight",
    "mouthStretchLeft",
    "mouthStretchRight",
    "mouthUpperUpLeft",
    "mouthUpperUpRight",
    "noseSneerLeft",
    "noseSneerRight",
];

/// Points of the mesh that the network sees.
#[rustfmt::skip]
const MESH_POINTS: [usize; 146] = [
    0, 1, 4, 5, 6, 7, 8, 10, 13, 14, 17, 21, 33, 37, 39, 40, 46, 52, 53, 54, 55, 58, 61, 63, 65, 66, 67, 70, 78, 80, 81, 82, 84, 87,
    88, 91, 93, 95, 103, 105, 107, 109, 127, 132, 133, 136, 144, 145, 146, 148, 149, 150, 152, 153, 154, 155, 157, 158, 159, 160, 161,
    162, 163, 168, 172, 173, 176, 178, 181, 185, 191, 195, 197, 234, 246, 249, 251, 263, 267, 269, 270, 276, 282, 283, 284, 285, 288,
    291, 293, 295, 296, 297, 300, 308, 310, 311, 312, 314, 317, 318, 321, 323, 324, 332, 334, 336, 338, 356, 361, 362, 365, 373, 374,
    375, 377, 378, 379, 380, 381, 382, 384, 385, 386, 387, 388, 389, 390, 397, 398, 400, 402, 405, 409, 415, 454, 466, 468, 469, 470,
    471, 472, 473, 474, 475, 476, 477,
];

fn check(network: &Network) -> Result<(), String> {
    match network.output_lens() {
        [shapes] if *shapes == BLEND_SHAPES.len() => Ok(()),
        lens => Err(format!("expected an output of {} numbers, found {lens:?}", BLEND_SHAPES.len())),
    }
}

/// The blend shapes of a mesh of 478 points, in pixels.
///
/// # Errors
/// When the mesh has fewer points, or the network does not fit together or computes something that is no number.
pub(crate) fn of_mesh(network: &Network, mesh: &[[f64; 2]]) -> Result<BlendShapes, String> {
    let coordinates =
        [0, 1].into_iter().flat_map(|axis| MESH_POINTS.map(|point| Some(mesh.get(point)?[axis] as f32)));
    let coordinates: Option<Vec<f32>> = coordinates.collect();
    let coordinates =
        coordinates.ok_or_else(|| format!("expected a mesh of 478 points, found {}", mesh.len()))?;
    let shapes = network.run(&coordinates)?.into_iter().next().unwrap_or_default();
    match BlendShapes::try_from(shapes) {
        Ok(shapes) if shapes.iter().all(|shape| shape.is_finite()) => Ok(shapes),
        _ => Err(format!("expected {} finite numbers", BLEND_SHAPES.len())),
    }
}
