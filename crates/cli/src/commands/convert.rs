use std::path::{Path, PathBuf};

use anyhow::Context as _;
use clap::Args;
use serde::Serialize;
use srflow_field::{
    FlowField, FlowFormat, flow_colors, longest_flow, read_flow, write_flow_as, write_image_png,
};

use crate::Context;
use crate::output::ensure_free;
use crate::usage::wrong_usage;

/// Convert a flow between file formats, or draw it in colours
///
/// The input format is detected from the first bytes, the output format from the extension: .flo, .png (KITTI's 16-bit
/// PNG), .png128, .pfm, .flo5, .npy, .npz or .npz16. All values and unknown pixels are kept; .png rounds to steps of 1/64
/// pixel, .png128 of 1/128, .npz16 of 1/256 (more where flow is longer than 128 pixels).
#[derive(Args)]
#[command(after_help = "Examples:
  srflow convert flow.flo5 flow.flo
  srflow convert flow.flo colours.png --viz --max 20")]
pub struct Convert {
    /// Flow to read
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

pub fn run(args: Convert, context: &Context) -> anyhow::Result<()> {
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
                wrong_usage!("{}: expected a name ending in one of {formats}", output.display())
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
