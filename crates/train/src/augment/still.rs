use srflow_core::random::Key;
use srflow_core::{FlowField, Image, Size};
use srflow_data::flow::Sample;

use super::config::AugmentConfig;

/// Largest standard deviation of the noise of either frame, in levels of 255; a third of the samples have none.
const MOST_NOISE: f32 = 3.0;

/// Makes some samples still: frame 2 becomes frame 1 with other noise.
pub(super) fn still(sample: &mut Sample, config: &AugmentConfig, key: Key) {
    let mut stream = key.stream("augment: still");
    if stream.unit() >= config.still_probability {
        return;
    }
    let noise = stream.uniform(-0.5 * MOST_NOISE, MOST_NOISE).max(0.0);
    let Size { width, height } = sample.frame1.size();
    sample.frame2 = sample.frame1.clone();
    if noise > 0.0 {
        let mut stream = key.stream("augment: noise of a still frame");
        let mut noisy = |frame: &mut Image| {
            for value in frame.pixels_mut().iter_mut().flatten() {
                *value = (f32::from(*value) + noise * stream.normal()).round().clamp(0.0, 255.0) as u8;
            }
        };
        noisy(&mut sample.frame1);
        noisy(&mut sample.frame2);
    }
    sample.flow = sample.flow.as_ref().map(|_| FlowField::filled(width, height, [0.0; 2]));
    if let Some(occlusion) = &mut sample.occlusion {
        occlusion.pixels_mut().fill(false);
    }
}
