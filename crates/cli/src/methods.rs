//! The registry behind `--method`: every estimator the program knows, by name.

use clap::{Args, ValueEnum};
use srflow_classical::{Farneback, FarnebackParameters};
use srflow_field::FlowEstimator;

/// A method of estimating optical flow.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum Method {
    /// Gunnar Farneback's polynomial expansion
    Farneback,
}

/// Parameters of the methods. Each is for the methods its heading names and takes their default when absent.
#[derive(Args, Debug, Clone, Default)]
pub struct MethodParameters {
    #[command(flatten)]
    farneback: FarnebackArgs,
}

/// OpenCV's parameters of `calcOpticalFlowFarneback`.
#[derive(Args, Debug, Clone, Default)]
#[command(next_help_heading = "Parameters of farneback")]
struct FarnebackArgs {
    /// Size of a pyramid level relative to the next finer one [default: 0.5]
    #[arg(long, value_name = "SCALE")]
    pyr_scale: Option<f64>,
    /// Pyramid levels beside the full size [default: 5]
    #[arg(long, value_name = "N")]
    levels: Option<usize>,
    /// Side of the averaging window in pixels [default: 13]
    #[arg(long, value_name = "PIXELS")]
    winsize: Option<usize>,
    /// Iterations at each level [default: 10]
    #[arg(long, value_name = "N")]
    iterations: Option<usize>,
    /// Radius of the polynomial fit in pixels [default: 5]
    #[arg(long, value_name = "PIXELS")]
    poly_n: Option<usize>,
    /// Standard deviation of the fit's weight in pixels [default: 1.1]
    #[arg(long, value_name = "PIXELS")]
    poly_sigma: Option<f64>,
    /// Average with a Gaussian window in place of a box
    #[arg(long)]
    farneback_gaussian: bool,
}

/// The estimator of that name.
///
/// # Errors
/// When a parameter is out of its range.
pub fn estimator(method: Method, parameters: &MethodParameters) -> anyhow::Result<Box<dyn FlowEstimator>> {
    Ok(match method {
        Method::Farneback => Box::new(Farneback::new(parameters.farneback.parameters())?),
    })
}

impl FarnebackArgs {
    fn parameters(&self) -> FarnebackParameters {
        let default = FarnebackParameters::default();
        FarnebackParameters {
            pyr_scale: self.pyr_scale.unwrap_or(default.pyr_scale),
            levels: self.levels.unwrap_or(default.levels),
            winsize: self.winsize.unwrap_or(default.winsize),
            iterations: self.iterations.unwrap_or(default.iterations),
            poly_n: self.poly_n.unwrap_or(default.poly_n),
            poly_sigma: self.poly_sigma.unwrap_or(default.poly_sigma),
            gaussian: self.farneback_gaussian,
        }
    }
}
