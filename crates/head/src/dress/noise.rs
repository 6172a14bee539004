//! Spatial noise for skin, irises and hair. Bit-identical everywhere: integer hashing and basic arithmetic only.

use glam::{IVec3, Vec3};

use super::surface::cell_of;

/// Smooth noise of one seed.
#[derive(Debug, Clone, Copy)]
pub(super) struct Noise {
    seed: u32,
}

impl Noise {
    pub fn new(seed: u32) -> Self {
        Self { seed }
    }

    /// Value noise at `p` with unit lattice cells, in `-1..1`.
    pub fn at(&self, p: Vec3) -> f32 {
        let base = cell_of(p);
        let t = p - base.as_vec3();
        let w = t * t * t * (t * (t * 6.0 - 15.0) + 10.0);
        let corner = |x, y, z| self.lattice(base.wrapping_add(IVec3::new(x, y, z)));
        let lerp = |a: f32, b: f32, t: f32| a + (b - a) * t;
        let plane = |z| {
            let near = lerp(corner(0, 0, z), corner(1, 0, z), w.x);
            let far = lerp(corner(0, 1, z), corner(1, 1, z), w.x);
            lerp(near, far, w.y)
        };
        lerp(plane(0), plane(1), w.z)
    }

    /// Sum of `octaves` noises, each at twice the frequency and half the amplitude of the previous, roughly in `-1..1`.
    pub fn fractal(&self, p: Vec3, octaves: u32) -> f32 {
        let (mut sum, mut strength, mut total, mut p) = (0.0, 1.0, 0.0, p);
        for octave in 0..octaves {
            sum += strength * Noise::new(self.seed.wrapping_add(octave * 0x9E37)).at(p);
            total += strength;
            strength *= 0.5;
            p *= 2.03;
        }
        sum / total * 1.5
    }

    fn lattice(&self, cell: IVec3) -> f32 {
        (self.hash(cell) >> 8) as f32 * (2.0 / 16_777_216.0) - 1.0
    }

    fn hash(&self, cell: IVec3) -> u32 {
        let mut h = self.seed ^ (cell.x as u32).wrapping_mul(0x8DA6_B343);
        h ^= (cell.y as u32).wrapping_mul(0xD816_3841);
        h ^= (cell.z as u32).wrapping_mul(0xCB1A_B31F);
        h = (h ^ h >> 16).wrapping_mul(0x7FEB_352D);
        h = (h ^ h >> 15).wrapping_mul(0x846C_A68B);
        h ^ h >> 16
    }
}
