use std::path::PathBuf;

use clap::Args;
use srflow_files::FlowFormat;
use srflow_render::synth::{SynthReport, SynthSettings, synthesize};

use crate::Context;
use crate::rendering::{Rendered, RenderingArgs, exit_if_stopped};

/// Render a labelled micro-expression dataset with the built-in heads
#[derive(Args)]
#[command(after_help = "\
Examples:
  srflow mer synth --out synth
  srflow mer synth --out hard --subjects 30 --clips 9 --intensity 0.6 --noise 2 --drift 2
  srflow mer data clips:synth

Along with the frames it writes the true flow from onset to apex, the action units with their intensities, and the 68 \
landmarks of the onset. Run the same command again to continue an interrupted run.")]
pub struct Synth {
    /// Folder of the dataset
    #[arg(short, long, value_name = "DIR")]
    out: PathBuf,
    /// Number of subjects
    #[arg(long, value_name = "N", default_value_t = SynthSettings::default().subjects)]
    subjects: u32,
    /// Clips per subject; negative, positive and surprise alternate
    #[arg(long, value_name = "N", default_value_t = SynthSettings::default().clips_per_subject)]
    clips: u32,
    /// Width and height of the frames in pixels
    #[arg(long, value_name = "PIXELS", default_value_t = SynthSettings::default().side)]
    side: usize,
    /// Frames per second
    #[arg(long, value_name = "RATE", default_value_t = SynthSettings::default().frames_per_second)]
    fps: f32,
    /// Strength of the expressions; 1 is 12 to 40 % of an action unit's full strength
    #[arg(long, value_name = "FACTOR", default_value_t = SynthSettings::default().intensity)]
    intensity: f32,
    /// Sensor noise; 1 is a standard deviation of about 1.8 of 255 in mid-grey, 0 is none
    #[arg(long, value_name = "FACTOR", default_value_t = SynthSettings::default().noise)]
    noise: f32,
    /// Head drift; 1 is up to a tenth of a degree and 0.15 mm to either side, 0 is none
    #[arg(long, value_name = "FACTOR", default_value_t = SynthSettings::default().drift)]
    drift: f32,
    /// Illumination changes; 1 is up to 2 % with a gradient, and slight flicker, 0 is none
    #[arg(long, value_name = "FACTOR", default_value_t = SynthSettings::default().lighting)]
    lighting: f32,
    /// Random seed
    #[arg(long, value_name = "N", default_value_t = SynthSettings::default().seed)]
    seed: u64,
    /// File format of the true flow
    #[arg(long, value_name = "FORMAT", default_value_t = SynthSettings::default().flow_format)]
    flow_format: FlowFormat,
    #[command(flatten)]
    rendering: RenderingArgs,
}

pub fn run(args: Synth, context: &Context) -> anyhow::Result<()> {
    let settings = SynthSettings {
        subjects: args.subjects,
        clips_per_subject: args.clips,
        side: args.side,
        frames_per_second: args.fps,
        intensity: args.intensity,
        noise: args.noise,
        drift: args.drift,
        lighting: args.lighting,
        seed: args.seed,
        flow_format: args.flow_format,
    };
    let rendered = args.rendering.make(&args.out, "clips", |request| synthesize(&settings, request))?;
    if context.json {
        rendered.print_json()?;
    } else {
        print_report(&args, &rendered)?;
    }
    exit_if_stopped(rendered.report.stopped)
}

fn print_report(args: &Synth, rendered: &Rendered<SynthReport>) -> anyhow::Result<()> {
    let report = &rendered.report;
    let SynthReport { clips, made, subjects, classes, seconds, .. } = report;
    say!("{made} of {clips} clips rendered in {seconds:.1} s")?;
    let (Some(frames), Some(mean_flow)) = (report.frames, report.mean_flow) else {
        return if report.stopped { Ok(()) } else { rendered.print_part("the tables") };
    };
    let classes: Vec<String> = classes.iter().map(|(class, clips)| format!("{clips} {class}")).collect();
    say!("{subjects} subjects, {frames} frames, {}", classes.join(", "))?;
    say!("true flow from onset to apex: {mean_flow:.3} px on average on the head")?;
    say!("read it with clips:{}", args.out.display())
}
