//! Training, validation and test pictures, as VHAP divides them (`split_json`).

use serde::{Deserialize, Serialize};
use srflow_core::named;

/// What a picture of a capture is for.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum CaptureSplit {
    Train,
    /// A held-out camera at the timesteps of training: novel views.
    Val,
    /// All cameras at held-out timesteps: self-reenactment.
    Test,
}

named!(CaptureSplit, "a split", { Train => "train", Val => "val", Test => "test" });

/// The front camera of NeRSemble, which is held out where a capture has it.
pub const FRONT_CAMERA: u32 = 8;

/// Share of the timesteps for training and validation.
const TRAIN_SHARE: f64 = 0.7;

/// The split of each timestep and camera, given by their places in these ascending lists: the last 30 % of the timesteps are for
/// testing, and of the others camera 8 (else the last one) for validation, unless it is the only one.
pub fn split_of(timesteps: &[u32], cameras: &[u32]) -> impl Fn(u32, u32) -> CaptureSplit + use<> {
    let for_training = (timesteps.len() as f64 * TRAIN_SHARE).ceil() as usize;
    let first_of_test = timesteps.get(for_training).copied();
    let held_out = match cameras {
        [] | [_] => None,
        cameras if cameras.contains(&FRONT_CAMERA) => Some(FRONT_CAMERA),
        cameras => cameras.last().copied(),
    };
    move |timestep, camera| {
        if first_of_test.is_some_and(|first| timestep >= first) {
            CaptureSplit::Test
        } else if held_out == Some(camera) {
            CaptureSplit::Val
        } else {
            CaptureSplit::Train
        }
    }
}
