use std::path::PathBuf;

use clap::Args;
use srflow_core::Size;
use srflow_files::FlowFormat;
use srflow_render::shapes::{ShapesReport, ShapesSettings, shapes};

use super::render::{flow_format_help, numbers};
use crate::Context;
use crate::rendering::{RenderingArgs, exit_if_stopped};

/// Make a dataset of generic pairs with exact flow and occlusion, to start training from
#[derive(Args)]
#[command(after_help = "\
Examples:
  srflow shapes --out shapes --pairs 2000
  srflow shapes --out subpixel --pairs 2000 --motion 0.05,1
  srflow train --config cpu-small --data chairs:shapes --out runs/start

The same command given again continues where a run was stopped. docs/reference/shapes.md describes the pairs and their files, whose
layout is that of FlyingChairs: other programs can read them too.")]
pub struct Shapes {
    /// Folder of the dataset
    #[arg(short, long, value_name = "DIR")]
    out: PathBuf,
    /// Number of pairs
    #[arg(long, value_name = "N", default_value_t = ShapesSettings::default().pairs)]
    pairs: u32,
    /// Size of the frames, WIDTHxHEIGHT
    #[arg(long, value_name = "SIZE", default_value = "512x384")]
    size: Size,
    /// Typical motion in pixels, from the shortest to the longest; each octave is equally likely
    #[arg(long, value_name = "SHORTEST,LONGEST", default_value = "0.25,32", value_parser = lengths)]
    motion: Lengths,
    /// Folder of images that half of the layers show (default: textures made by code)
    #[arg(long, value_name = "DIR")]
    textures: Option<PathBuf>,
    /// Random seed
    #[arg(long, value_name = "N", default_value_t = ShapesSettings::default().seed)]
    seed: u64,
    /// File format of the flow
    #[arg(long, value_name = "FORMAT", default_value_t = ShapesSettings::default().flow_format, help = flow_format_help())]
    flow_format: FlowFormat,
    #[command(flatten)]
    rendering: RenderingArgs,
}

type Lengths = [f32; 2];

fn lengths(text: &str) -> Result<Lengths, String> {
    numbers(text).ok_or_else(|| format!("expected two lengths in pixels, e.g. 0.25,32, found `{text}`"))
}

pub fn run(args: Shapes, context: &Context) -> anyhow::Result<()> {
    let settings = ShapesSettings {
        pairs: args.pairs,
        width: args.size.width,
        height: args.size.height,
        seed: args.seed,
        motion: args.motion,
        textures: args.textures,
        flow_format: args.flow_format,
    };
    let rendered = args.rendering.make(&args.out, "pairs", |request| shapes(&settings, request))?;
    let ShapesReport { pairs, made, bytes, seconds, stopped, is_whole } = rendered.report;
    if context.json {
        rendered.print_json()?;
    } else {
        let per_minute = if made == 0 { 0.0 } else { 60.0 * made as f64 / seconds };
        say!(
            "{made} of {pairs} pairs made in {seconds:.1} s: {per_minute:.0} pairs a minute, {:.1} MB",
            bytes as f64 / 1e6
        )?;
        if is_whole {
            say!("read it with chairs:{}", args.out.display())?;
        } else if !stopped {
            rendered.print_part("the list of the splits")?;
        }
    }
    exit_if_stopped(stopped)
}
