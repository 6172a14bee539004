//! The scores of one flow against the ground truth, and the paper's regularizers of it.

use std::fmt;
use std::path::{Path, PathBuf};

use anyhow::{Context as _, bail};
use serde::{Deserialize, Serialize};
use srflow_core::{FlowField, Mask, Metrics, score};
use srflow_files::{read_flow, read_image, read_mask};
use srflow_train::loss::{FlowRegularizer, LossConfig, MaskReading, regularizers_of_flow};

use crate::clap::Args;
use crate::error::wrong_settings;
use crate::{Job, Report, Watch};

/// Score one flow against the ground truth, or evaluate the paper's regularizers on it
///
/// Prints the end-point error (EPE) and related scores over the pixels with ground truth, as ptlflow defines
/// them: px1, px3 and px5 are fractions under 1, 3 and 5 pixels, F1-ALL is the percentage of outliers (over 3
/// pixels and 5 %), WAUC runs from 0 to 100.
///
/// --regularizers prints the values of TVR, FDR, MIGAR and IGVAR for this flow with the paper's weights, and
/// how MIGAR and IGVAR weight the pixels; it needs no ground truth (docs/explanation/losses.md).
#[derive(Args, Debug, Clone, PartialEq, Serialize, Deserialize)]
#[command(after_help = "Examples:
  srflow metrics estimated.flo truth.png --mask head.png --json
  srflow metrics estimated.flo --image frame1.png --mask head.png --regularizers")]
pub struct MetricsJob {
    /// Predicted flow (.flo, KITTI .png, .pfm, .flo5, .npy, .npz)
    #[arg(value_name = "PRED")]
    pub prediction: PathBuf,
    /// Ground truth, in any of these formats
    #[arg(value_name = "GT", required_unless_present = "regularizers")]
    #[serde(default)]
    pub truth: Option<PathBuf>,
    /// Mask: score only pixels above 127, or of 1 in a mask of 0 and 1; for the regularizers, the head
    #[arg(long, value_name = "M.png")]
    #[serde(default)]
    pub mask: Option<PathBuf>,
    /// Evaluate the four regularizers on PRED
    #[arg(long, requires = "image")]
    #[serde(default)]
    pub regularizers: bool,
    /// First frame of PRED
    #[arg(long, value_name = "FRAME1", requires = "regularizers")]
    #[serde(default)]
    pub image: Option<PathBuf>,
    /// Value of a white pixel of FRAME1 for the gradients of MIGAR and IGVAR
    #[arg(long, value_name = "VALUE", default_value_t = white(), requires = "regularizers")]
    #[serde(default = "white")]
    pub image_max: f64,
    /// Pixels of the head that MIGAR and IGVAR use: all but the outline, or the paper's formula as printed
    #[arg(long, value_name = "READING", default_value = "interior", requires = "regularizers", value_parser = readings())]
    #[serde(default = "interior")]
    pub m_total: MaskReading,
}

fn white() -> f64 {
    255.0
}

fn interior() -> MaskReading {
    MaskReading::Interior
}

#[cfg(feature = "clap")]
fn readings() -> impl ::clap::builder::TypedValueParser<Value = MaskReading> {
    use ::clap::builder::{PossibleValuesParser, TypedValueParser as _};

    PossibleValuesParser::new(["interior", "literal"]).map(|name| match name.as_str() {
        "literal" => MaskReading::Literal,
        _ => MaskReading::Interior,
    })
}

impl MetricsJob {
    /// Scores the flow in the file `prediction` against the one in the file `truth`.
    pub fn new(prediction: impl Into<PathBuf>, truth: impl Into<PathBuf>) -> Self {
        Self {
            prediction: prediction.into(),
            truth: Some(truth.into()),
            mask: None,
            regularizers: false,
            image: None,
            image_max: white(),
            m_total: interior(),
        }
    }

    fn scores(
        &self,
        truth_file: &Path,
        prediction: &FlowField,
        mask: Option<&Mask>,
    ) -> anyhow::Result<Metrics> {
        let truth = read_flow(truth_file)?;
        let files = || {
            let mask = self.mask.as_ref().map(|mask| format!(", mask {}", mask.display()));
            let mask = mask.unwrap_or_default();
            format!("scoring {} against {}{mask}", self.prediction.display(), truth_file.display())
        };
        let Some(scores) = score(prediction, &truth, mask).with_context(files)? else {
            let inside = if mask.is_some() { " inside the mask" } else { "" };
            bail!("{}: nothing to score: the truth has no known pixel{inside}", files());
        };
        Ok(scores)
    }

    fn regularizers(
        &self,
        image_file: &Path,
        prediction: &FlowField,
        mask: Option<&Mask>,
    ) -> anyhow::Result<Vec<FlowRegularizer>> {
        let Self { image_max, m_total, .. } = *self;
        let config = LossConfig { image_max, m_total, ..LossConfig::default() };
        config.check().context("`image_max`")?;
        let frame = read_image(image_file)?;
        let files = || format!("regularizers of {} over {}", self.prediction.display(), image_file.display());
        regularizers_of_flow(&config, prediction, &frame, mask).with_context(files)
    }
}

impl Job for MetricsJob {
    const NAME: &'static str = "metrics";

    type Report = MetricsReport;

    fn work(&self, _: &Watch) -> anyhow::Result<MetricsReport> {
        let image = match (&self.image, self.regularizers) {
            (None, true) => wrong_settings!("`regularizers` needs `image`, the first frame of the flow"),
            (Some(_), false) => wrong_settings!("`image` is for `regularizers`: give both"),
            (image, _) => image.as_deref(),
        };
        if self.truth.is_none() && !self.regularizers {
            wrong_settings!("nothing to do: give `truth`, `regularizers` or both");
        }
        let prediction = read_flow(&self.prediction)?;
        let mask = self.mask.as_deref().map(read_mask).transpose()?;
        let scores = |truth| self.scores(truth, &prediction, mask.as_ref());
        let regularizers = |image| self.regularizers(image, &prediction, mask.as_ref());
        Ok(MetricsReport {
            scores: self.truth.as_deref().map(scores).transpose()?,
            regularizers: image.map(regularizers).transpose()?,
        })
    }
}

/// The scores of a flow where there is ground truth, and its regularizers where they were asked for.
#[derive(Debug, Clone, Serialize)]
pub struct MetricsReport {
    #[serde(flatten)]
    pub scores: Option<Metrics>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub regularizers: Option<Vec<FlowRegularizer>>,
}

impl Report for MetricsReport {}

impl fmt::Display for MetricsReport {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        if let Some(Metrics { epe, px1, px3, px5, f1_all, wauc, valid_pixels }) = &self.scores {
            writeln!(f, "EPE     {epe:9.4} px")?;
            writeln!(f, "px1     {px1:9.4}\npx3     {px3:9.4}\npx5     {px5:9.4}")?;
            writeln!(f, "F1-ALL  {f1_all:9.4} %\nWAUC    {wauc:9.4}\nover {valid_pixels} pixels")?;
        }
        for FlowRegularizer { title, value, weights, .. } in self.regularizers.iter().flatten() {
            write!(f, "{title:6}  {value:9.4e}")?;
            if let Some(weights) = weights {
                write!(
                    f,
                    "   base e^{:.3}, mean weight {:.3e} over {} pixels",
                    weights.log_base, weights.mean_weight, weights.pixels
                )?;
            }
            writeln!(f)?;
        }
        Ok(())
    }
}
