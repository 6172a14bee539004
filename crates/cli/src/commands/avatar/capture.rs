use std::path::PathBuf;

use clap::Args;
use srflow_avatar::HeadSource;
use srflow_core::{Size, parse_color};
use srflow_render::capture::{CaptureReport, CaptureSettings, capture};

use crate::Context;
use crate::commands::render::head_help;
use crate::rendering::{RenderingArgs, exit_if_stopped};

/// Capture a moving head by many cameras, in the files that VHAP exports and GaussianAvatars is trained on
#[derive(Args)]
#[command(after_help = "\
Examples:
  srflow avatar capture --out capture
  srflow avatar capture --out hard --noise 1 --calibration-noise 1 --landmark-noise 1.5
  srflow avatar capture --out small --cameras 4 --timesteps 30 --size 220x320

Everything true is known: alpha, cameras, the parameters of the head and its landmarks. The same command given again continues
where a run was stopped. The files are described in docs/reference/avatar-files.md.")]
pub struct Capture {
    /// Folder of the capture
    #[arg(short, long, value_name = "DIR")]
    out: PathBuf,
    /// Head model
    #[arg(long, value_name = "HEAD", default_value = "builtin", help = head_help())]
    head: HeadSource,
    /// Number of cameras, 1 to 16
    #[arg(long, value_name = "N", default_value_t = CaptureSettings::default().cameras)]
    cameras: usize,
    /// Number of timesteps
    #[arg(long, value_name = "N", default_value_t = CaptureSettings::default().timesteps)]
    timesteps: u32,
    /// Size of the pictures, WIDTHxHEIGHT
    #[arg(long, value_name = "SIZE", default_value = "550x802")]
    size: Size,
    /// Background colour: white, black, #rrggbb or R,G,B (0 to 255 each)
    #[arg(long, value_name = "COLOUR", default_value = "white", value_parser = parse_color)]
    background: [u8; 3],
    /// Sensor noise on the head; 1 is a standard deviation of about 1.8 of 255 in mid-grey
    #[arg(long, value_name = "FACTOR", default_value_t = 0.0)]
    noise: f32,
    /// Error of the cameras in transforms.json; 1 is about half a pixel at 550x802
    #[arg(long, value_name = "FACTOR", default_value_t = 0.0)]
    calibration_noise: f32,
    /// Standard deviation of the landmarks in landmarks.csv, in pixels
    #[arg(long, value_name = "PIXELS", default_value_t = 0.0)]
    landmark_noise: f32,
    /// Random seed of the person, the motion and the noise
    #[arg(long, value_name = "N", default_value_t = CaptureSettings::default().seed)]
    seed: u64,
    #[command(flatten)]
    rendering: RenderingArgs,
}

pub fn run(args: Capture, context: &Context) -> anyhow::Result<()> {
    let settings = CaptureSettings {
        head: args.head,
        cameras: args.cameras,
        timesteps: args.timesteps,
        width: args.size.width,
        height: args.size.height,
        seed: args.seed,
        background: args.background,
        noise: args.noise,
        calibration_noise: args.calibration_noise,
        landmark_noise: args.landmark_noise,
    };
    let rendered = args.rendering.make(&args.out, "timesteps", |request| capture(&settings, request))?;
    if context.json {
        rendered.print_json()?;
    } else {
        print_report(&rendered.report)?;
    }
    exit_if_stopped(rendered.report.stopped)
}

fn print_report(report: &CaptureReport) -> anyhow::Result<()> {
    let CaptureReport { timesteps, made, cameras, bytes, seconds, stopped, complete, .. } = report;
    say!(
        "{made} of {timesteps} timesteps by {cameras} cameras rendered in {seconds:.1} s: {:.1} pictures a second, {:.1} MB",
        *made as f64 * *cameras as f64 / seconds.max(1e-9),
        *bytes as f64 / 1e6
    )?;
    if !complete && !stopped {
        say!(
            "This part is complete. Copy the parts together; `srflow avatar capture` with the same arguments and without --shard\n\
             then writes transforms.json and the other files of the whole."
        )?;
    }
    Ok(())
}
