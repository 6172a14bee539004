//! A loss that forgives outliers.

/// The loss of Geman and McClure: what a squared residual costs, and the weight with which weighted least squares has the same gradient.
/// Residuals much larger than the square root of `limit` lose their pull.
pub fn geman_mcclure(square: f64, limit: f64) -> (f64, f64) {
    let softened = 1.0 + square / limit;
    (square / softened, 1.0 / (softened * softened))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_weight_is_the_slope_of_the_cost_and_far_residuals_cost_the_limit() {
        for square in [0.0, 0.3, 5.0, 100.0] {
            let [low, high] = [-1e-5, 1e-5].map(|step| geman_mcclure(square + step, 16.0).0);
            assert!(((high - low) / 2e-5 - geman_mcclure(square, 16.0).1).abs() < 1e-7, "{square}");
        }
        assert!((geman_mcclure(1e9, 16.0).0 - 16.0).abs() < 1e-3);
    }
}
