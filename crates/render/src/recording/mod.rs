//! What a camera does to a picture: blur by motion and defocus, light, sensor noise and compression.
//!
//! Every effect depends on the seed, the scene and the frame alone, and gives the same bits on every machine.

mod blur;
mod jpeg;
mod sensor;

use srflow_core::Image;
use srflow_core::random::Key;
use srflow_data::manifest::Recording;

pub(crate) use blur::{Exposure, defocus};
pub(crate) use sensor::{Light, add_noise, coded};

/// Highest quality of compressed scenes, unless all have a higher one.
const BEST_QUALITY: u8 = 95;

/// Shortest trace of motion, in pixels, that is blurred, and the most moments that one is made of.
const LEAST_TRACE: f32 = 0.5;
const MOST_MOMENTS: usize = 16;

/// The camera of one scene, drawn within the bounds of a [`Recording`].
#[derive(Debug, Clone)]
pub(crate) struct Recorder {
    key: Key,
    light: Option<Light>,
    noise: f32,
    /// Share of the time between frames.
    shutter: f32,
    /// Radius in pixels.
    defocus: f32,
    /// Quality of JPEG.
    jpeg: Option<u8>,
}

impl Recorder {
    /// The camera of the scene of `key`.
    pub fn new(recording: &Recording, key: Key) -> Self {
        // A stream for each, so that no effect depends on the others.
        let upto = |most: f32, purpose: &str| most * key.stream(purpose).unit();
        let quality = |least: u8| {
            let steps = u32::from(BEST_QUALITY.saturating_sub(least)) + 1;
            least + key.stream("compression").below(steps) as u8
        };
        Self {
            key,
            light: (recording.lighting > 0.0).then(|| Light::exposed(key, recording.lighting)),
            noise: upto(recording.noise, "noise strength"),
            shutter: upto(recording.shutter, "shutter"),
            defocus: upto(recording.defocus, "defocus"),
            jpeg: recording.jpeg.map(quality),
        }
    }

    /// The moments, in frames from a frame's own, whose mean is the picture of a head that moves by up to `longest` pixels per
    /// frame: about one for each pixel of the trace, up to 16. Empty where the trace is shorter than half a pixel.
    pub fn moments(&self, longest: f32) -> Vec<f32> {
        let trace = self.shutter * longest;
        let count = if trace < LEAST_TRACE { 0 } else { (trace.ceil() as usize).clamp(2, MOST_MOMENTS) };
        (0..count).map(|moment| self.shutter * ((moment as f32 + 0.5) / count as f32 - 0.5)).collect()
    }

    /// Whether the shutter is open for some time.
    pub fn blurs_motion(&self) -> bool {
        self.shutter > 0.0
    }

    /// The picture of `frame`, at a time in seconds, as this camera records it.
    pub fn record(&self, image: &mut Image, frame: u32, seconds: f32) {
        defocus(image, self.defocus);
        if self.light.is_some() || self.noise > 0.0 {
            let light = self.light.as_ref().unwrap_or(&Light::CONSTANT);
            light.record(image, seconds, self.noise, self.key.frame(frame));
        }
        if let Some(quality) = self.jpeg {
            jpeg::compress(image, quality);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn recorder(recording: Recording, scene: u32) -> Recorder {
        Recorder::new(&recording, Key::new(9).scene(scene))
    }

    #[test]
    fn scenes_draw_within_the_bounds_and_one_effect_does_not_change_another() {
        let wild = Recording::wild();
        let least = wild.jpeg.unwrap();
        for scene in 0..100 {
            let all = recorder(wild, scene);
            assert!((0.0..=wild.noise).contains(&all.noise) && (0.0..=wild.defocus).contains(&all.defocus));
            assert!((0.0..=wild.shutter).contains(&all.shutter));
            assert!((least..=BEST_QUALITY).contains(&all.jpeg.unwrap()));
            let alone = recorder(Recording { noise: wild.noise, ..Recording::none() }, scene);
            assert_eq!(alone.noise, all.noise);
            assert!(alone.jpeg.is_none() && alone.light.is_none() && !alone.blurs_motion());
        }
        let qualities =
            |least| (0..200).map(move |scene| recorder(Recording { jpeg: Some(least), ..wild }, scene));
        assert!(qualities(99).all(|recorder| recorder.jpeg == Some(99)));
        let spread: Vec<u8> = qualities(least).filter_map(|recorder| recorder.jpeg).collect();
        assert!(spread.iter().min() < Some(&45) && spread.iter().max() > Some(&90));
    }

    #[test]
    fn light_differs_between_scenes_and_hardly_between_frames() {
        let light = Recording { lighting: 1.0, ..Recording::none() };
        let grey = |scene: u32, frame: u32| {
            let mut image = Image::filled(8, 8, [128; 3]);
            recorder(light, scene).record(&mut image, frame, frame as f32 / 24.0);
            image.get(4, 4).map(i32::from)
        };
        let firsts: Vec<[i32; 3]> = (0..40).map(|scene| grey(scene, 0)).collect();
        for channel in 0..3 {
            let values = firsts.iter().map(|first| first[channel]);
            let (low, high) = (values.clone().min().unwrap(), values.max().unwrap());
            // 0.7 stops to either side, and 5 % of changing light, at gamma 2.2.
            assert!(low >= 128 * 100 / 130 && high <= 128 * 130 / 100 && high - low > 20, "{low} {high}");
        }
        assert!(firsts.iter().any(|[red, _, blue]| red - blue > 6));
        assert!(firsts.iter().any(|[red, _, blue]| blue - red > 6));
        for (scene, first) in (0..).zip(firsts) {
            // 1 % of light at most, which is half a level, and rounding.
            let next = grey(scene, 1);
            assert!(first.iter().zip(next).all(|(a, b)| (a - b).abs() <= 2), "{first:?} {next:?}");
        }
    }

    #[test]
    fn moments_are_around_the_frame_and_cover_the_open_shutter() {
        let recorder = Recorder { shutter: 0.5, ..recorder(Recording::none(), 0) };
        assert!(recorder.moments(0.9).is_empty());
        for longest in [1.1, 5.0, 13.0, 400.0] {
            let moments = recorder.moments(longest);
            assert!(moments.iter().sum::<f32>().abs() < 1e-6 && moments.is_sorted());
            assert!(moments.iter().all(|moment| moment.abs() < 0.25));
            let gap = (moments[1] - moments[0]) * longest;
            assert!(gap <= 1.0 || moments.len() == MOST_MOMENTS, "{gap}");
        }
    }
}
