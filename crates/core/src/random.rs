//! Random numbers that depend on their purpose, never on the order of drawing.
//!
//! Every random choice of the project comes from one seed through Philox4x32-10 (Salmon et al., *Parallel random numbers: as
//! easy as 1, 2, 3*, SC 2011), keyed by (seed, scene, frame, purpose): any frame can be computed alone, on any machine, in any
//! order, and is bit-identical. The system's transcendental functions are not used.

/// The key of a stream of random numbers.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Key {
    /// The user's seed.
    pub seed: u64,
    /// Number of the scene or subject; 0 without one.
    pub scene: u32,
    /// Number of the frame; 0 without one.
    pub frame: u32,
}

impl Key {
    /// The key of `seed`, scene 0, frame 0.
    pub fn new(seed: u64) -> Self {
        Self { seed, scene: 0, frame: 0 }
    }

    /// The same seed for another scene.
    pub fn scene(self, scene: u32) -> Self {
        Self { scene, ..self }
    }

    /// The same seed and scene for another frame.
    pub fn frame(self, frame: u32) -> Self {
        Self { frame, ..self }
    }

    /// The stream of numbers for one purpose, e.g. `"gaze"`. Streams of different purposes are independent.
    pub fn stream(self, purpose: &str) -> Stream {
        // FNV-1a: stable across versions and platforms, unlike the standard library's hasher.
        let hash = purpose
            .bytes()
            .fold(0xcbf2_9ce4_8422_2325_u64, |h, b| (h ^ u64::from(b)).wrapping_mul(0x0000_0100_0000_01b3));
        let seed = self.seed ^ hash;
        Stream {
            key: [seed as u32, (seed >> 32) as u32],
            counter: [0, self.scene, self.frame, (hash >> 32) as u32 ^ hash as u32],
            block: [0; 4],
            used: 4,
        }
    }
}

/// A stream of random numbers; see [`Key::stream`].
#[derive(Debug, Clone)]
pub struct Stream {
    key: [u32; 2],
    counter: [u32; 4],
    block: [u32; 4],
    used: usize,
}

impl Stream {
    /// 32 uniform bits. A stream repeats after 2^34 calls.
    pub fn bits(&mut self) -> u32 {
        if self.used == 4 {
            self.block = philox(self.counter, self.key);
            self.counter[0] = self.counter[0].wrapping_add(1);
            self.used = 0;
        }
        self.used += 1;
        self.block[self.used - 1]
    }

    /// Uniform in `[0, 1)`, a multiple of 2^-24.
    pub fn unit(&mut self) -> f32 {
        (self.bits() >> 8) as f32 * (1.0 / 16_777_216.0)
    }

    /// Uniform in `[low, high)`.
    pub fn uniform(&mut self, low: f32, high: f32) -> f32 {
        low + (high - low) * self.unit()
    }

    /// Uniform in `0..n`; 0 when `n` is 0.
    pub fn below(&mut self, n: u32) -> u32 {
        ((u64::from(self.bits()) * u64::from(n)) >> 32) as u32
    }

    /// Shuffles the items (Fisher and Yates).
    pub fn shuffle<T>(&mut self, items: &mut [T]) {
        for last in (1..items.len()).rev() {
            items.swap(last, self.below(last as u32 + 1) as usize);
        }
    }

    /// Normal with mean 0 and standard deviation 1 (Box-Muller).
    pub fn normal(&mut self) -> f32 {
        let radius = libm::sqrtf(-2.0 * libm::logf(1.0 - self.unit()));
        radius * libm::cosf(std::f32::consts::TAU * self.unit())
    }
}

fn philox(mut counter: [u32; 4], mut key: [u32; 2]) -> [u32; 4] {
    for _ in 0..10 {
        let a = u64::from(counter[0]) * 0xD251_1F53;
        let b = u64::from(counter[2]) * 0xCD9E_8D57;
        counter = [
            (b >> 32) as u32 ^ counter[1] ^ key[0],
            b as u32,
            (a >> 32) as u32 ^ counter[3] ^ key[1],
            a as u32,
        ];
        key = [key[0].wrapping_add(0x9E37_79B9), key[1].wrapping_add(0xBB67_AE85)];
    }
    counter
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Known answers of the Random123 distribution (kat_vectors, philox4x32 10).
    #[test]
    fn philox_gives_the_published_answers() {
        assert_eq!(philox([0; 4], [0; 2]), [0x6627_e8d5, 0xe169_c58d, 0xbc57_ac4c, 0x9b00_dbd8]);
        assert_eq!(
            philox([u32::MAX; 4], [u32::MAX; 2]),
            [0x408f_276d, 0x41c8_3b0e, 0xa20b_c7c6, 0x6d54_51fd]
        );
    }

    #[test]
    fn streams_differ_by_each_part_of_the_key() {
        let key = Key::new(7);
        let first = |key: Key, purpose| key.stream(purpose).bits();
        let base = first(key, "gaze");
        assert_eq!(base, first(key, "gaze"));
        assert_ne!(base, first(key, "pose"));
        assert_ne!(base, first(key.scene(1), "gaze"));
        assert_ne!(base, first(key.frame(1), "gaze"));
        assert_ne!(base, first(Key::new(8), "gaze"));
    }

    /// The published results and all datasets depend on this order.
    #[test]
    fn a_shuffle_keeps_every_item_and_never_changes() {
        let mut items: Vec<usize> = (0..10).collect();
        Key::new(3).stream("test").shuffle(&mut items);
        assert_eq!(items, [6, 7, 4, 3, 0, 5, 2, 1, 8, 9]);
        items.sort_unstable();
        assert_eq!(items, (0..10).collect::<Vec<_>>());
    }

    #[test]
    fn normal_numbers_have_mean_zero_and_variance_one() {
        let mut stream = Key::new(1).stream("test");
        let draws: Vec<f32> = (0..20_000).map(|_| stream.normal()).collect();
        let mean = draws.iter().sum::<f32>() / draws.len() as f32;
        let variance = draws.iter().map(|x| (x - mean) * (x - mean)).sum::<f32>() / draws.len() as f32;
        assert!(mean.abs() < 0.03 && (variance - 1.0).abs() < 0.05, "mean {mean}, variance {variance}");
    }
}
