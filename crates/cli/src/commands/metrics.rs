use std::path::{Path, PathBuf};

use anyhow::{Context as _, bail};
use clap::Args;
use serde::Serialize;
use srflow_core::{FlowField, Mask, Metrics as Scores, score};
use srflow_files::{read_flow, read_image, read_mask};
use srflow_train::loss::{FlowRegularizer, LossConfig, MaskReading, regularizers_of_flow};

use crate::Context;

/// Score one flow against the truth, or evaluate the paper's regularizers on it
///
/// Prints the end-point error (EPE) and related scores over the pixels with ground truth, as ptlflow defines them: px1, px3
/// and px5 are fractions under 1, 3 and 5 pixels, F1-ALL is the percentage of outliers (over 3 pixels and 5 %), WAUC runs
/// from 0 to 100.
///
/// --regularizers prints the values of TVR, FDR, MIGAR and IGVAR for this flow with the paper's weights, and how MIGAR and
/// IGVAR weight the pixels; it needs no truth (docs/explanation/losses.md).
#[derive(Args)]
#[command(after_help = "Examples:
  srflow metrics estimated.flo truth.png --mask head.png --json
  srflow metrics estimated.flo --image frame1.png --mask head.png --regularizers")]
pub struct Metrics {
    /// Predicted flow (.flo, KITTI .png, .pfm, .flo5, .npy, .npz)
    #[arg(value_name = "PRED")]
    prediction: PathBuf,
    /// True flow, in any of these formats
    #[arg(value_name = "GT", required_unless_present = "regularizers")]
    truth: Option<PathBuf>,
    /// Mask: score only pixels where this image is over 127; for the regularizers, the head
    #[arg(long, value_name = "M.png")]
    mask: Option<PathBuf>,
    /// Print the four regularizers of PRED
    #[arg(long, requires = "image")]
    regularizers: bool,
    /// First frame of PRED
    #[arg(long, value_name = "FRAME1", requires = "regularizers")]
    image: Option<PathBuf>,
    /// Value of a white pixel of FRAME1 when MIGAR and IGVAR take its gradients
    #[arg(long, value_name = "VALUE", default_value_t = 255.0, requires = "regularizers")]
    image_max: f64,
    /// Pixels of the head that MIGAR and IGVAR use: all but the outline, or the paper's formula as printed
    #[arg(long, value_name = "READING", value_parser = ["interior", "literal"], default_value = "interior", requires = "regularizers")]
    m_total: String,
}

/// What `--json` prints.
#[derive(Serialize)]
struct Answer {
    #[serde(flatten)]
    scores: Option<Scores>,
    #[serde(skip_serializing_if = "Option::is_none")]
    regularizers: Option<Vec<FlowRegularizer>>,
}

pub fn run(args: Metrics, context: &Context) -> anyhow::Result<()> {
    let prediction = read_flow(&args.prediction)?;
    let mask = args.mask.as_deref().map(read_mask).transpose()?;
    let scores =
        args.truth.as_deref().map(|truth| scores(&args, truth, &prediction, mask.as_ref())).transpose()?;
    let regularizers = args
        .image
        .as_deref()
        .map(|image| regularizers(&args, image, &prediction, mask.as_ref()))
        .transpose()?;
    if context.json {
        crate::output::print_json_line(&Answer { scores, regularizers })?;
        return Ok(());
    }
    if let Some(scores) = scores {
        say!("{}", table(&scores).trim_end())?;
    }
    for line in regularizers.iter().flatten().map(regularizer_line) {
        say!("{line}")?;
    }
    Ok(())
}

fn scores(
    args: &Metrics,
    truth_file: &Path,
    prediction: &FlowField,
    mask: Option<&Mask>,
) -> anyhow::Result<Scores> {
    let truth = read_flow(truth_file)?;
    let files = || {
        let mask = args.mask.as_ref().map(|mask| format!(", mask {}", mask.display()));
        let mask = mask.unwrap_or_default();
        format!("scoring {} against {}{mask}", args.prediction.display(), truth_file.display())
    };
    let Some(scores) = score(prediction, &truth, mask).with_context(files)? else {
        let inside = if mask.is_some() { " inside the mask" } else { "" };
        bail!("{}: nothing to score: the truth has no known pixel{inside}", files());
    };
    Ok(scores)
}

fn regularizers(
    args: &Metrics,
    image_file: &Path,
    prediction: &FlowField,
    mask: Option<&Mask>,
) -> anyhow::Result<Vec<FlowRegularizer>> {
    let m_total = if args.m_total == "literal" { MaskReading::Literal } else { MaskReading::Interior };
    let config = LossConfig { image_max: args.image_max, m_total, ..LossConfig::default() };
    config.check().context("--image-max")?;
    let frame = read_image(image_file)?;
    let files = || format!("regularizers of {} over {}", args.prediction.display(), image_file.display());
    regularizers_of_flow(&config, prediction, &frame, mask).with_context(files)
}

fn table(scores: &Scores) -> String {
    let Scores { epe, px1, px3, px5, f1_all, wauc, valid_pixels } = scores;
    format!(
        "EPE     {epe:9.4} px\npx1     {px1:9.4}\npx3     {px3:9.4}\npx5     {px5:9.4}\nF1-ALL  {f1_all:9.4} %\n\
         WAUC    {wauc:9.4}\nover {valid_pixels} pixels\n"
    )
}

fn regularizer_line(regularizer: &FlowRegularizer) -> String {
    let weights = regularizer.weights.as_ref().map(|weights| {
        format!(
            "   base e^{:.3}, mean weight {:.3e} over {} pixels",
            weights.log_base, weights.mean_weight, weights.pixels
        )
    });
    format!("{:6}  {:9.4e}{}", regularizer.title, regularizer.value, weights.unwrap_or_default())
}
