use std::path::{Path, PathBuf};

use anyhow::Context as _;
use clap::Args;
use serde::Serialize;
use srflow_core::{FlowField, flow_colors, longest_flow};
use srflow_files::{FlowFormat, read_flow, write_flow_as, write_image_png};
use srflow_splat::{Gaussians, SplatFormat, Up, read_gaussians, write_gaussians};

use crate::Context;
use crate::output::ensure_free;
use crate::usage::wrong_usage;

/// Convert a flow or 3D Gaussians between file formats, or draw a flow in colours
///
/// Flow: the input format is detected from the first bytes, the output format from the extension: .flo, .png (KITTI's 16-bit
/// PNG), .png128, .pfm, .flo5, .npy, .npz or .npz16. All values and unknown pixels are kept; .png rounds to steps of 1/64
/// pixel, .png128 of 1/128, .npz16 of 1/256 (more where flow is longer than 128 pixels).
///
/// 3D Gaussians: both formats from the extension: .ply, .splat, .spz or .glb. What is upright in IN is upright in OUT: between formats
/// with another direction of up they are turned by 180 degrees about the x axis. docs/guides/rasterize.md lists what each format keeps.
/// `srflow avatar export` writes the Gaussians of a head.
#[derive(Args)]
#[command(after_help = "Examples:
  srflow convert flow.flo5 flow.flo
  srflow convert flow.flo colours.png --viz --max 20
  srflow convert head.ply head.glb
  srflow convert point_cloud.ply scene.spz --ply-up=-y")]
pub struct Convert {
    /// Flow or Gaussians to read
    #[arg(value_name = "IN")]
    input: PathBuf,
    /// File to write
    #[arg(value_name = "OUT")]
    output: PathBuf,
    /// Draw the flow in the colours of Middlebury's wheel, as a .png; unknown pixels are black
    #[arg(long)]
    viz: bool,
    /// Length of the flow with full colour, in pixels (default: the longest of the picture)
    #[arg(long, value_name = "PIXELS", requires = "viz", value_parser = positive)]
    max: Option<f32>,
    /// Direction that is up in a .ply of Gaussians, which does not say so: y, as for heads of srflow, or -y, as for most scenes that
    /// were reconstructed from photographs
    #[arg(long, value_name = "AXIS", allow_hyphen_values = true, default_value = "y", value_parser = parse_up)]
    ply_up: Up,
    /// Overwrite OUT
    #[arg(long)]
    force: bool,
}

/// A length above 0 in pixels.
pub fn positive(text: &str) -> Result<f32, String> {
    match text.parse() {
        Ok(number) if number > 0.0 && f32::is_finite(number) => Ok(number),
        _ => Err("expected a positive number of pixels, such as 20".to_owned()),
    }
}

/// What `--json` prints.
#[derive(Serialize)]
struct Converted {
    output: PathBuf,
    width: usize,
    height: usize,
    known_pixels: usize,
    /// Length of the longest known flow in pixels.
    longest: f32,
}

/// What `--json` prints of Gaussians.
#[derive(Serialize)]
struct ConvertedGaussians<'a> {
    output: &'a Path,
    gaussians: usize,
    sh_degree: usize,
    antialiased: bool,
}

pub fn run(args: Convert, context: &Context) -> anyhow::Result<()> {
    if let Some((from, to)) = splat_formats(&args)? {
        return convert_gaussians(&args, from, to, context);
    }
    let target = Target::of(&args.output, args.viz)?;
    ensure_free([&args.output], args.force)?;
    let flow = read_flow(&args.input)?;
    match target {
        Target::Picture => write_image_png(&args.output, &flow_colors(&flow, args.max)),
        Target::Flow(format) => write_flow_as(&args.output, &flow, format),
    }
    .with_context(|| format!("converting {}", args.input.display()))?;
    if context.json {
        crate::output::print_json_line(&converted(args.output, &flow))?;
    }
    Ok(())
}

/// The formats of IN and OUT if they are of Gaussians.
fn splat_formats(args: &Convert) -> anyhow::Result<Option<(&'static SplatFormat, &'static SplatFormat)>> {
    let (input, output) = (args.input.display(), args.output.display());
    let known = SplatFormat::extensions();
    match (SplatFormat::of(&args.input), SplatFormat::of(&args.output)) {
        (Some(_), Some(_)) if args.viz => wrong_usage!("--viz draws a flow: {input} holds Gaussians"),
        (Some(from), Some(to)) => Ok(Some((from, to))),
        (Some(_), None) => {
            wrong_usage!("{output}: {input} holds Gaussians: expected a name ending in one of {known}")
        }
        (None, Some(_)) => {
            wrong_usage!("{output}: Gaussians are read from a file ending in one of {known}, found {input}")
        }
        (None, None) => Ok(None),
    }
}

/// Between files of Gaussians.
fn convert_gaussians(
    args: &Convert,
    from: &SplatFormat,
    to: &SplatFormat,
    context: &Context,
) -> anyhow::Result<()> {
    ensure_free([&args.output], args.force)?;
    let mut gaussians = read_gaussians(&args.input)?;
    if from.up.unwrap_or(args.ply_up) != to.up.unwrap_or(args.ply_up) {
        gaussians.turn_about_x();
    }
    write_gaussians(&args.output, &gaussians)
        .with_context(|| format!("converting {}", args.input.display()))?;
    report_gaussians(&args.output, to, &gaussians, context)
}

/// Notes what the format of the file lost, and prints the result with `--json`.
pub fn report_gaussians(
    output: &Path,
    format: &SplatFormat,
    gaussians: &Gaussians,
    context: &Context,
) -> anyhow::Result<()> {
    if let Some(lost) = format.loses {
        note!("note: {}: a .{} file does not keep {lost}", output.display(), format.extension);
    }
    if context.json {
        crate::output::print_json_line(&ConvertedGaussians {
            output,
            gaussians: gaussians.len(),
            sh_degree: gaussians.sh_degree,
            antialiased: gaussians.antialiased,
        })?;
    }
    Ok(())
}

/// `y` or `-y`, as for `--ply-up`.
pub fn parse_up(text: &str) -> Result<Up, String> {
    match text {
        "y" | "+y" => Ok(Up::PlusY),
        "-y" => Ok(Up::MinusY),
        _ => Err("expected y or -y".to_owned()),
    }
}

enum Target {
    Picture,
    Flow(FlowFormat),
}

impl Target {
    fn of(output: &Path, viz: bool) -> anyhow::Result<Self> {
        match FlowFormat::from_path(output) {
            Some(FlowFormat::KittiPng) if viz => Ok(Self::Picture),
            _ if viz => {
                wrong_usage!("{}: --viz draws a picture: expected a name ending in .png", output.display())
            }
            Some(format) => Ok(Self::Flow(format)),
            None => {
                let formats = FlowFormat::ALL.map(|format| format!(".{format}")).join(", ");
                wrong_usage!(
                    "{}: expected a name ending in one of {formats} for a flow, or {} for Gaussians",
                    output.display(),
                    SplatFormat::extensions()
                )
            }
        }
    }
}

fn converted(output: PathBuf, flow: &FlowField) -> Converted {
    let known = flow.known();
    Converted {
        output,
        width: flow.width(),
        height: flow.height(),
        known_pixels: known.pixels().iter().filter(|known| **known).count(),
        longest: longest_flow(flow),
    }
}
