//! How far Adam moves at each iteration.

use serde::{Deserialize, Serialize};

use super::LearningRates;

/// Learning rates over a training. The defaults are those of GaussianAvatars (`arguments/__init__.py`).
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct RateSchedule {
    /// Of positions at the start, in units of the triangles and times the extent of the cameras.
    pub positions: f64,
    /// The same from iteration `position_steps` on.
    pub positions_final: f64,
    /// Iterations over which the rate of positions falls. Its logarithm is linear in between.
    pub position_steps: u64,
    /// Of the logarithms of scales.
    pub scales: f32,
    pub rotations: f32,
    /// Of the logits of opacities.
    pub opacities: f32,
    /// Of the colours, which are the spherical harmonics of degree 0.
    pub sh_0: f32,
    /// Of the spherical harmonics of higher degrees.
    pub sh_rest: f32,
}

impl Default for RateSchedule {
    fn default() -> Self {
        let LearningRates { scales, rotations, opacities, sh_0, sh_rest, .. } = LearningRates::default();
        Self {
            positions: 0.005,
            positions_final: 0.000_05,
            position_steps: 600_000,
            scales,
            rotations,
            opacities,
            sh_0,
            sh_rest,
        }
    }
}

impl RateSchedule {
    /// The rates of iteration `iteration`, counted from 1, for cameras of this `extent` in metres (see [`scene_extent`]).
    ///
    /// [`scene_extent`]: super::scene_extent
    pub fn at(&self, iteration: u64, extent: f64) -> LearningRates {
        let share = (iteration as f64 / self.position_steps.max(1) as f64).min(1.0);
        let (first, last) = (libm::log(self.positions), libm::log(self.positions_final));
        LearningRates {
            positions: (extent * libm::exp(first + share * (last - first))) as f32,
            scales: self.scales,
            rotations: self.rotations,
            opacities: self.opacities,
            sh_0: self.sh_0,
            sh_rest: self.sh_rest,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_rate_of_positions_falls_by_the_same_factor_in_equal_steps() {
        let schedule = RateSchedule { position_steps: 1000, ..RateSchedule::default() };
        let rate = |iteration| f64::from(schedule.at(iteration, 2.0).positions);
        assert!((rate(0) / 0.01 - 1.0).abs() < 1e-6);
        assert!((rate(500) / 0.001 - 1.0).abs() < 1e-6, "the geometric mean in the middle");
        assert!((rate(1000) / 0.0001 - 1.0).abs() < 1e-6);
        assert_eq!(rate(1000), rate(5000), "constant after the last step");
    }

    #[test]
    fn other_rates_stay_what_they_are() {
        let (early, late) = (RateSchedule::default().at(1, 1.5), RateSchedule::default().at(500_000, 0.7));
        assert_eq!(LearningRates { positions: late.positions, ..early }, late);
        assert_eq!(LearningRates { positions: 0.005, ..early }, LearningRates::default());
    }
}
