//! MediaPipe's face mesh, graph `face_landmark_front_cpu`.

use srflow_core::Image;

use crate::region::{Beyond, Region};
use crate::tflite::Network;

/// Number of its points.
pub(crate) const POINTS: usize = 468;
/// Height and width of the input.
pub(crate) const INPUT: [usize; 2] = [192, 192];
/// Probability that the region shows a face, above which it does.
const LEAST_PRESENCE: f32 = 0.5;

/// Checks that a network is the face mesh.
///
/// # Errors
/// A sentence with what was expected and found.
pub(crate) fn check(network: &Network) -> Result<(), String> {
    match network.output_lens() {
        [points, 1] if *points == 3 * POINTS => Ok(()),
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
    let outputs = network.run(&region.planes(frame, INPUT, [0.0, 1.0], Beyond::Nearest))?;
    let [points, presence] = outputs.as_slice() else {
        return Err(format!("expected two outputs, found {}", outputs.len()));
    };
    let present = presence.first().is_some_and(|score| 1.0 / (1.0 + (-score).exp()) > LEAST_PRESENCE);
    if !present || !points.iter().all(|number| number.is_finite()) {
        return Ok(None);
    }
    let share = |at: f32, side: usize| f64::from(at) / side as f64;
    let place = |point: &[f32]| {
        let [x, y] = region.place([share(point[0], INPUT[1]), share(point[1], INPUT[0])]);
        // An integer is the centre of a pixel here, and its corner there.
        [x - 0.5, y - 0.5]
    };
    Ok(Some(points.chunks_exact(3).map(place).collect()))
}
