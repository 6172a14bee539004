//! Probabilities that mean what they say: scores of clips that the classifier has not seen, divided by a temperature.

/// Bounds of the temperature, and steps of the search between them.
const COLDEST: f64 = 0.05;
const HOTTEST: f64 = 50.0;
const STEPS: usize = 60;

/// Probabilities of the classes: the softmax of the scores divided by a temperature.
pub fn probabilities(scores: &[f32], temperature: f64) -> Vec<f64> {
    let scaled: Vec<f64> = scores.iter().map(|score| f64::from(*score) / temperature).collect();
    let greatest = scaled.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    let shares: Vec<f64> = scaled.iter().map(|score| (score - greatest).exp()).collect();
    let total: f64 = shares.iter().sum();
    shares.iter().map(|share| share / total).collect()
}

/// The temperature under which the truth of held-out clips, given with their scores, is most probable (Guo et al., ICML 2017). 1 without
/// clips.
pub fn temperature<'a>(held_out: impl Iterator<Item = (&'a [f32], usize)> + Clone) -> f64 {
    let loss = |logarithm: f64| -> f64 {
        let of = |(scores, truth): (&[f32], usize)| {
            -probabilities(scores, logarithm.exp())[truth].max(f64::MIN_POSITIVE).ln()
        };
        held_out.clone().map(of).sum()
    };
    if held_out.clone().next().is_none() {
        return 1.0;
    }
    // The loss has one minimum in the inverse temperature.
    let ratio = (5_f64.sqrt() - 1.0) / 2.0;
    let (mut low, mut high) = (COLDEST.ln(), HOTTEST.ln());
    for _ in 0..STEPS {
        let (left, right) = (high - ratio * (high - low), low + ratio * (high - low));
        if loss(left) <= loss(right) { high = right } else { low = left }
    }
    f64::midpoint(low, high).exp()
}
