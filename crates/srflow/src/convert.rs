//! Flow and 3D Gaussians between file formats, and flow in colours.

use std::fmt;
use std::path::{Path, PathBuf};

use anyhow::Context as _;
use serde::{Deserialize, Serialize};
use srflow_core::{FlowField, SettingError, flow_colors, longest_flow};
use srflow_files::{FlowFormat, read_flow, read_npy_channels_first, write_flow_as, write_image_png};
use srflow_splat::{Gaussians, SplatFormat, Up, read_gaussians, write_gaussians};

use crate::clap::Args;
use crate::error::wrong_settings;
use crate::output::ensure_free;
use crate::{Job, Report, Watch};

/// Convert a flow or 3D Gaussians between file formats, or draw a flow in colours
///
/// Flow: the input format is detected from the first bytes, the output format from the extension: .flo, .png
/// (KITTI's 16-bit PNG), .png128, .pfm, .flo5, .npy, .npz or .npz16. All values and unknown pixels are kept;
/// .png rounds to steps of 1/64 pixel, .png128 of 1/128, .npz16 of 1/256 (more where flow is longer than 128
/// pixels).
///
/// 3D Gaussians: both formats follow from the extensions: .ply, .splat, .spz or .glb; .ksplat and .sog can only be
/// read. What is upright in IN is upright in OUT. Between formats with another direction of up, the Gaussians turn by
/// 180 degrees: about the z axis to or from a .glb, as in splat-transform, else about the x axis, as in Niantic's
/// library for .spz. docs/guides/rasterize.md lists what each format keeps. `srflow avatar export` writes the
/// Gaussians of a head.
#[derive(Args, Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[command(after_help = "Examples:
  srflow convert flow.flo5 flow.flo
  srflow convert raft.npy flow.flo --channels-first
  srflow convert flow.flo colours.png --viz --max 20
  srflow convert head.ply head.glb
  srflow convert point_cloud.ply scene.spz --ply-up=-y")]
pub struct ConvertJob {
    /// Flow or Gaussians to read
    #[arg(value_name = "IN")]
    pub input: PathBuf,
    /// File to write
    #[arg(value_name = "OUT")]
    pub output: PathBuf,
    /// Draw the flow in the colours of Middlebury's wheel, as a .png; unknown pixels are black
    #[arg(long)]
    #[serde(default)]
    pub viz: bool,
    /// Length of the flow with full colour, in pixels (default: the longest of the picture)
    #[arg(long, value_name = "PIXELS", requires = "viz", value_parser = positive)]
    #[serde(default)]
    pub max: Option<f32>,
    /// IN is a .npy of shape (2, H, W), as tensors of PyTorch are, not (H, W, 2)
    #[arg(long)]
    #[serde(default)]
    pub channels_first: bool,
    /// Up direction of a .ply of Gaussians, which does not store it: y, as for srflow's heads, or -y, as for
    /// most scenes from photographs
    #[arg(long, value_name = "AXIS", allow_hyphen_values = true, default_value_t)]
    #[serde(default)]
    pub ply_up: Up,
    /// Overwrite OUT
    #[arg(long)]
    #[serde(default)]
    pub force: bool,
}

const POSITIVE: &str = "a positive number of pixels, such as 20";

fn is_positive(number: f32) -> bool {
    number > 0.0 && number.is_finite()
}

/// A length above 0 in pixels.
///
/// # Errors
/// Says what was expected.
#[doc(hidden)]
pub fn positive(text: &str) -> Result<f32, String> {
    text.parse().ok().filter(|number| is_positive(*number)).ok_or_else(|| format!("expected {POSITIVE}"))
}

/// Checks the setting `field`, a length in pixels.
///
/// # Errors
/// When it is not above 0.
#[doc(hidden)]
pub fn ensure_positive(field: &'static str, length: Option<f32>) -> Result<(), SettingError> {
    match length.filter(|length| !is_positive(*length)) {
        Some(found) => Err(SettingError { field, found: found.to_string(), expected: POSITIVE.to_owned() }),
        None => Ok(()),
    }
}

impl ConvertJob {
    /// Converts the file `input` to the format of the name `output`.
    pub fn new(input: impl Into<PathBuf>, output: impl Into<PathBuf>) -> Self {
        Self { input: input.into(), output: output.into(), ..Self::default() }
    }

    /// The formats of both files if they are of Gaussians.
    fn splat_formats(&self) -> anyhow::Result<Option<(&'static SplatFormat, &'static SplatFormat)>> {
        let (input, output) = (self.input.display(), self.output.display());
        let known = SplatFormat::extensions();
        let written = SplatFormat::written_extensions();
        match (SplatFormat::of(&self.input), SplatFormat::of(&self.output)) {
            (Some(_), Some(_)) if self.viz => {
                wrong_settings!("`viz` draws a flow: {input} holds Gaussians")
            }
            (Some(_), Some(_)) if self.channels_first => {
                wrong_settings!("`channels_first` is for a flow: {input} holds Gaussians")
            }
            (Some(from), Some(to)) if to.is_written() => Ok(Some((from, to))),
            (Some(_), _) => {
                wrong_settings!(
                    "{output}: {input} holds Gaussians: expected a name ending in one of {written}"
                )
            }
            (None, Some(_)) => {
                wrong_settings!(
                    "{output}: Gaussians are read from a file ending in one of {known}, found {input}"
                )
            }
            (None, None) => Ok(None),
        }
    }

    fn convert_gaussians(&self, from: &SplatFormat, to: &SplatFormat) -> anyhow::Result<GaussiansWritten> {
        ensure_free([&self.output], self.force)?;
        let mut gaussians = read_gaussians(&self.input)?;
        let [up, to_up] = [from, to].map(|format| format.up.unwrap_or(self.ply_up));
        if let Some(turn) = from.turn_to(up, to, to_up) {
            gaussians.half_turn(turn);
        }
        write_gaussians(&self.output, &gaussians)
            .with_context(|| format!("converting {}", self.input.display()))?;
        Ok(GaussiansWritten::new(&self.output, to, &gaussians))
    }
}

impl Job for ConvertJob {
    const NAME: &'static str = "convert";

    type Report = ConvertReport;

    fn work(&self, _: &Watch) -> anyhow::Result<ConvertReport> {
        ensure_positive("max", self.max)?;
        if self.max.is_some() && !self.viz {
            wrong_settings!("`max` is for `viz`: give both");
        }
        if let Some((from, to)) = self.splat_formats()? {
            return Ok(ConvertReport::Gaussians(self.convert_gaussians(from, to)?));
        }
        let target = Target::of(&self.output, self.viz)?;
        ensure_free([&self.output], self.force)?;
        let read = if self.channels_first { read_npy_channels_first } else { read_flow };
        let flow = read(&self.input)?;
        match target {
            Target::Picture => write_image_png(&self.output, &flow_colors(&flow, self.max)),
            Target::Flow(format) => write_flow_as(&self.output, &flow, format),
        }
        .with_context(|| format!("converting {}", self.input.display()))?;
        Ok(ConvertReport::Flow(FlowWritten::new(&self.output, &flow)))
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
                wrong_settings!("{}: `viz` draws a picture: expected a name ending in .png", output.display())
            }
            Some(format) => Ok(Self::Flow(format)),
            None => {
                let formats = FlowFormat::ALL.map(|format| format!(".{format}")).join(", ");
                wrong_settings!(
                    "{}: expected a name ending in one of {formats} for a flow, or {} for Gaussians",
                    output.display(),
                    SplatFormat::written_extensions()
                )
            }
        }
    }
}

/// What [`ConvertJob`] has written.
#[derive(Debug, Clone, Serialize)]
#[serde(untagged)]
pub enum ConvertReport {
    Flow(FlowWritten),
    Gaussians(GaussiansWritten),
}

/// A flow, or a picture of it, in a file.
#[derive(Debug, Clone, Serialize)]
pub struct FlowWritten {
    pub output: PathBuf,
    pub width: usize,
    pub height: usize,
    pub known_pixels: usize,
    /// Length of the longest known flow in pixels.
    pub longest: f32,
}

/// Gaussians in a file.
#[derive(Debug, Clone, Serialize)]
pub struct GaussiansWritten {
    pub output: PathBuf,
    pub gaussians: usize,
    pub sh_degree: usize,
    pub antialiased: bool,
}

impl FlowWritten {
    fn new(output: &Path, flow: &FlowField) -> Self {
        Self {
            output: output.to_owned(),
            width: flow.width(),
            height: flow.height(),
            known_pixels: flow.known().pixels().iter().filter(|known| **known).count(),
            longest: longest_flow(flow),
        }
    }
}

impl GaussiansWritten {
    /// Describes the file, and logs what its format does not keep.
    #[doc(hidden)]
    pub fn new(output: &Path, format: &SplatFormat, gaussians: &Gaussians) -> Self {
        if let Some(lost) = format.loses {
            log::warn!("{}: a .{} file does not keep {lost}", output.display(), format.extension);
        }
        Self {
            output: output.to_owned(),
            gaussians: gaussians.len(),
            sh_degree: gaussians.sh_degree,
            antialiased: gaussians.antialiased,
        }
    }
}

impl Report for ConvertReport {}

impl Report for GaussiansWritten {}

impl fmt::Display for ConvertReport {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        match self {
            Self::Flow(flow) => flow.fmt(f),
            Self::Gaussians(gaussians) => gaussians.fmt(f),
        }
    }
}

impl fmt::Display for FlowWritten {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        let Self { output, width, height, known_pixels, longest } = self;
        let unknown = width * height - known_pixels;
        write!(f, "{}: flow of {width}x{height} pixels, at most {longest:.2} px long", output.display())?;
        if unknown > 0 {
            write!(f, ", unknown at {unknown} pixels")?;
        }
        writeln!(f)
    }
}

impl fmt::Display for GaussiansWritten {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        let Self { output, gaussians, sh_degree, antialiased } = self;
        let antialiased = if *antialiased { ", antialiased" } else { "" };
        writeln!(
            f,
            "{}: {gaussians} Gaussians with spherical harmonics of degree {sh_degree}{antialiased}",
            output.display()
        )
    }
}
