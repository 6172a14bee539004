use std::num::NonZeroUsize;
use std::path::PathBuf;
use std::time::Instant;

use clap::{Args, Subcommand};
use glam::{DMat4, DVec4, Quat, Vec3};
use serde::Serialize;
use serde_json::json;
use srflow_avatar::{Avatar, HeadPose, PosedHead};
use srflow_core::{FlowEstimator as _, FlowField, Image, Size};
use srflow_nets::{Architecture, NetworkEstimator, load_included, load_network};
use srflow_ops::{DeviceError, Precision, device_kinds, precisions};
use srflow_splat::{Camera, Device, DeviceRasterizer, Frame, Gaussians, Next, Options, Outputs};

use crate::Context;
use crate::networks::{PrecisionArg, device_help};
use crate::output::print_json;
use srflow::wrong_settings;

/// List the devices of this machine, or time and check one
///
/// Without a subcommand: lists every device that this build supports and the drivers find.
#[derive(Args)]
#[command(after_help = "\
Examples:
  srflow device
  srflow device network raft --device vulkan --size 800x512
  srflow device rasterizer --device vulkan --against-cpu

tools/gpu/measure runs all of it and writes a report; see docs/guides/gpu.md.")]
pub struct DeviceArgs {
    #[command(subcommand)]
    action: Option<Action>,
}

#[derive(Subcommand)]
enum Action {
    Network(NetworkAction),
    Rasterizer(RasterizerAction),
}

/// Time a network on two frames of the built-in head
///
/// Times include the transfer of frames and flow. Without weights the parameters are those that come with srflow, or random.
#[derive(Args)]
struct NetworkAction {
    /// Name of the network; `srflow models` lists them
    #[arg(value_name = "NETWORK")]
    network: String,
    /// Refinement iterations [default: the network's own]
    #[arg(long, value_name = "N")]
    iters: Option<NonZeroUsize>,
    /// File of weights
    #[arg(long, value_name = "FILE")]
    weights: Option<PathBuf>,
    /// What the network multiplies on the device; on the CPU, with --against-cpu, f32
    #[arg(long, value_name = "PRECISION", default_value_t)]
    precision: PrecisionArg,
    #[command(flatten)]
    timing: Timing,
}

/// Time the rasterizer: frame, flow, alpha and depths of the built-in head
#[derive(Args)]
struct RasterizerAction {
    #[command(flatten)]
    timing: Timing,
}

#[derive(Args)]
struct Timing {
    #[arg(long, value_name = "DEVICE", default_value = "cpu", value_parser = known, help = device_help())]
    device: String,
    /// Size of the frames, WIDTHxHEIGHT
    #[arg(long, value_name = "SIZE", default_value = "800x512")]
    size: Size,
    /// How often; the first time includes the compilation of kernels
    #[arg(long, value_name = "N", default_value_t = 4, value_parser = clap::value_parser!(u32).range(1..=1000))]
    repeats: u32,
    /// Also compute on the CPU, and print the differences
    #[arg(long)]
    against_cpu: bool,
}

/// The name of a device that exists.
fn known(name: &str) -> Result<String, DeviceError> {
    Device::named(name).map(|_| name.to_owned())
}

/// What one thing took on a device.
#[derive(Serialize)]
struct Times {
    device: String,
    device_name: String,
    width: usize,
    height: usize,
    seconds: Vec<f64>,
    /// Of all but the first.
    median_seconds: f64,
}

impl Timing {
    /// Calls `of` for each repetition; the last result.
    fn time<T>(&self, mut of: impl FnMut() -> anyhow::Result<T>) -> anyhow::Result<(Times, T)> {
        let device = Device::named(&self.device)?;
        let (mut seconds, mut last) = (Vec::new(), None);
        for _ in 0..self.repeats {
            let start = Instant::now();
            last = Some(of()?);
            seconds.push(start.elapsed().as_secs_f64());
        }
        let mut later = seconds[usize::from(seconds.len() > 1)..].to_vec();
        later.sort_by(f64::total_cmp);
        let times = Times {
            device: self.device.clone(),
            device_name: device.name(),
            width: self.size.width,
            height: self.size.height,
            median_seconds: later[later.len() / 2],
            seconds,
        };
        let Some(last) = last else { wrong_settings!("--repeats 0: expected at least 1") };
        Ok((times, last))
    }
}

pub fn run(args: DeviceArgs, context: &Context) -> anyhow::Result<()> {
    match args.action {
        None => list(context),
        Some(Action::Network(args)) => network(&args, context),
        Some(Action::Rasterizer(args)) => rasterizer(&args.timing, context),
    }
}

fn list(context: &Context) -> anyhow::Result<()> {
    let mut devices = Vec::new();
    for (device, name) in device_kinds().into_iter().flat_map(Device::all) {
        let precisions = precisions(&srflow_ops::device(&device)?).into_iter().map(Precision::name);
        devices.push(Listed { device, name, precisions: precisions.collect() });
    }
    if context.json {
        return print_json(&devices);
    }
    for Listed { device, name, precisions } in devices {
        say!("{device:<10} {name} ({})", precisions.join(", "))?;
    }
    Ok(())
}

/// A device of this machine.
#[derive(Serialize)]
struct Listed {
    device: String,
    /// What its driver calls it.
    name: String,
    /// At which networks multiply on it.
    precisions: Vec<&'static str>,
}

fn network(args: &NetworkAction, context: &Context) -> anyhow::Result<()> {
    let Some(architecture) = Architecture::from_name(&args.network) else {
        let names = Architecture::ALL.map(|architecture| architecture.facts().name).join(", ");
        wrong_settings!("unknown network {:?}: expected one of {names}", args.network);
    };
    let (cpu, device) = (srflow_ops::device("cpu")?, srflow_ops::device(&args.timing.device)?);
    let (parameters, on_cpu) = match &args.weights {
        Some(path) => ("file", load_network(architecture, path, &cpu)?),
        None => match load_included(architecture, &cpu) {
            Some(network) => ("included", network),
            None => ("random", architecture.init(&cpu)),
        },
    };
    let own = NonZeroUsize::new(architecture.facts().iterations.default).unwrap_or(NonZeroUsize::MIN);
    let iterations = args.iters.unwrap_or(own);
    let estimator = |network, device| NetworkEstimator::new(&args.network, network, iterations, device);
    let Frames { first, second, .. } = frames(&Device::cpu(), args.timing.size)?;
    let precision = args.precision.on(&args.timing.device)?;
    // On the CPU first: moving the network moves the running statistics of its copies too.
    let expected = if args.timing.against_cpu {
        Some(estimator(on_cpu.clone(), cpu).estimate(&first.image, &second)?)
    } else {
        None
    };
    let there = estimator(on_cpu.on(&device), device).with_precision(precision);
    let (times, flow) = args.timing.time(|| Ok(there.estimate(&first.image, &second)?))?;
    let difference = expected.map(|expected| Difference::of(&flow, &expected));
    if context.json {
        return print_json(&json!({
            "network": args.network, "parameters": parameters, "iterations": iterations,
            "precision": precision.name(), "times": times, "against_cpu": difference,
        }));
    }
    say!(
        "{}, {iterations} iterations, {parameters} parameters, products of {}",
        args.network,
        precision.name()
    )?;
    print(&times)?;
    if let Some(Difference { mean_px, max_px, mean_length_px }) = difference {
        say!(
            "flow against the CPU's: {mean_px:.2e} px on average, {max_px:.2e} px at most, mean length {mean_length_px:.2} px"
        )?;
    }
    Ok(())
}

fn rasterizer(timing: &Timing, context: &Context) -> anyhow::Result<()> {
    let (pair, mut rasterizer) =
        (Pair::new(timing.size)?, DeviceRasterizer::new(&Device::named(&timing.device)?));
    let mut frame = Frame::new();
    let (times, ()) = timing.time(|| pair.render(&mut rasterizer, &mut frame))?;
    let difference = if timing.against_cpu {
        let mut here = Frame::new();
        pair.render(&mut DeviceRasterizer::default(), &mut here)?;
        let bytes = frame.image.pixels().as_flattened().iter().zip(here.image.pixels().as_flattened());
        let levels = bytes.map(|(a, b)| a.abs_diff(*b)).max().unwrap_or(0);
        Some((levels, Difference::of(&frame.flow, &here.flow)))
    } else {
        None
    };
    let statistics = frame.statistics;
    if context.json {
        return print_json(&json!({
            "gaussians": pair.gaussians[0].len(), "visible": statistics.visible, "blended_pairs": statistics.blended,
            "times": times,
            "against_cpu": difference.map(|(levels, flow)| json!({ "max_levels": levels, "flow": flow })),
        }));
    }
    let millions = statistics.blended as f64 * 1e-6;
    say!(
        "{} Gaussians, {} visible, {millions:.1} million pairs blended",
        pair.gaussians[0].len(),
        statistics.visible
    )?;
    print(&times)?;
    if let Some((levels, Difference { mean_px, max_px, .. })) = difference {
        say!(
            "against the CPU's: colours {levels} of 255 levels at most; flow {mean_px:.2e} px on average, {max_px:.2e} px at most"
        )?;
    }
    Ok(())
}

fn print(times: &Times) -> anyhow::Result<()> {
    let Times { device, device_name, width, height, median_seconds, seconds } = times;
    say!(
        "{device} ({device_name}), {width}x{height}: median {median_seconds:.4} s, at first {:.4} s",
        seconds[0]
    )?;
    Ok(())
}

/// Between two flows, and the mean length of the second.
#[derive(Serialize)]
struct Difference {
    mean_px: f64,
    max_px: f64,
    mean_length_px: f64,
}

impl Difference {
    fn of(flow: &FlowField, expected: &FlowField) -> Self {
        let length = |[u, v]: [f32; 2]| f64::from(u).hypot(f64::from(v));
        let pairs = || flow.pixels().iter().zip(expected.pixels());
        let distances = || pairs().map(|(a, b)| length([a[0] - b[0], a[1] - b[1]]));
        let count = expected.pixels().len().max(1) as f64;
        Self {
            mean_px: distances().sum::<f64>() / count,
            max_px: distances().fold(0.0, f64::max),
            mean_length_px: expected.pixels().iter().map(|flow| length(*flow)).sum::<f64>() / count,
        }
    }
}

struct Frames {
    first: Frame,
    second: Image,
}

/// Two frames of the built-in head.
fn frames(device: &Device, size: Size) -> anyhow::Result<Frames> {
    let (pair, mut rasterizer) = (Pair::new(size)?, DeviceRasterizer::new(device));
    let (mut first, mut second) = (Frame::new(), Frame::new());
    pair.render(&mut rasterizer, &mut first)?;
    let options = Options { outputs: Outputs::IMAGE, ..Options::default() };
    rasterizer.render(&pair.gaussians[1], &pair.camera, None, &options, &mut second)?;
    Ok(Frames { first, second: second.image })
}

/// The built-in head before and after a small turn, and a camera one metre in front of its centre.
struct Pair {
    gaussians: [Gaussians; 2],
    camera: Camera,
}

impl Pair {
    fn new(Size { width, height }: Size) -> anyhow::Result<Self> {
        let avatar = Avatar::builtin(1)?;
        let mut turned = HeadPose { translation: Vec3::new(0.003, 0.002, 0.0), ..HeadPose::default() };
        *turned.joint_mut(0) = Quat::from_rotation_y(0.03);
        let gaussians = [HeadPose::default(), turned].map(|pose| {
            let (mut head, mut gaussians) = (PosedHead::default(), Gaussians::default());
            avatar.gaussians_into(&pose, &mut head, &mut gaussians);
            gaussians
        });
        let (mut low, mut high) = (Vec3::INFINITY, Vec3::NEG_INFINITY);
        for &vertex in &avatar.shaped().vertices {
            (low, high) = (low.min(vertex), high.max(vertex));
        }
        let center = (0.5 * (low + high)).as_dvec3();
        // The head fills as much of a frame of any size as of one at 2200x3208 with a focal length of 7600 pixels.
        let focal_length = 7600.0 * (width as f64 / 2200.0).min(height as f64 / 3208.0);
        let camera = Camera {
            width,
            height,
            fx: focal_length,
            fy: focal_length,
            cx: (width as f64 - 1.0) / 2.0,
            cy: (height as f64 - 1.0) / 2.0,
            camera_from_world: DMat4::from_cols(
                DVec4::X,
                -DVec4::Y,
                -DVec4::Z,
                DVec4::new(-center.x, center.y, center.z + 1.0, 1.0),
            ),
        };
        Ok(Self { gaussians, camera })
    }

    fn render(&self, rasterizer: &mut DeviceRasterizer, frame: &mut Frame) -> anyhow::Result<()> {
        let [first, second] = &self.gaussians;
        let options = Options { outputs: Outputs { color: false, ..Outputs::ALL }, ..Options::default() };
        let next = Next { gaussians: second, camera: &self.camera };
        Ok(rasterizer.render(first, &self.camera, Some(next), &options, frame)?)
    }
}
