//! The registry behind `--method`: every estimator the program knows, by name.

use clap::{Args, ValueEnum};
use srflow_classical::{Farneback, FarnebackParameters, TvL1, TvL1Parameters};
use srflow_field::FlowEstimator;

/// A method of estimating optical flow.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum Method {
    /// Gunnar Farneback's polynomial expansion
    Farneback,
    /// TV-L1: total variation smoothness, absolute differences
    #[value(name = "tvl1")]
    TvL1,
}

/// Parameters of the methods. Each is for the methods its heading names and takes their default when absent.
#[derive(Args, Debug, Clone, Default)]
pub struct MethodParameters {
    #[command(flatten)]
    farneback: FarnebackArgs,
    #[command(flatten)]
    tvl1: TvL1Args,
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

/// OpenCV's parameters of `DualTVL1OpticalFlow`.
#[derive(Args, Debug, Clone, Default)]
#[command(next_help_heading = "Parameters of tvl1")]
struct TvL1Args {
    /// Time step of the dual update [default: 0.25]
    #[arg(long, value_name = "STEP")]
    tau: Option<f64>,
    /// Weight of the data term; smaller is smoother [default: 0.15]
    #[arg(long, value_name = "WEIGHT")]
    lambda: Option<f64>,
    /// Tightness of the coupling of data term and smoothness [default: 0.3]
    #[arg(long, value_name = "TIGHTNESS")]
    theta: Option<f64>,
    /// Number of scales [default: 5]
    #[arg(long, value_name = "N")]
    nscales: Option<usize>,
    /// Warps at each scale [default: 5]
    #[arg(long, value_name = "N")]
    warps: Option<usize>,
    /// Iterations end when the flow changes by less than this, in pixels [default: 0.01]
    #[arg(long, value_name = "PIXELS")]
    epsilon: Option<f64>,
    /// Iterations between two median filters [default: 30]
    #[arg(long, value_name = "N")]
    inner_iterations: Option<usize>,
    /// Median filters after each warp [default: 10]
    #[arg(long, value_name = "N")]
    outer_iterations: Option<usize>,
    /// Size of a scale relative to the next finer one [default: 0.8]
    #[arg(long, value_name = "SCALE")]
    scale_step: Option<f64>,
    /// Weight of a brightness change estimated beside the flow; 0 estimates none [default: 0]
    #[arg(long, value_name = "WEIGHT")]
    gamma: Option<f64>,
    /// Side of the median filter, 3 or 5 pixels, or 1 for none [default: 5]
    #[arg(long, value_name = "PIXELS")]
    median_filtering: Option<usize>,
}

/// The estimator of that name.
///
/// # Errors
/// When a parameter is out of its range.
pub fn estimator(method: Method, parameters: &MethodParameters) -> anyhow::Result<Box<dyn FlowEstimator>> {
    Ok(match method {
        Method::Farneback => Box::new(Farneback::new(parameters.farneback.parameters())?),
        Method::TvL1 => Box::new(TvL1::new(parameters.tvl1.parameters())?),
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

impl TvL1Args {
    fn parameters(&self) -> TvL1Parameters {
        let default = TvL1Parameters::default();
        TvL1Parameters {
            tau: self.tau.unwrap_or(default.tau),
            lambda: self.lambda.unwrap_or(default.lambda),
            theta: self.theta.unwrap_or(default.theta),
            nscales: self.nscales.unwrap_or(default.nscales),
            warps: self.warps.unwrap_or(default.warps),
            epsilon: self.epsilon.unwrap_or(default.epsilon),
            inner_iterations: self.inner_iterations.unwrap_or(default.inner_iterations),
            outer_iterations: self.outer_iterations.unwrap_or(default.outer_iterations),
            scale_step: self.scale_step.unwrap_or(default.scale_step),
            gamma: self.gamma.unwrap_or(default.gamma),
            median_filtering: self.median_filtering.unwrap_or(default.median_filtering),
        }
    }
}
