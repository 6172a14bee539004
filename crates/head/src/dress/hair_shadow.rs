//! How much light passes through hair: its density in cells, through which rays march.

use glam::{IVec3, Vec3};

use super::Splat;

const MM: f32 = 1e-3;
/// Side of a cell, metres.
const CELL: f32 = 4.0 * MM;
/// Length of a ray, in cells, and how far it starts from the skin.
const STEPS: usize = 26;
const START: f32 = 2.5 * MM;

/// The density of hair around a head.
pub(super) struct HairShadow {
    low: Vec3,
    sides: IVec3,
    /// Part of the light that a cell's width of it absorbs, as an optical depth.
    depths: Vec<f32>,
    cell: f32,
}

impl HairShadow {
    /// Of these Gaussians, on a head of this size relative to an adult's.
    pub fn new(hair: &[(u32, Splat)], size: f32) -> Self {
        let cell = CELL * size;
        let places = || hair.iter().map(|(_, splat)| splat.position);
        let (low, high) = (places().fold(Vec3::MAX, Vec3::min), places().fold(Vec3::MIN, Vec3::max));
        if hair.is_empty() {
            return Self { low: Vec3::ZERO, sides: IVec3::ZERO, depths: Vec::new(), cell };
        }
        let sides = ((high - low) / cell).as_ivec3().clamp(IVec3::ZERO, IVec3::splat(255)) + 1;
        let mut shadow = Self { low, sides, depths: vec![0.0; (sides.x * sides.y * sides.z) as usize], cell };
        for (_, splat) in hair {
            // The silhouette of a needle: two deviations to either side.
            let area = 4.0 * splat.scale.x * splat.scale.y * 2.0 * splat.opacity;
            if let Some(depth) = shadow.cell_at(splat.position) {
                shadow.depths[depth] += area / (cell * cell);
            }
        }
        shadow
    }

    fn cell_at(&self, p: Vec3) -> Option<usize> {
        let at = (p - self.low) / self.cell;
        let is_positive = at.cmpge(Vec3::ZERO).all();
        let at = at.as_ivec3();
        let inside = is_positive && at.cmplt(self.sides).all();
        inside.then(|| ((at.z * self.sides.y + at.y) * self.sides.x + at.x) as usize)
    }

    /// The part of the light that passes from `direction` to `p`, 0 to 1.
    pub fn light(&self, p: Vec3, direction: Vec3) -> f32 {
        let start = p + direction * START;
        let depth: f32 = (0..STEPS)
            .filter_map(|step| self.cell_at(start + direction * (self.cell * step as f32)))
            .map(|cell| self.depths[cell])
            .sum();
        libm::expf(-depth)
    }
}
