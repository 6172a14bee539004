//! The share of pixels within an error threshold: the curve whose weighted area is WAUC.

use srflow_core::FlowField;

/// Thresholds in pixels: 0.05, 0.10, ... 5, those of WAUC.
pub(crate) const THRESHOLDS: usize = 100;
/// Thresholds per pixel of error.
pub(crate) const PER_PIXEL: f64 = 20.0;

/// For each threshold, the mean over images of the share of valid pixels with at most that end-point error.
#[derive(Debug, Clone)]
pub(crate) struct ErrorCurve {
    sums: Vec<f64>,
    images: usize,
}

impl Default for ErrorCurve {
    fn default() -> Self {
        Self { sums: vec![0.0; THRESHOLDS], images: 0 }
    }
}

impl ErrorCurve {
    /// Adds the [`shares_within`] of one image; an image without ground truth is ignored.
    pub(crate) fn add(&mut self, shares: &[f64]) {
        if shares.len() == THRESHOLDS {
            self.sums.iter_mut().zip(shares).for_each(|(sum, share)| *sum += share);
            self.images += 1;
        }
    }

    /// One share per threshold, `0..=1`; empty without images.
    pub(crate) fn mean(self) -> Vec<f64> {
        match self.images {
            0 => Vec::new(),
            images => self.sums.into_iter().map(|sum| sum / images as f64).collect(),
        }
    }
}

/// For each threshold, the share of valid pixels with at most that end-point error; empty without ground truth.
pub(crate) fn shares_within(flow: &FlowField, truth: &FlowField) -> Vec<f64> {
    let mut counts = [0_u64; THRESHOLDS + 1];
    let mut valid = 0_u64;
    for ([u, v], [true_u, true_v]) in flow.pixels().iter().zip(truth.pixels()) {
        let error = f64::from((u - true_u).hypot(v - true_v));
        if error.is_finite() {
            valid += 1;
            // The first threshold that reaches the error.
            counts[((error * PER_PIXEL).ceil() as usize).saturating_sub(1).min(THRESHOLDS)] += 1;
        }
    }
    if valid == 0 {
        return Vec::new();
    }
    let mut within = 0;
    let share = |count| {
        within += count;
        within as f64 / valid as f64
    };
    counts.into_iter().take(THRESHOLDS).map(share).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_curve_rises_at_the_error() {
        let mut curve = ErrorCurve::default();
        let truth = FlowField::from_fn(4, 1, |x, _| if x == 3 { [f32::NAN; 2] } else { [0.0; 2] });
        let flow = FlowField::from_fn(4, 1, |x, _| [[0.0, 0.52, 9.0, 0.0][x], 0.0]);
        curve.add(&shares_within(&flow, &truth));
        let shares = curve.mean();
        let third = 1.0 / 3.0;
        assert!((shares[0] - third).abs() < 1e-12 && (shares[9] - third).abs() < 1e-12);
        assert!((shares[10] - 2.0 * third).abs() < 1e-12 && (shares[99] - 2.0 * third).abs() < 1e-12);
    }
}
