//! Imaging effects of recorded video: changing illumination and sensor noise.

use srflow_core::random::{Key, Stream};
use srflow_core::{Image, Plane, Size};

/// The gamma of the pictures: light that grows by `g` multiplies a value by `g^(1/2.2)`.
const CODING_POWER: f32 = 2.2;

/// Standard deviation of the noise in levels of 255: at black, and the term added to its square at white.
const NOISE_IN_BLACK: f32 = 0.9;
const NOISE_AT_WHITE: f32 = 2.1;

/// Frequency of lamp flicker in Hz, with alternating current of 50 Hz.
const FLICKER_HZ: f32 = 100.0;

/// Exposure and white balance of scenes at strength 1, in stops to either side: of all channels; of red, and the other way of
/// blue; of green.
const EXPOSURE_STOPS: f32 = 0.5;
const WARMTH_STOPS: f32 = 0.2;
const TINT_STOPS: f32 = 0.06;

/// Change of the white balance within a scene at strength 1: the share by which red grows and blue falls.
const WARMTH_CHANGE: f32 = 0.01;

/// The illumination of one clip or scene: constant gains, and changes around them.
#[derive(Debug, Clone)]
pub struct Light {
    /// For the whole picture, its horizontal and its vertical gradient: strength, cycles per second, phase.
    waves: [[f32; 3]; 3],
    flicker: [f32; 2],
    /// Factors of red, green and blue.
    gains: [f32; 3],
    /// Of the white balance, as `waves`.
    warmth: [f32; 3],
}

impl Light {
    /// Nothing changes.
    pub const CONSTANT: Self =
        Self { waves: [[0.0; 3]; 3], flicker: [0.0; 2], gains: [1.0; 3], warmth: [0.0; 3] };

    /// Changing illumination of constant mean and colour.
    pub fn random(key: Key, strength: f32) -> Self {
        let mut stream = key.stream("lighting");
        let waves = [0.02, 0.012, 0.012].map(|reach| wave(strength * reach, &mut stream));
        let flicker = [strength * 0.003 * stream.unit(), stream.uniform(0.0, std::f32::consts::TAU)];
        Self { waves, flicker, ..Self::CONSTANT }
    }

    /// Changing illumination as seen by a camera whose exposure and white balance are not quite right, and drift.
    pub fn exposed(key: Key, strength: f32) -> Self {
        let mut stream = key.stream("exposure");
        let mut stops = |reach: f32| strength * reach * stream.uniform(-1.0, 1.0);
        let (exposure, warm, tint) = (stops(EXPOSURE_STOPS), stops(WARMTH_STOPS), stops(TINT_STOPS));
        let gains = [exposure + warm, exposure + tint, exposure - warm].map(libm::exp2f);
        let warmth = wave(strength * WARMTH_CHANGE, &mut stream);
        Self { gains, warmth, ..Self::random(key, strength) }
    }

    /// Illumination at a time: factors for the whole picture, the gradient to the right, and the gradient downwards.
    fn at(&self, seconds: f32) -> [f32; 3] {
        let mut light = self.waves.map(|wave| height(wave, seconds));
        light[0] +=
            self.flicker[0] * libm::sinf(std::f32::consts::TAU * FLICKER_HZ * seconds + self.flicker[1]);
        light
    }

    /// Factors of the coded red, green and blue at a time.
    fn coded_gains(&self, seconds: f32) -> [f32; 3] {
        let warmth = height(self.warmth, seconds);
        let [red, green, blue] = self.gains;
        [red * (1.0 + warmth), green, blue * (1.0 - warmth)].map(coded)
    }

    /// Applies the illumination at a time in seconds, and adds noise of the given strength keyed by `key`.
    pub fn record(&self, image: &mut Image, seconds: f32, noise: f32, key: Key) {
        let Size { width, height } = image.size();
        let [whole, right, down] = self.at(seconds);
        let gains = self.coded_gains(seconds);
        let mut stream = key.stream("sensor noise");
        let across = |at: usize, len: usize| 2.0 * (at as f32 + 0.5) / len as f32 - 1.0;
        for y in 0..height {
            for x in 0..width {
                let light = 1.0 + whole + right * across(x, width) + down * across(y, height);
                let gain = coded(light);
                let clean = image.get(x, y);
                let pixel = std::array::from_fn(|channel| {
                    let value = f32::from(clean[channel]) * gain * gains[channel];
                    let disturbance = if noise > 0.0 { disturbance(value, noise, &mut stream) } else { 0.0 };
                    (value + disturbance + 0.5).clamp(0.0, 255.0) as u8
                });
                image.set(x, y, pixel);
            }
        }
    }
}

/// A random wave of up to `reach`: strength, cycles per second, phase.
fn wave(reach: f32, stream: &mut Stream) -> [f32; 3] {
    let turn = std::f32::consts::TAU;
    [reach * stream.uniform(0.3, 1.0), stream.uniform(0.3, 1.5), stream.uniform(0.0, turn)]
}

fn height([reach, hertz, phase]: [f32; 3], seconds: f32) -> f32 {
    reach * libm::sinf(std::f32::consts::TAU * hertz * seconds + phase)
}

/// The factor of a coded value for a factor of light.
pub fn coded(light: f32) -> f32 {
    libm::powf(light.max(0.0), 1.0 / CODING_POWER)
}

/// Noise of a value, in levels of 255.
fn disturbance(value: f32, noise: f32, stream: &mut Stream) -> f32 {
    let variance = NOISE_IN_BLACK * NOISE_IN_BLACK + NOISE_AT_WHITE * NOISE_AT_WHITE * value / 255.0;
    noise * variance.sqrt() * stream.normal()
}

/// Adds noise of the given strength, weighted by `alpha`: the background was put behind the recorded head later.
pub fn add_noise(image: &mut Image, alpha: &Plane, noise: f32, key: Key) {
    let mut stream = key.stream("sensor noise");
    for (pixel, &alpha) in image.pixels_mut().iter_mut().zip(alpha.pixels()) {
        for value in pixel {
            let clean = f32::from(*value);
            *value = (clean + alpha * disturbance(clean, noise, &mut stream) + 0.5).clamp(0.0, 255.0) as u8;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn recorded(strength: f32, noise: f32, seconds: f32, frame: u32) -> Image {
        let mut image = Image::filled(64, 64, [128; 3]);
        let key = Key::new(3);
        Light::random(key, strength).record(&mut image, seconds, noise, key.frame(frame));
        image
    }

    fn moments(image: &Image) -> (f64, f64) {
        let values: Vec<f64> = image.pixels().as_flattened().iter().map(|&value| f64::from(value)).collect();
        let mean = values.iter().sum::<f64>() / values.len() as f64;
        let variance =
            values.iter().map(|value| (value - mean) * (value - mean)).sum::<f64>() / values.len() as f64;
        (mean, variance.sqrt())
    }

    #[test]
    fn without_strength_nothing_changes() {
        assert_eq!(recorded(0.0, 0.0, 0.3, 4), Image::filled(64, 64, [128; 3]));
    }

    #[test]
    fn noise_has_the_requested_strength_and_differs_by_frame() {
        let (mean, deviation) = moments(&recorded(0.0, 1.0, 0.0, 1));
        assert!((mean - 128.0).abs() < 0.2 && (1.5..2.1).contains(&deviation), "{mean} {deviation}");
        let (_, stronger) = moments(&recorded(0.0, 3.0, 0.0, 1));
        assert!((2.7..3.3).contains(&(stronger / deviation)), "{stronger}");
        assert_ne!(recorded(0.0, 1.0, 0.0, 1), recorded(0.0, 1.0, 0.0, 2));
        assert_eq!(recorded(0.0, 1.0, 0.0, 1), recorded(0.0, 1.0, 0.0, 1));
    }

    #[test]
    fn noise_is_on_the_head_alone() {
        let mut image = Image::filled(64, 64, [128; 3]);
        add_noise(
            &mut image,
            &Plane::from_fn(64, 64, |x, _| if x < 32 { 1.0 } else { 0.0 }),
            1.0,
            Key::new(1),
        );
        let rows = image.pixels().chunks(64);
        let (head, behind): (Vec<_>, Vec<_>) = rows.map(|row| row.split_at(32)).unzip();
        assert!(behind.concat().iter().all(|pixel| *pixel == [128; 3]));
        let (mean, deviation) = moments(&Image::from_pixels(32, 64, head.concat()).unwrap());
        assert!((mean - 128.0).abs() < 0.2 && (1.5..2.1).contains(&deviation), "{mean} {deviation}");
    }

    #[test]
    fn light_changes_with_time_by_a_few_percent() {
        let means: Vec<f64> =
            (0..50).map(|step| moments(&recorded(3.0, 0.0, step as f32 * 0.04, 0)).0).collect();
        let (low, high) =
            means.iter().fold((f64::MAX, f64::MIN), |(low, high), &mean| (low.min(mean), high.max(mean)));
        assert!(high - low > 1.0 && high - low < 20.0, "{low} to {high}");
    }
}
