//! MediaPipe's face mesh: graph `face_landmark_front_cpu`, and that of its face landmarker, `FaceLandmarksDetectorGraph`.

use srflow_core::Image;

use crate::region::{Beyond, Region};
use crate::tflite::Network;

/// Probability that the region shows a face, above which it does.
const LEAST_PRESENCE: f32 = 0.5;

/// Checks that a network is the face mesh of so many points.
///
/// # Errors
/// A sentence with what was expected and found.
pub(crate) fn check<const POINTS: usize>(network: &Network) -> Result<(), String> {
    match network.output_lens() {
        // The face landmarker has a third, whether the tongue is out.
        [points, 1] | [points, 1, 1] if *points == 3 * POINTS => Ok(()),
        lens => Err(format!("expected outputs of {} numbers and one, found {lens:?}", 3 * POINTS)),
    }
}

/// The points of the face in a region, pixels of the frame; `None` when there is no face.
///
/// # Errors
/// When the network does not fit together.
pub(crate) fn points(
    network: &Network,
    frame: &Image,
    region: &Region,
) -> Result<Option<Vec<[f64; 2]>>, String> {
    let [_, height, width] = network.input();
    let outputs = network.run(&region.planes(frame, [height, width], [0.0, 1.0], Beyond::Nearest))?;
    let [points, presence, ..] = outputs.as_slice() else {
        return Err(format!("expected two outputs, found {}", outputs.len()));
    };
    let present = presence.first().is_some_and(|score| 1.0 / (1.0 + (-score).exp()) > LEAST_PRESENCE);
    if !present || !points.iter().all(|number| number.is_finite()) {
        return Ok(None);
    }
    let share = |at: f32, side: usize| f64::from(at) / side as f64;
    let place = |point: &[f32]| {
        let [x, y] = region.place([share(point[0], width), share(point[1], height)]);
        // An integer is the centre of a pixel here, and its corner there.
        [x - 0.5, y - 0.5]
    };
    Ok(Some(points.chunks_exact(3).map(place).collect()))
}
