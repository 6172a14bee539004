use std::path::PathBuf;

use anyhow::ensure;
use clap::Args;
use serde::Serialize;
use srflow_files::{read_image, write_image_png, write_npy, write_npy_plane};
use srflow_mer::{
    Channel, FEATURE_SIDE, ResizeOrder, StrainFormula, features_of_frames, optical_strain, strain_colors,
};

use crate::Context;
use crate::methods::{self, Method, MethodParameters, MethodSpec};
use crate::output::{ensure_extension, ensure_free};

/// Compute the optical strain between two frames
#[derive(Args)]
#[command(after_help = "\
Examples:
  srflow mer strain onset.png apex.png -o strain.npy --viz strain.png
  srflow mer strain onset.png apex.png -o strain.npy --formula off-tanet --method tvl1
  srflow mer strain onset.png apex.png -o strain.npy --size full

The literature's formula is sqrt(ux^2 + vy^2 + (uy + vx)^2 / 2) with derivatives per pixel; off-tanet is what that \
network's published code computes, including its error (see docs/explanation/micro-expression-protocol.md).")]
pub struct Strain {
    /// Onset frame
    #[arg(value_name = "A")]
    onset: PathBuf,
    /// Apex frame
    #[arg(value_name = "B")]
    apex: PathBuf,
    /// Strain as .npy array of shape (H, W)
    #[arg(short, long, value_name = "FILE")]
    out: PathBuf,
    /// Also write u, v and strain, as .npy array of shape (3, 112, 112)
    #[arg(long, value_name = "FILE", conflicts_with = "size")]
    features: Option<PathBuf>,
    /// Draw the strain: black is zero, white the largest
    #[arg(long, value_name = "PNG")]
    viz: Option<PathBuf>,
    /// Strain drawn white [default: the largest]
    #[arg(long, value_name = "STRAIN", requires = "viz", value_parser = super::super::convert::positive)]
    viz_max: Option<f32>,
    /// How to estimate the flow
    #[arg(long, value_name = "METHOD", default_value = Method::DEFAULT.name(), help = Method::help())]
    method: MethodSpec,
    /// Formula: literature or off-tanet
    #[arg(long, value_name = "FORMULA", default_value_t = StrainFormula::Literature)]
    formula: StrainFormula,
    /// Resize the frames to 112x112 before the flow is estimated, or the flow after
    #[arg(long, value_name = "ORDER", default_value_t = ResizeOrder::Before, conflicts_with = "size")]
    resize: ResizeOrder,
    /// Size of the result: 112x112, the input of classifiers, or `full`, that of the frames
    #[arg(long, value_name = "SIZE", default_value = "112x112", value_parser = ["112x112", "full"])]
    size: String,
    /// Overwrite existing files
    #[arg(long)]
    force: bool,
    #[command(flatten)]
    parameters: MethodParameters,
}

#[derive(Serialize)]
struct Strained {
    output: PathBuf,
    method: String,
    formula: &'static str,
    /// `None` at full size.
    resize: Option<&'static str>,
    width: usize,
    height: usize,
    mean_strain: f64,
    max_strain: f32,
}

pub fn run(args: Strain, context: &Context) -> anyhow::Result<()> {
    let estimator = methods::estimator(&args.method, &args.parameters)?;
    let outputs = [Some(&args.out), args.features.as_ref(), args.viz.as_ref()];
    for (path, extension) in outputs.into_iter().zip(["npy", "npy", "png"]) {
        path.map_or(Ok(()), |path| ensure_extension(path, extension))?;
    }
    ensure_free(outputs.into_iter().flatten(), args.force)?;
    let (onset, apex) = (read_image(&args.onset)?, read_image(&args.apex)?);
    ensure!(
        onset.size() == apex.size() && !onset.pixels().is_empty(),
        "{} is {}x{} and {} {}x{} (WIDTHxHEIGHT): give two frames of one size",
        args.onset.display(),
        onset.width(),
        onset.height(),
        args.apex.display(),
        apex.width(),
        apex.height()
    );
    let full = args.size == "full";
    let strain = if full {
        optical_strain(&estimator.estimate(&onset, &apex)?, args.formula)
    } else {
        let features = features_of_frames(&onset, &apex, estimator.as_ref(), args.resize, args.formula)?;
        if let Some(path) = &args.features {
            write_npy(path, &[3, FEATURE_SIDE, FEATURE_SIDE], features.values())?;
        }
        features.plane(Channel::Strain)
    };
    write_npy_plane(&args.out, &strain)?;
    if let Some(path) = &args.viz {
        write_image_png(path, &strain_colors(&strain, args.viz_max))?;
    }
    let pixels = strain.pixels();
    let strained = Strained {
        output: args.out,
        method: estimator.name().to_owned(),
        formula: args.formula.name(),
        resize: (!full).then_some(args.resize.name()),
        width: strain.width(),
        height: strain.height(),
        mean_strain: pixels.iter().map(|&value| f64::from(value)).sum::<f64>() / pixels.len().max(1) as f64,
        max_strain: pixels.iter().copied().fold(0.0, f32::max),
    };
    if context.json {
        return crate::output::print_json_line(&strained);
    }
    say!(
        "{}: {}x{}, mean strain {:.5}, maximum {:.5}",
        strained.output.display(),
        strained.width,
        strained.height,
        strained.mean_strain,
        strained.max_strain
    )
}
