//! The learning rate schedule.

/// `torch.optim.lr_scheduler.OneCycleLR` with `anneal_strategy="linear"` and `cycle_momentum=False`: a linear rise, then a
/// linear fall.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct OneCycle {
    /// Maximum learning rate (`max_lr`).
    pub peak: f64,
    /// Steps of the whole cycle. SKFlow plans 100 more than it trains, so the rate never reaches its final value.
    pub total_steps: u64,
    /// Share of the cycle in which the rate rises (`pct_start`), `0..1`.
    pub rising: f64,
}

/// Ratio of the peak to the rate of the first step (`div_factor`).
const FIRST_DIVISOR: f64 = 25.0;
/// Ratio of the rate of the first step to that of the last (`final_div_factor`).
const LAST_DIVISOR: f64 = 1e4;

impl OneCycle {
    /// The learning rate of `step`, from 0. After the end of the cycle it keeps its last value.
    pub fn learning_rate(&self, step: u64) -> f64 {
        let first = self.peak / FIRST_DIVISOR;
        let last = first / LAST_DIVISOR;
        let top = self.rising * self.total_steps as f64 - 1.0;
        let end = self.total_steps as f64 - 1.0;
        let step = step as f64;
        if step < top {
            first + (self.peak - first) * (step / top)
        } else if step < end {
            self.peak + (last - self.peak) * ((step - top) / (end - top))
        } else {
            last
        }
    }
}
