//! The learning rate of every step.

/// `torch.optim.lr_scheduler.OneCycleLR` with `anneal_strategy="linear"` and `cycle_momentum=False`: up in a straight
/// line, then down in a straight line.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct OneCycle {
    pub peak: f64,
    /// Steps of the whole cycle. SKFlow plans 100 more than it trains, so that the rate never reaches its end.
    pub total_steps: u64,
    /// Share of the cycle in which the rate rises (`pct_start`).
    pub rising: f64,
}

/// The peak is this many times the rate of the first step (`div_factor`).
const FIRST_DIVISOR: f64 = 25.0;
/// The rate of the first step is this many times that of the last (`final_div_factor`).
const LAST_DIVISOR: f64 = 1e4;

impl OneCycle {
    /// The learning rate of step `step`, counted from 0. Past the end of the cycle it stays at its last value.
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
