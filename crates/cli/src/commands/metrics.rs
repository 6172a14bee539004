use std::path::PathBuf;

use anyhow::{Context as _, bail};
use clap::Args;
use srflow_field::{Metrics as Scores, read_flow, read_mask, score};

use crate::Context;

/// Score one flow against the truth
///
/// The end-point error (EPE) and its kin over the pixels where the truth is known, as ptlflow defines them: px1, px3 and
/// px5 are fractions under 1, 3 and 5 pixels, F1-ALL is the percentage of outliers (over 3 pixels and 5 %), WAUC runs
/// from 0 to 100.
#[derive(Args)]
#[command(after_help = "Example:
  srflow metrics estimated.flo truth.png --mask head.png --json")]
pub struct Metrics {
    /// Predicted flow (.flo, .png of KITTI, .pfm, .flo5, .npy, .npz)
    #[arg(value_name = "PRED")]
    prediction: PathBuf,
    /// True flow, in any of these formats
    #[arg(value_name = "GT")]
    truth: PathBuf,
    /// Score only where this image is over 127
    #[arg(long, value_name = "M.png")]
    mask: Option<PathBuf>,
}

/// Runs the command.
pub fn run(args: Metrics, context: &Context) -> anyhow::Result<()> {
    let prediction = read_flow(&args.prediction)?;
    let truth = read_flow(&args.truth)?;
    let mask = args.mask.as_deref().map(read_mask).transpose()?;
    let files = || {
        let mask = args.mask.as_ref().map(|mask| format!(", mask {}", mask.display()));
        let mask = mask.unwrap_or_default();
        format!("scoring {} against {}{mask}", args.prediction.display(), args.truth.display())
    };
    let Some(scores) = score(&prediction, &truth, mask.as_ref()).with_context(files)? else {
        let inside = if mask.is_some() { " inside the mask" } else { "" };
        bail!(
            "{}: there is nothing to score: expected a known pixel of the truth{inside}, found none",
            files()
        );
    };
    if context.json {
        say!("{}", serde_json::to_string(&scores)?)?;
    } else {
        say!("{}", table(&scores).trim_end())?;
    }
    Ok(())
}

fn table(scores: &Scores) -> String {
    let Scores { epe, px1, px3, px5, f1_all, wauc, valid_pixels } = scores;
    format!(
        "EPE     {epe:9.4} px\npx1     {px1:9.4}\npx3     {px3:9.4}\npx5     {px5:9.4}\nF1-ALL  {f1_all:9.4} %\n\
         WAUC    {wauc:9.4}\nover {valid_pixels} pixels\n"
    )
}
