use serde::{Deserialize, Serialize};

use super::LossError;

/// What is minimised: one sequence loss, and any of the four regularizers.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct LossConfig {
    /// How a predicted flow is held against the truth.
    pub sequence: SequenceKind,
    /// Each prediction counts `gamma` times what the next one does, in the sequence loss and in every regularizer; in
    /// (0, 1]. SKFlow: 0.8, and 0.85 for fine-tuning on Sintel and KITTI.
    pub gamma: f64,
    /// A pixel whose true motion is this long or longer does not count in the sequence loss, in pixels.
    pub max_magnitude: f64,
    /// Limits of the mixture's log scales: of the first component 0 and the second number, of the other the first number
    /// and 0. SEA-RAFT: 0 and 10.
    pub log_scale_range: [f64; 2],
    /// Weight of TVR, 0 for none. The paper: [`Regularizer::paper_weight`].
    pub tvr: f64,
    /// Weight of FDR, 0 for none.
    pub fdr: f64,
    /// Weight of MIGAR, 0 for none.
    pub migar: f64,
    /// Weight of IGVAR, 0 for none.
    pub igvar: f64,
    /// Which pixels of the head MIGAR and IGVAR look at.
    pub m_total: MaskReading,
    /// What lies outside the image for the Sobel operator.
    pub border: Border,
    /// The value of a white pixel when the first frame's gradients are taken for MIGAR and IGVAR. 255, or 1 for frames
    /// in 0..1.
    pub image_max: f64,
}

impl Default for LossConfig {
    /// SKFlow's loss, without regularizers.
    fn default() -> Self {
        Self {
            sequence: SequenceKind::L1,
            gamma: 0.8,
            max_magnitude: 400.0,
            log_scale_range: [0.0, 10.0],
            tvr: 0.0,
            fdr: 0.0,
            migar: 0.0,
            igvar: 0.0,
            m_total: MaskReading::Interior,
            border: Border::Replicate,
            image_max: 255.0,
        }
    }
}

/// How a predicted flow is held against the truth.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum SequenceKind {
    /// The mean absolute difference of the components; RAFT's and SKFlow's.
    L1,
    /// The mean end-point distance.
    L2,
    /// The negative log-likelihood under two Laplace distributions that the network predicts for each pixel; SEA-RAFT's.
    MixtureOfLaplace,
}

/// One of the paper's regularizers.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Regularizer {
    /// Total variation.
    Tvr,
    /// Flow difference.
    Fdr,
    /// Mean image gradient activation.
    Migar,
    /// Image gradient variance activation.
    Igvar,
}

impl Regularizer {
    /// In the paper's order.
    pub const ALL: [Self; 4] = [Self::Tvr, Self::Fdr, Self::Migar, Self::Igvar];

    /// The name in configurations, logs and tables.
    pub fn name(self) -> &'static str {
        match self {
            Self::Tvr => "tvr",
            Self::Fdr => "fdr",
            Self::Migar => "migar",
            Self::Igvar => "igvar",
        }
    }

    /// The paper's weight: `lambda_N` of TVR and FDR, none (1) of MIGAR and IGVAR.
    pub fn paper_weight(self) -> f64 {
        match self {
            Self::Tvr | Self::Fdr => 0.05,
            Self::Migar | Self::Igvar => 1.0,
        }
    }
}

/// How the paper's formula of `M_total` (equation 16) is read.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum MaskReading {
    /// The pixels of the head at which the mask's gradient is zero: all but the outline.
    Interior,
    /// The pixels of the head at which both components of the mask's gradient are above zero, as it is printed: only those
    /// on outlines that face up and to the left.
    Literal,
}

/// What lies outside the image for the Sobel operator.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Border {
    /// The nearest pixel, so that a constant image has no gradient anywhere.
    Replicate,
    /// Zeros, as a convolution with padding has.
    Zero,
}

impl LossConfig {
    /// The weight of a regularizer; 0 where it is off.
    pub fn weight(&self, regularizer: Regularizer) -> f64 {
        match regularizer {
            Regularizer::Tvr => self.tvr,
            Regularizer::Fdr => self.fdr,
            Regularizer::Migar => self.migar,
            Regularizer::Igvar => self.igvar,
        }
    }

    /// This configuration with another weight of one regularizer.
    pub fn with(mut self, regularizer: Regularizer, weight: f64) -> Self {
        match regularizer {
            Regularizer::Tvr => self.tvr = weight,
            Regularizer::Fdr => self.fdr = weight,
            Regularizer::Migar => self.migar = weight,
            Regularizer::Igvar => self.igvar = weight,
        }
        self
    }

    /// Whether every number makes sense.
    ///
    /// # Errors
    /// Names the first that does not, and what it may be.
    pub fn check(&self) -> Result<(), LossError> {
        let wrong = |key, found: String, expected| Err(LossError::Setting { key, found, expected });
        if !(self.gamma > 0.0 && self.gamma <= 1.0) {
            return wrong("gamma", self.gamma.to_string(), "a number above 0 and at most 1");
        }
        if self.max_magnitude.is_nan() || self.max_magnitude <= 0.0 {
            return wrong("max_magnitude", self.max_magnitude.to_string(), "a length above 0, in pixels");
        }
        let [low, high] = self.log_scale_range;
        if !(low <= 0.0 && high >= 0.0 && low >= -50.0 && high <= 50.0) {
            return wrong(
                "log_scale_range",
                format!("[{low}, {high}]"),
                "[a, b] with -50 <= a <= 0 <= b <= 50",
            );
        }
        for regularizer in Regularizer::ALL {
            let weight = self.weight(regularizer);
            if !(weight >= 0.0 && weight.is_finite()) {
                return wrong(regularizer.name(), weight.to_string(), "a weight of 0 or more");
            }
        }
        if !(self.image_max > 0.0 && self.image_max <= 65535.0) {
            return wrong(
                "image_max",
                self.image_max.to_string(),
                "255, 1 or another number above 0 and at most 65535",
            );
        }
        Ok(())
    }
}
