//! The optical strain between two frames.

use std::fmt;
use std::path::PathBuf;

use anyhow::ensure;
use serde::{Deserialize, Serialize};
use srflow_core::resize::resize_cubic;
use srflow_core::{FlowField, SettingError, Size};
use srflow_files::{read_flow, read_image, write_image_png, write_npy, write_npy_plane};
use srflow_mer::{
    Channel, FEATURE_SIDE, FeatureSettings, HeadMotion, ResizeOrder, StrainFormula, SubtractedMotion,
    features_of_flow, optical_strain, strain_colors,
};

use crate::clap::{Args, ValueEnum};
use crate::error::wrong_settings;
use crate::face::FaceArgs;
use crate::methods::{self, MethodParameters, MethodSpec};
use crate::output::{ensure_extension, ensure_free, write_line};
use crate::{Job, Report, Watch};

/// Compute the optical strain between two frames
#[derive(Args, Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[command(after_help = "\
Examples:
  srflow mer strain onset.png apex.png -o strain.npy --viz strain.png
  srflow mer strain onset.png apex.png -o strain.npy --formula off-tanet --method tvl1
  srflow mer strain onset.png apex.png -o strain.npy --size full
  srflow mer strain onset.png apex.png -o strain.npy --face detect
  srflow mer strain onset_to_apex.flo -o strain.npy

The literature's formula is sqrt(ux^2 + vy^2 + (uy + vx)^2 / 2) with derivatives per pixel; off-tanet is what that \
network's published code computes, including its error (see docs/explanation/micro-expression-protocol.md).")]
pub struct StrainJob {
    /// Onset frame, or a file of the flow from onset to apex
    #[arg(value_name = "A|FLOW")]
    pub onset: PathBuf,
    /// Apex frame; none after a flow file
    #[arg(value_name = "B")]
    #[serde(default)]
    pub apex: Option<PathBuf>,
    /// Strain as .npy array of shape (H, W)
    #[arg(short, long, value_name = "FILE")]
    pub out: PathBuf,
    /// Also write u, v and strain, as .npy array of shape (3, 112, 112)
    #[arg(long, value_name = "FILE", conflicts_with = "size")]
    #[serde(default)]
    pub features: Option<PathBuf>,
    /// Draw the strain: black is zero, white the largest
    #[arg(long, value_name = "PNG")]
    #[serde(default)]
    pub viz: Option<PathBuf>,
    /// Strain drawn white [default: the largest]
    #[arg(long, value_name = "STRAIN", requires = "viz")]
    #[serde(default)]
    pub viz_max: Option<f32>,
    /// How to estimate the flow
    #[arg(long, value_name = "METHOD", default_value_t, help = methods::Method::help())]
    #[serde(default)]
    pub method: MethodSpec,
    /// Formula: literature or off-tanet
    #[arg(long, value_name = "FORMULA", default_value_t)]
    #[serde(default)]
    pub formula: StrainFormula,
    /// Resize to 112x112: the frames before estimating the flow, or the flow after [default: after]
    #[arg(long, value_name = "ORDER", conflicts_with = "size")]
    #[serde(default)]
    pub resize: Option<ResizeOrder>,
    /// The head's motion in the flow: keep or subtract
    #[arg(long, value_name = "WHAT", default_value_t)]
    #[serde(default)]
    pub head_motion: HeadMotion,
    /// Size of the result
    #[arg(long, value_name = "SIZE", value_enum, default_value_t)]
    #[serde(default)]
    pub size: StrainSize,
    /// Overwrite existing files
    #[arg(long)]
    #[serde(default)]
    pub force: bool,
    #[command(flatten)]
    #[serde(flatten)]
    pub face: FaceArgs,
    #[command(flatten)]
    #[serde(flatten)]
    pub parameters: MethodParameters,
}

/// The size at which strain is computed.
#[derive(ValueEnum, Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
pub enum StrainSize {
    /// The input of classifiers.
    #[default]
    #[value(name = "112x112")]
    #[serde(rename = "112x112")]
    Features,
    /// The size of the frames.
    #[value(name = "full")]
    #[serde(rename = "full")]
    Full,
}

impl Job for StrainJob {
    const NAME: &'static str = "mer strain";

    type Report = StrainReport;

    fn work(&self, watch: &Watch) -> anyhow::Result<StrainReport> {
        if let Some(max) = self.viz_max.filter(|max| !(*max > 0.0 && max.is_finite())) {
            let expected = "a positive number, such as 0.5".to_owned();
            return Err(SettingError { field: "viz_max", found: max.to_string(), expected }.into());
        }
        let full = self.size == StrainSize::Full;
        if full && self.features.is_some() {
            wrong_settings!("`features` are 112x112: leave out `size`");
        }
        let outputs = [Some(&self.out), self.features.as_ref(), self.viz.as_ref()];
        for (path, extension) in outputs.into_iter().zip(["npy", "npy", "png"]) {
            path.map_or(Ok(()), |path| ensure_extension(path, extension))?;
        }
        ensure_free(outputs.into_iter().flatten(), self.force)?;
        let settings = FeatureSettings {
            resize: self.resize.unwrap_or(FeatureSettings::default().resize),
            head_motion: self.head_motion,
            strain: self.formula,
        };
        let (method, flow) = self.flow(settings.resize, watch)?;
        let (strain, subtracted) = if full {
            let (flow, subtracted) = self.head_motion.applied(flow);
            (self.head_motion.within_face(optical_strain(&flow, self.formula)), subtracted)
        } else {
            let (features, subtracted) = features_of_flow(flow, settings)?;
            if let Some(path) = &self.features {
                write_npy(path, &[3, FEATURE_SIDE, FEATURE_SIDE], features.values())?;
            }
            (features.plane(Channel::Strain), subtracted)
        };
        write_npy_plane(&self.out, &strain)?;
        if let Some(path) = &self.viz {
            write_image_png(path, &strain_colors(&strain, self.viz_max))?;
        }
        let pixels = strain.pixels();
        Ok(StrainReport {
            output: self.out.clone(),
            method,
            formula: self.formula,
            resize: (!full).then_some(settings.resize),
            head_motion: subtracted,
            width: strain.width(),
            height: strain.height(),
            mean_strain: pixels.iter().map(|&value| f64::from(value)).sum::<f64>()
                / pixels.len().max(1) as f64,
            max_strain: pixels.iter().copied().fold(0.0, f32::max),
        })
    }
}

impl StrainJob {
    /// The flow from onset to apex within the face, and the name of its method.
    fn flow(&self, resize: ResizeOrder, watch: &Watch) -> anyhow::Result<(String, FlowField)> {
        let Some(apex) = &self.apex else { return Ok(("the file".to_owned(), self.flow_of_file()?)) };
        let estimator = methods::estimator(&self.method, &self.parameters, watch)?;
        let (onset, apex) = (read_image(&self.onset)?, read_image(apex)?);
        ensure!(
            onset.size() == apex.size() && !onset.pixels().is_empty(),
            "{} is {} and the other frame {} (WIDTHxHEIGHT): give two frames of one size",
            self.onset.display(),
            onset.size(),
            apex.size()
        );
        let crop = self.face.of_sequence(|take| _ = take(Ok(onset.clone())))?.crop;
        let mut faces = [crop.apply(&onset)?, crop.apply(&apex)?];
        if self.size == StrainSize::Features && resize == ResizeOrder::Before {
            faces = faces.map(|face| resize_cubic(&face, Size::new(FEATURE_SIDE, FEATURE_SIDE)));
        }
        let [onset, apex] = &faces;
        Ok((estimator.name().to_owned(), estimator.estimate(onset, apex)?))
    }

    /// The flow that was given in place of two frames.
    fn flow_of_file(&self) -> anyhow::Result<FlowField> {
        if self.resize == Some(ResizeOrder::Before) {
            wrong_settings!("`resize` before needs two frames; {} is one file of flow", self.onset.display());
        }
        let flow = read_flow(&self.onset)?;
        match self.face.still_box() {
            Ok(None) => Ok(flow),
            Ok(Some(face)) => {
                face.check_inside(flow.size())?;
                Ok(flow.crop(face.left, face.top, face.width, face.height))
            }
            Err(setting) => {
                wrong_settings!("`{setting}` needs frames; {} is flow: give `face_box`", self.onset.display())
            }
        }
    }
}

/// The strain that was written.
#[derive(Debug, Clone, Serialize)]
pub struct StrainReport {
    pub output: PathBuf,
    pub method: String,
    pub formula: StrainFormula,
    /// `None` at full size.
    pub resize: Option<ResizeOrder>,
    /// The motion of the head that was subtracted, in pixels of 112x112.
    pub head_motion: Option<SubtractedMotion>,
    pub width: usize,
    pub height: usize,
    pub mean_strain: f64,
    pub max_strain: f32,
}

impl Report for StrainReport {}

impl fmt::Display for StrainReport {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        let Self { output, width, height, mean_strain, max_strain, .. } = self;
        write_line(
            f,
            format_args!(
                "{}: {width}x{height}, mean strain {mean_strain:.5}, maximum {max_strain:.5}",
                output.display()
            ),
        )
    }
}
