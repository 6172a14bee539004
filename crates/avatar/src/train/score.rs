//! How close rendered pictures are to those of a capture, as GaussianAvatars measures it.

use super::image_loss::{ImageLoss, ImageLossError};

/// Scores of one picture, or their means.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Score {
    /// Peak signal-to-noise ratio of the whole picture, dB (`metrics.py` of GaussianAvatars). Infinite for equal pictures.
    pub psnr: f64,
    /// Mean of those of the three channels (`train.py` of GaussianAvatars, and its paper). At least as large.
    pub psnr_channels: f64,
    /// Structural similarity, with the window of [`ImageLoss`].
    pub ssim: f64,
}

impl Score {
    /// The scores of a `rendered` picture, clamped to 0..1, against `target`.
    ///
    /// # Errors
    /// When a picture does not have `width * height` pixels.
    pub fn of(
        rendered: &[[f32; 3]],
        target: &[[f32; 3]],
        size: (usize, usize),
        loss: &mut ImageLoss,
    ) -> Result<Self, ImageLossError> {
        let clamped: Vec<[f32; 3]> = rendered.iter().map(|pixel| pixel.map(|x| x.clamp(0.0, 1.0))).collect();
        let ssim = loss.backward(&clamped, target, size, &mut Vec::new())?.ssim;
        let mut squares = [0.0; 3];
        for (a, b) in clamped.iter().zip(target) {
            for (sum, (a, b)) in squares.iter_mut().zip(a.iter().zip(b)) {
                *sum += f64::from(a - b) * f64::from(a - b);
            }
        }
        let psnr = |mean_square: f64| -10.0 * libm::log10(mean_square);
        let of_channels = squares.map(|sum| sum / target.len().max(1) as f64);
        Ok(Self {
            psnr: psnr(of_channels.iter().sum::<f64>() / 3.0),
            psnr_channels: of_channels.map(psnr).iter().sum::<f64>() / 3.0,
            ssim,
        })
    }

    /// The mean of each score; `None` without one.
    pub fn mean(scores: &[Self]) -> Option<Self> {
        let of = |score: fn(&Self) -> f64| scores.iter().map(score).sum::<f64>() / scores.len() as f64;
        (!scores.is_empty()).then(|| Self {
            psnr: of(|score| score.psnr),
            psnr_channels: of(|score| score.psnr_channels),
            ssim: of(|score| score.ssim),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_two_ratios_are_those_of_the_reference() {
        let target = [[0.5, 0.5, 0.5]; 12];
        // Errors 0.1, 0.01 and 0.5 (clamped from more): 20, 40 and 6.02 dB.
        let rendered = [[0.6, 0.49, 1.7]; 12];
        let found = Score::of(&rendered, &target, (4, 3), &mut ImageLoss::default()).unwrap();
        let whole = -10.0 * ((0.01 + 0.0001 + 0.25) / 3.0_f64).log10();
        assert!((found.psnr - whole).abs() < 1e-4, "{found:?}");
        assert!((found.psnr_channels - (20.0 + 40.0 + 6.0206) / 3.0).abs() < 1e-3, "{found:?}");
        assert!(found.ssim < 1.0);
        let same = Score::of(&target, &target, (4, 3), &mut ImageLoss::default()).unwrap();
        assert!(same.psnr == f64::INFINITY && (same.ssim - 1.0).abs() < 1e-6);
        assert_eq!(Score::mean(&[found, found]), Some(found));
        assert_eq!(Score::mean(&[]), None);
    }
}
