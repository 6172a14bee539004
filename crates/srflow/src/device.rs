//! The devices of a machine, and how fast and exact they are.

use std::fmt;
use std::num::NonZeroUsize;
use std::path::PathBuf;
use std::time::Instant;

use glam::{DMat4, DVec4, Quat, Vec3};
use serde::{Deserialize, Serialize};
use srflow_avatar::{Avatar, PosedHead};
use srflow_core::{FlowEstimator as _, FlowField, Image, SettingError, Size};
use srflow_head::HeadPose;
use srflow_nets::{Architecture, NetworkEstimator, load_included, load_network};
use srflow_ops::{DeviceError, Precision, device_kinds, precisions};
use srflow_splat::{Camera, Device, DeviceRasterizer, Frame, Gaussians, Next, Options, Outputs};

use crate::clap::Args;
use crate::error::wrong_settings;
use crate::networks::PrecisionArg;
use crate::{Job, Report, Watch};

/// List the devices of this machine
///
/// Lists every device that this build supports and the drivers find.
#[derive(Args, Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct DevicesJob {}

/// Time a network on two frames of the built-in head
///
/// Times include the transfer of frames and flow. Without weights the parameters are those that come with
/// srflow, or random.
#[derive(Args, Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct TimeNetworkJob {
    /// Name of the network; `srflow models` lists them
    #[arg(value_name = "NETWORK")]
    pub network: String,
    /// Refinement iterations [default: the network's own]
    #[arg(long, value_name = "N")]
    #[serde(default)]
    pub iters: Option<NonZeroUsize>,
    /// File of weights
    #[arg(long, value_name = "FILE")]
    #[serde(default)]
    pub weights: Option<PathBuf>,
    /// Numbers that the network multiplies on the device; with --against-cpu, the CPU uses f32
    #[arg(long, value_name = "PRECISION", default_value_t)]
    #[serde(default)]
    pub precision: PrecisionArg,
    #[command(flatten)]
    #[serde(flatten)]
    pub timing: Timing,
}

/// Time the rasterizer: frame, flow, alpha and depths of the built-in head
#[derive(Args, Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct TimeRasterizerJob {
    #[command(flatten)]
    #[serde(flatten)]
    pub timing: Timing,
}

/// What is timed on which device.
#[derive(Args, Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct Timing {
    #[arg(long, value_name = "DEVICE", default_value_t = Self::default().device, value_parser = known, help = crate::networks::device_help())]
    pub device: String,
    /// Size of the frames, WIDTHxHEIGHT
    #[arg(long, value_name = "SIZE", default_value_t = Self::default().size)]
    pub size: Size,
    /// Number of runs; the first includes the compilation of kernels
    #[arg(long, value_name = "N", default_value_t = Self::default().repeats, value_parser = clap::value_parser!(u32).range(1..=MOST_REPEATS))]
    pub repeats: u32,
    /// Also compute on the CPU, and print the differences
    #[arg(long)]
    pub against_cpu: bool,
}

const MOST_REPEATS: i64 = 1000;

impl Default for Timing {
    fn default() -> Self {
        let size = Size::new(800, 512);
        Self { device: "cpu".to_owned(), size, repeats: 4, against_cpu: false }
    }
}

/// The name of a device that exists.
fn known(name: &str) -> Result<String, DeviceError> {
    Device::named(name).map(|_| name.to_owned())
}

impl Timing {
    /// The device to time.
    ///
    /// # Errors
    /// When a setting is wrong or the device does not exist.
    fn device(&self) -> anyhow::Result<Device> {
        if !(1..=MOST_REPEATS).contains(&self.repeats.into()) {
            let expected = format!("1 to {MOST_REPEATS}");
            return Err(SettingError { field: "repeats", found: self.repeats.to_string(), expected }.into());
        }
        match Device::named(&self.device) {
            Ok(device) => Ok(device),
            Err(error) => wrong_settings!("`device`: {error}"),
        }
    }

    /// Calls `work` for each repetition, and returns the last result.
    fn time<T>(
        &self,
        device: &Device,
        watch: &Watch,
        mut work: impl FnMut() -> anyhow::Result<T>,
    ) -> anyhow::Result<(Times, T)> {
        let count = watch.count("repetitions", u64::from(self.repeats));
        let mut seconds = Vec::new();
        let mut timed = || {
            let start = Instant::now();
            let result = work()?;
            seconds.push(start.elapsed().as_secs_f64());
            count.inc();
            anyhow::Ok(result)
        };
        let mut last = timed()?;
        for _ in 1..self.repeats {
            last = timed()?;
        }
        let mut later = seconds[usize::from(seconds.len() > 1)..].to_vec();
        later.sort_by(f64::total_cmp);
        let times = Times {
            device: self.device.clone(),
            device_name: device.name(),
            height: self.size.height,
            median_seconds: later[later.len() / 2],
            seconds,
            width: self.size.width,
        };
        Ok((times, last))
    }
}

/// What one thing took on a device.
#[derive(Debug, Clone, Serialize)]
pub struct Times {
    pub device: String,
    /// What its driver calls it.
    pub device_name: String,
    pub height: usize,
    /// Of all but the first.
    pub median_seconds: f64,
    pub seconds: Vec<f64>,
    pub width: usize,
}

impl fmt::Display for Times {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        let Self { device, device_name, width, height, median_seconds, seconds } = self;
        let first = seconds.first().copied().unwrap_or_default();
        writeln!(
            f,
            "{device} ({device_name}), {width}x{height}: median {median_seconds:.4} s, at first {first:.4} s"
        )
    }
}

impl Job for DevicesJob {
    const NAME: &'static str = "device";

    type Report = Devices;

    fn work(&self, _: &Watch) -> anyhow::Result<Devices> {
        let mut devices = Vec::new();
        for (device, name) in device_kinds().into_iter().flat_map(Device::all) {
            let precisions = precisions(&srflow_ops::device(&device)?).into_iter().map(Precision::name);
            devices.push(ListedDevice { device, name, precisions: precisions.collect() });
        }
        Ok(Devices(devices))
    }
}

/// The devices of this machine.
#[derive(Debug, Clone, Serialize)]
#[serde(transparent)]
pub struct Devices(pub Vec<ListedDevice>);

/// A device of this machine.
#[derive(Debug, Clone, Serialize)]
pub struct ListedDevice {
    pub device: String,
    /// What its driver calls it.
    pub name: String,
    /// At which networks multiply on it.
    pub precisions: Vec<&'static str>,
}

impl Report for Devices {}

impl fmt::Display for Devices {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        for ListedDevice { device, name, precisions } in &self.0 {
            writeln!(f, "{device:<10} {name} ({})", precisions.join(", "))?;
        }
        Ok(())
    }
}

impl Job for TimeNetworkJob {
    const NAME: &'static str = "device network";

    type Report = NetworkTimes;

    fn work(&self, watch: &Watch) -> anyhow::Result<NetworkTimes> {
        let Some(architecture) = Architecture::from_name(&self.network) else {
            let names = Architecture::ALL.map(|architecture| architecture.facts().name).join(", ");
            wrong_settings!("unknown network {:?}: expected one of {names}", self.network);
        };
        let timed = self.timing.device()?;
        let (cpu, device) = (srflow_ops::device("cpu")?, srflow_ops::device(&self.timing.device)?);
        let (parameters, on_cpu) = match &self.weights {
            Some(path) => ("file", load_network(architecture, path, &cpu)?),
            None => match load_included(architecture, &cpu) {
                Some(network) => ("included", network),
                None => ("random", architecture.init(&cpu)),
            },
        };
        let own = NonZeroUsize::new(architecture.facts().iterations.default).unwrap_or(NonZeroUsize::MIN);
        let iterations = self.iters.unwrap_or(own);
        let estimator = |network, device| NetworkEstimator::new(&self.network, network, iterations, device);
        let Frames { first, second, .. } = frames(&Device::cpu(), self.timing.size)?;
        let precision = self.precision.on(&self.timing.device)?;
        // On the CPU first: moving the network moves the running statistics of its copies too.
        let expected = if self.timing.against_cpu {
            Some(estimator(on_cpu.clone(), cpu).estimate(&first.image, &second)?)
        } else {
            None
        };
        let there = estimator(on_cpu.on(&device), device).with_precision(precision);
        let (times, flow) = self.timing.time(&timed, watch, || Ok(there.estimate(&first.image, &second)?))?;
        Ok(NetworkTimes {
            against_cpu: expected.map(|expected| Difference::new(&flow, &expected)),
            iterations,
            network: self.network.clone(),
            parameters,
            precision: precision.name(),
            times,
        })
    }
}

/// How fast and exact a network is on a device.
#[derive(Debug, Clone, Serialize)]
pub struct NetworkTimes {
    /// Of the flow.
    pub against_cpu: Option<Difference>,
    pub iterations: NonZeroUsize,
    pub network: String,
    /// `file`, `included` or `random`.
    pub parameters: &'static str,
    pub precision: &'static str,
    pub times: Times,
}

impl Report for NetworkTimes {}

impl fmt::Display for NetworkTimes {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        let Self { against_cpu, iterations, network, parameters, precision, times } = self;
        writeln!(f, "{network}, {iterations} iterations, {parameters} parameters, products of {precision}")?;
        times.fmt(f)?;
        match against_cpu {
            Some(Difference { mean_px, max_px, mean_length_px }) => writeln!(
                f,
                "flow against the CPU's: {mean_px:.2e} px on average, {max_px:.2e} px at most, mean length {mean_length_px:.2} px"
            ),
            None => Ok(()),
        }
    }
}

impl Job for TimeRasterizerJob {
    const NAME: &'static str = "device rasterizer";

    type Report = RasterizerTimes;

    fn work(&self, watch: &Watch) -> anyhow::Result<RasterizerTimes> {
        let timing = &self.timing;
        let device = timing.device()?;
        let (pair, mut rasterizer) = (Pair::new(timing.size)?, DeviceRasterizer::new(&device));
        let mut frame = Frame::new();
        let (times, ()) = timing.time(&device, watch, || pair.render(&mut rasterizer, &mut frame))?;
        let against_cpu = if timing.against_cpu {
            let mut here = Frame::new();
            pair.render(&mut DeviceRasterizer::default(), &mut here)?;
            let bytes = frame.image.pixels().as_flattened().iter().zip(here.image.pixels().as_flattened());
            let max_levels = bytes.map(|(a, b)| a.abs_diff(*b)).max().unwrap_or(0);
            Some(FrameDifference { flow: Difference::new(&frame.flow, &here.flow), max_levels })
        } else {
            None
        };
        Ok(RasterizerTimes {
            against_cpu,
            blended_pairs: frame.statistics.blended,
            gaussians: pair.gaussians[0].len(),
            times,
            visible: frame.statistics.visible,
        })
    }
}

/// How fast and exact the rasterizer is on a device.
#[derive(Debug, Clone, Serialize)]
pub struct RasterizerTimes {
    pub against_cpu: Option<FrameDifference>,
    /// Pairs of a pixel and a Gaussian that were blended.
    pub blended_pairs: u64,
    pub gaussians: usize,
    pub times: Times,
    pub visible: usize,
}

/// Between two renderings.
#[derive(Debug, Clone, Serialize)]
pub struct FrameDifference {
    pub flow: Difference,
    /// Of colours, in levels of 255.
    pub max_levels: u8,
}

/// Between two flows, and the mean length of the second.
#[derive(Debug, Clone, Serialize)]
pub struct Difference {
    pub max_px: f64,
    pub mean_length_px: f64,
    pub mean_px: f64,
}

impl Difference {
    fn new(flow: &FlowField, expected: &FlowField) -> Self {
        let length = |[u, v]: [f32; 2]| f64::from(u).hypot(f64::from(v));
        let pairs = || flow.pixels().iter().zip(expected.pixels());
        let distances = || pairs().map(|(a, b)| length([a[0] - b[0], a[1] - b[1]]));
        let count = expected.pixels().len().max(1) as f64;
        Self {
            max_px: distances().fold(0.0, f64::max),
            mean_length_px: expected.pixels().iter().map(|flow| length(*flow)).sum::<f64>() / count,
            mean_px: distances().sum::<f64>() / count,
        }
    }
}

impl Report for RasterizerTimes {}

impl fmt::Display for RasterizerTimes {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        let Self { against_cpu, blended_pairs, gaussians, times, visible } = self;
        let millions = *blended_pairs as f64 * 1e-6;
        writeln!(f, "{gaussians} Gaussians, {visible} visible, {millions:.1} million pairs blended")?;
        times.fmt(f)?;
        match against_cpu {
            Some(FrameDifference { flow: Difference { mean_px, max_px, .. }, max_levels }) => writeln!(
                f,
                "against the CPU's: colours {max_levels} of 255 levels at most; flow {mean_px:.2e} px on average, {max_px:.2e} px at most"
            ),
            None => Ok(()),
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
        // The head fills as much of a frame of any size as of one at 2200x3208 with a focal length of 7600
        // pixels.
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
